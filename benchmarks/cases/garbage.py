"""P13: the garbage collector while a robot runs."""

from __future__ import annotations

import asyncio
import gc
import time

from benchmarks.cases.components import reacting_robot
from benchmarks.harness import Row, ms

SECONDS = 4.0


async def rows() -> list[Row]:
    bare_pause, _ = await _watch(with_robot=False)
    pause, full = await _watch(with_robot=True)
    return [
        Row(
            "P13 full collections while a robot runs", str(full), "0", float(full), 0.0
        ),
        Row(
            "P13 longest pause of the collector",
            ms(pause),
            ms(bare_pause),
            pause / bare_pause,
            2.0,
            "without esair: the same garbage, collector as Python sets it",
        ),
    ]


async def _watch(*, with_robot: bool) -> tuple[float, int]:
    """Make garbage for some seconds; return the longest pause and the full runs."""
    longest, full, begin = 0.0, 0, 0.0

    def see(phase: str, info: dict[str, int]) -> None:
        nonlocal longest, full, begin
        if phase == "start":
            begin = time.perf_counter()
        else:
            longest = max(longest, time.perf_counter() - begin)
            full += info["generation"] == 2

    async def litter() -> None:
        for _ in range(int(SECONDS / 0.01)):
            for _ in range(200):
                group: list[object] = []
                group.append(group)
            await asyncio.sleep(0.01)

    kept = [[number] for number in range(20_000)]  # what a program holds
    if with_robot:
        async with reacting_robot(200, acting=10):
            gc.callbacks.append(see)
            await litter()
            gc.callbacks.remove(see)
    else:
        gc.callbacks.append(see)
        await litter()
        gc.callbacks.remove(see)
    del kept
    return longest, full
