"""P10 and P12: adding and removing a component, and the memory that one takes."""

from __future__ import annotations

import asyncio
import statistics
import time
import tracemalloc

import esair
from benchmarks.cases.components import Idle, Meter, reacting_robot
from benchmarks.harness import Row, ms, percentile, repeated, us

PAIRS = 300


async def rows() -> list[Row]:
    return [await _pair(), await _disturbance(), await _memory(), await _port()]


async def _pair() -> Row:
    """P10: the CPU of one add and one remove."""
    async with esair.Robot(resources=[Meter()]) as robot:
        spent = []
        for _ in range(9):
            begin = time.process_time()
            for number in range(PAIRS // 9):
                await robot.behaviors.add(Idle(name=f"idle_{number}"))
                await robot.behaviors.remove(f"idle_{number}")
            spent.append((time.process_time() - begin) / (PAIRS // 9))
    pair = statistics.median(spent)
    return Row("P10 add and remove a behavior", us(pair), "250 us", pair / 250e-6, 1.0)


async def _disturbance() -> Row:
    """P10: how much later the others are while a component comes and goes at 100 Hz."""

    async def p99(swapping: bool) -> float:
        late: list[float] = []
        robot = reacting_robot(50, acting=0)
        async with robot:
            for name in robot.behaviors.names():
                runner = robot._behaviors.members[name].runner
                assert runner is not None
                group = runner.job.group
                assert group is not None

                def timed(
                    now: float,
                    step: object = runner.job.function,
                    group: object = group,
                ) -> object:
                    late.append(time.monotonic() - group.moment / 1e9)  # type: ignore[attr-defined]
                    return step(now)  # type: ignore[operator]

                runner.job.function = timed  # type: ignore[assignment]
            await asyncio.sleep(0.2)
            late.clear()
            end = time.monotonic() + 1.5
            number = 0
            while time.monotonic() < end:
                number += 1
                if swapping:
                    await robot.behaviors.add(Idle(name=f"idle_{number}"))
                    await robot.behaviors.remove(f"idle_{number}")
                await asyncio.sleep(0.01)
        return percentile(late, 0.99)

    with_swaps = statistics.median([await p99(True) for _ in repeated(3)])
    without = statistics.median([await p99(False) for _ in repeated(3)])
    growth = max(0.0, with_swaps - without)
    return Row(
        "P10 p99 lateness of others grows by", ms(growth), "1 ms", growth / 1e-3, 1.0
    )


async def _memory() -> Row:
    """P12: an idle behavior with its inbox."""
    count = 1000
    async with esair.Robot() as robot:
        await robot.behaviors.add(Idle(name="first"))
        tracemalloc.start()
        before = tracemalloc.get_traced_memory()[0]
        for number in range(count):
            await robot.behaviors.add(Idle(name=f"idle_{number}"))
        size = (tracemalloc.get_traced_memory()[0] - before) / count
        tracemalloc.stop()
    return Row(
        "P12 memory of an idle behavior",
        f"{size / 1024:.2f} KB",
        "3 KB",
        size / 3072,
        1.0,
    )


async def _port() -> Row:
    """P12: a registered port."""
    count = 2000
    keep: list[object] = []

    class Asks(esair.Behavior):
        async def setup(self) -> None:
            tracemalloc.start()
            before = tracemalloc.get_traced_memory()[0]
            keep.extend(
                [
                    await self.register(
                        f"meter_{number % 20}", esair.Access.READ, priority=number
                    )
                    for number in range(count)
                ]
            )
            self.size = (tracemalloc.get_traced_memory()[0] - before) / count
            tracemalloc.stop()

    asks = Asks()
    meters = [Meter(name=f"meter_{number}") for number in range(20)]
    async with esair.Robot(resources=meters, behaviors=[asks]):
        pass
    return Row(
        "P12 memory of a registered port",
        f"{asks.size:.0f} B",
        "512 B",
        asks.size / 512,
        1.0,
    )
