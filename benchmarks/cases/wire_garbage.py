"""P21: what a megabyte of garbage on a wire costs each framing."""

from __future__ import annotations

import random
import time

from benchmarks.harness import Row, ms
from esair.framing import Cobs, Framing, LengthCrc, Lines, Sentences

MEGABYTE = 1 << 20
LIMIT = 0.05
PIECE = 1024

GARBAGE = {
    "random": random.Random(1).randbytes(MEGABYTE),
    "zeros": bytes(MEGABYTE),
    "line ends": b"\n" * MEGABYTE,
    "sync bytes": b"\xaa" * MEGABYTE,
}
FRAMINGS: tuple[tuple[str, Framing], ...] = (
    ("length-crc", LengthCrc()),
    ("length-crc, sync AA", LengthCrc(sync=b"\xaa")),
    ("length-crc, 64 KiB", LengthCrc(length_size=2, max_length=65_535)),
    ("lines", Lines()),
    ("nmea", Sentences()),
    ("cobs", Cobs()),
)


async def rows() -> list[Row]:
    rows = []
    for name, framing in FRAMINGS:
        cost, worst = max(
            (_cost(framing.fresh(), data), kind) for kind, data in GARBAGE.items()
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


def _cost(framing: Framing, data: bytes) -> float:
    begin = time.process_time()
    for at in range(0, MEGABYTE, PIECE):
        framing.feed(data[at : at + PIECE])
    return time.process_time() - begin
