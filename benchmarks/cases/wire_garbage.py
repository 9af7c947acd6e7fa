"""P21: what a megabyte of garbage on a wire costs each framing, and who reads it raw."""

from __future__ import annotations

import asyncio
import random
import time
from collections.abc import Callable
from typing import Protocol

from benchmarks.harness import Row, ms
from esair.buses import SerialBus
from esair.drivers.gps import FixBuilder
from esair.drivers.line import LineSensor
from esair.drivers.rplidar import Scan, ScanDecoder, encode_scan
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
    "fixes without a place": _of(
        encode_sentence("GPRMC", "000000", "A", *[""] * 9)
        + encode_sentence("GPGGA", "000000", "", "", "", "", "1", *[""] * 8)
    ),
    "beginnings": b"$" * MEGABYTE,
    "turns of one measurement": _of(encode_scan(Scan((0.0,), (1.0,), (15,)))),
    "turns of two": _of(encode_scan(Scan((0.0, 1.0), (1.0, 2.0), (15, 15)))),
    "measurements and a byte": _of(encode_scan(Scan((0.0,), (1.0,), (15,))) + b"\0"),
    "values that are none": _of(b"x=\n"),
    "values that end badly": _of(b"x=" + b"1" * 61 + b"x\n"),
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
    ("rplidar", ScanDecoder),
)


async def rows() -> list[Row]:
    costs = {
        name: [
            (min(_cost(make(), data) for _ in range(2)), kind)
            for kind, data in GARBAGE.items()
        ]
        for name, make in READERS
    }
    costs["line, with its bus"] = [
        (min([await _cost_of_a_sensor(data) for _ in range(2)]), kind)
        for kind, data in GARBAGE.items()
    ]
    return [
        Row(
            f"P21 CPU for a MB of garbage: {name}",
            ms(cost),
            ms(LIMIT),
            cost / LIMIT,
            1.0,
            f"the worst of {len(GARBAGE)} kinds: {worst}",
        )
        for name, (cost, worst) in ((name, max(each)) for name, each in costs.items())
    ]


def _cost(framing: Reads, data: bytes) -> float:
    begin = time.process_time()
    for at in range(0, MEGABYTE, PIECE):
        framing.feed(data[at : at + PIECE])
    return time.process_time() - begin


async def _cost_of_a_sensor(data: bytes) -> float:
    """What a sensor of lines costs that listens, on a line that takes what comes."""
    bus = SerialBus(name="garbage", port="loop://")
    await bus.open()
    sensor = LineSensor(name="x", bus=bus)
    hearing = asyncio.ensure_future(_hear(sensor))
    await asyncio.sleep(0)
    begin = time.process_time()
    for at in range(0, MEGABYTE, PIECE):
        # As the port's thread or the selector hands it over.
        bus._received(data[at : at + PIECE])
        await asyncio.sleep(0)
    cost = time.process_time() - begin
    hearing.cancel()
    await asyncio.wait({hearing})
    await bus.close()
    return cost


async def _hear(sensor: LineSensor) -> None:
    async for _ in sensor.stream():
        pass
