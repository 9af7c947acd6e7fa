"""P13: the garbage collector while a robot runs."""

from __future__ import annotations

import asyncio
import gc
import os
import time
from pathlib import Path

from benchmarks.cases.components import reacting_robot
from benchmarks.harness import Row, ms
from esair.loop import collector

SECONDS = 10.0

BYTES = 20_000
"""How much each cycle holds."""


async def rows() -> list[Row]:
    kept = [[number] for number in range(20_000)]  # what a program holds
    pause, grown = await _watch()
    del kept
    return [
        Row(
            "P13 memory grows by, with 1,000 cycles of 20 KB a second",
            f"{grown / 1e6:.1f} MB",
            "30 MB",
            grown / 30e6,
            1.0,
        ),
        Row("P13 longest pause of the collector", ms(pause), "2 ms", pause / 2e-3, 1.0),
    ]


async def _watch() -> tuple[float, float]:
    """Make garbage beside a robot; return the longest pause, and by what memory grew."""
    longest, begin = 0.0, 0.0

    def see(phase: str, info: dict[str, int]) -> None:
        nonlocal longest, begin
        if phase == "start":
            begin = time.perf_counter()
        else:
            longest = max(longest, time.perf_counter() - begin)

    async with reacting_robot(200, acting=10):
        await _litter(SECONDS / 4)  # what a full heap looks like
        before, collector.longest = _resident(), 0.0
        gc.callbacks.append(see)
        await _litter(SECONDS)
        gc.callbacks.remove(see)
        longest = max(longest, collector.longest)
        return longest, max(0.0, _resident() - before)


async def _litter(seconds: float) -> None:
    for _ in range(int(seconds / 0.01)):
        for _ in range(10):
            group: list[object] = [bytearray(BYTES)]
            group.append(group)
        await asyncio.sleep(0.01)


def _resident() -> float:
    """Return the size of this process in memory, in bytes."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return float(pages * os.sysconf("SC_PAGE_SIZE"))
