"""P21: what a megabyte of garbage on a wire costs each framing, and who reads it raw."""

from __future__ import annotations

import random
import time
from collections.abc import Callable
from typing import Protocol

from benchmarks.harness import Row, ms
from esair.drivers.gps import FixBuilder
from esair.framing import (
    Cobs,
    LengthCrc,
    Lines,
    ModbusRtu,
    ModbusTcp,
    Sentences,
    encode_sentence,
)

MEGABYTE = 1 << 20
LIMIT = 0.05
PIECE = 1024


def _of(unit: bytes) -> bytes:
    return (unit * (MEGABYTE // len(unit) + 1))[:MEGABYTE]


class Fixes:
    """A GPS receiver's bytes, from the line to the fix."""

    def __init__(self) -> None:
        self._framing = Sentences()
        self._builder = FixBuilder()

    def feed(self, data: bytes) -> None:
        for body in self._framing.feed(data):
            self._builder.feed(body)


class Reads(Protocol):
    """What takes the bytes of a wire."""

    def feed(self, data: bytes) -> object:
        """Take bytes."""


GARBAGE = {
    "random": random.Random(1).randbytes(MEGABYTE),
    "zeros": bytes(MEGABYTE),
    "line ends": b"\n" * MEGABYTE,
    "sync bytes": b"\xaa" * MEGABYTE,
    "sync and a length": _of(b"\xaa\xff"),
    "lengths": b"\xff" * MEGABYTE,
    "short sentences": _of(b"$GP*00\n"),
    "empty sentences": _of(b"$*00\n"),
    "long sentences": _of(b"$" + b"A" * 255 + b"*00\n"),
    "endings": _of(b"*00\n"),
    "codes that are cut": _of(b"\xff\0"),
    "reads of Modbus": _of(b"\x01\x03\xfa"),
    "refusals of Modbus": _of(b"\x01\x81"),
    "fixes that are none": _of(encode_sentence("GPRMC", "000000", "A", *["x"] * 9)),
}
READERS: tuple[tuple[str, Callable[[], Reads]], ...] = (
    ("length-crc", LengthCrc),
    ("length-crc, sync AA", lambda: LengthCrc(sync=b"\xaa")),
    (
        "length-crc, 64 KiB",
        lambda: LengthCrc(length_size=2, max_length=65_535),
    ),
    ("lines", Lines),
    ("nmea", Sentences),
    ("cobs", Cobs),
    ("modbus-rtu", ModbusRtu),
    ("modbus-tcp", ModbusTcp),
    ("gps", Fixes),
)


async def rows() -> list[Row]:
    rows = []
    for name, make in READERS:
        cost, worst = max(
            (min(_cost(make(), data) for _ in range(2)), kind)
            for kind, data in GARBAGE.items()
        )
        rows.append(
            Row(
                f"P21 CPU for a MB of garbage: {name}",
                ms(cost),
                ms(LIMIT),
                cost / LIMIT,
                1.0,
                f"the worst of {len(GARBAGE)} kinds: {worst}",
            )
        )
    return rows


def _cost(framing: Reads, data: bytes) -> float:
    begin = time.process_time()
    for at in range(0, MEGABYTE, PIECE):
        framing.feed(data[at : at + PIECE])
    return time.process_time() - begin
