"""P13: the garbage collector while a robot runs."""

from __future__ import annotations

import asyncio
import collections
import gc
import os
import time
from pathlib import Path

from benchmarks import harness
from benchmarks.cases.components import reacting_robot
from benchmarks.harness import Row, ms
from esair.loop import collector

OBJECTS = 10_000_000
SECONDS = 60.0
ALIVE = 1_000
"""How many circles are in use at any time: garbage that is not young any more."""


async def rows() -> list[Row]:
    kept = [[number] for number in range(20_000)]  # what a program holds
    seconds = 1.0 if harness.smoke else SECONDS
    start, most = await _watch(seconds)
    counts = collector.counts()
    del kept
    return [
        Row(
            "P13 resident size with 10 million cyclic objects in a minute, to the start's",
            f"{most / 1e6:.0f} MB",
            f"{start / 1e6:.0f} MB",
            most / start,
            3.0,
        ),
        Row(
            "P13 longest pause of the collector in a gap, CPU",
            ms(collector.longest),
            "2 ms",
            collector.longest / 2e-3,
            1.0,
            f"{counts['collections'] - counts['forced']} collections",
        ),
        Row(
            "P13 longest pause in the midst of a step, CPU",
            ms(collector.longest_forced),
            "20 ms",
            collector.longest_forced / 20e-3,
            1.0,
            f"{counts['forced']} collections",
        ),
    ]


async def _watch(seconds: float) -> tuple[float, float]:
    """Make garbage beside a robot; return its size at the start and at most, in bytes."""
    async with reacting_robot(200, acting=10):
        await _litter(seconds / 30)  # what a full heap looks like
        gc.collect()
        collector.reset()
        start = _resident()
        return start, await _litter(seconds)


async def _litter(seconds: float) -> float:
    alive: collections.deque[object] = collections.deque(maxlen=ALIVE)
    made, most, begin = 0, 0.0, time.monotonic()
    while made < seconds * OBJECTS / SECONDS:
        due = (time.monotonic() - begin) * OBJECTS / SECONDS
        while made < due:
            circle: list[object] = []
            circle.append(circle)
            alive.append(circle)
            made += 1
        most = max(most, _resident())
        await asyncio.sleep(0.01)
    return most


def _resident() -> float:
    """Return the size of this process in memory, in bytes."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return float(pages * os.sysconf("SC_PAGE_SIZE"))
