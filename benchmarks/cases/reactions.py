"""P5, P6 and P7: what steps cost, and how late they are."""

from __future__ import annotations

import asyncio
import statistics
import time
from collections.abc import Callable

import esair
from benchmarks.cases.components import reacting_robot
from benchmarks.cases.limits import bare_wheel, sleeping_tasks
from benchmarks.harness import (
    Row,
    cpu_share,
    ms,
    neighbors,
    percentile,
    repeated,
    us,
)
from esair.testing import VirtualLoop

SLICE = 0.8
COUNT = 1000
HOUR = 3600.0

GOALS: dict[str, float] = {
    "P5 a step of 1,000 reactions at 100 Hz, 1 in 10 writes": 0.47,
    "P5 a step of 1,000 reactions at 100 Hz, all write": 0.92,
    "P5 the same with plain drivers, 1 in 10 writes": 0.43,
    "P5 the same with plain drivers, all write": 0.82,
}
"""The greatest ratios of P5, by case; 0.8 of those of the last run in which neither side
lost a step or a wake-up (0.590, 1.148, 0.533 and 1.025, in the docs)."""


async def rows() -> list[Row]:
    return [*await _thousand(), *await _one(), await _drift(), *await _growth()]


async def _cpu_of_each(made: Callable[[], int]) -> float:
    """Return the CPU of one of what is made in a slice of time, in seconds.

    On a core that is full fewer are made: what a share of the core says is then how
    many were lost.
    """
    before, cpu = made(), time.process_time()
    await asyncio.sleep(SLICE)
    cpu = time.process_time() - cpu
    return cpu / max(made() - before, 1)


async def _share(robot: esair.Robot) -> float:
    async with robot:
        await asyncio.sleep(0.4)
        return await cpu_share(SLICE)


async def _thousand() -> list[Row]:
    """P5: a thousand reactions at 100 Hz."""

    async def tasks() -> float:
        async with sleeping_tasks(COUNT, 0.01) as late:
            await asyncio.sleep(0.3)
            return await _cpu_of_each(lambda: len(late))

    found = []
    for case, acting, plain in (
        ("P5 a step of 1,000 reactions at 100 Hz, 1 in 10 writes", 10, False),
        ("P5 a step of 1,000 reactions at 100 Hz, all write", 1, False),
        ("P5 the same with plain drivers, 1 in 10 writes", 10, True),
        ("P5 the same with plain drivers, all write", 1, True),
    ):

        async def reactions(acting: int = acting, plain: bool = plain) -> float:
            async with reacting_robot(COUNT, acting=acting, plain=plain) as robot:
                await asyncio.sleep(0.4)
                behaviors = robot.behaviors
                return await _cpu_of_each(
                    lambda: sum(behaviors.query(n).steps for n in behaviors.names())
                )

        mine, limit, ratio = await neighbors(reactions, tasks, rounds=5)
        note = "CPU of a step that was made, of a wake-up that was"
        found.append(Row(case, us(mine), us(limit), ratio, GOALS.get(case), note))
    for case, acting in (
        ("P5 p99 lateness, 1 in 10 writes", 10),
        ("P5 p99 lateness, all write", 1),
    ):
        mine = statistics.median(
            [await _lateness_of_robot(COUNT, acting, 0.99) for _ in repeated(3)]
        )
        limit = statistics.median([await _bare_late(COUNT, 0.99) for _ in repeated(3)])
        note = f"bare wheel: {ms(limit)}"
        found.append(Row(case, ms(mine), "2 ms", mine / 2e-3, 1.0, note))
    return found


async def _lateness_of_robot(count: int, acting: int, share: float) -> float:
    """Compare when each step ran with when its group of the scheduler was due."""
    late: list[float] = []
    robot = reacting_robot(count, acting=acting)
    async with robot:
        for name in robot.behaviors.names():
            runner = robot._behaviors.members[name].runner
            assert runner is not None
            group = runner.job.group
            assert group is not None

            def timed(
                now: float, step: object = runner.job.function, group: object = group
            ) -> object:
                late.append(time.monotonic() - group.moment / 1e9)  # type: ignore[attr-defined]
                return step(now)  # type: ignore[operator]

            runner.job.function = timed  # type: ignore[assignment]
        await asyncio.sleep(0.4)
        late.clear()
        await asyncio.sleep(SLICE)
        return percentile(late, share)


async def _bare_late(count: int, share: float) -> float:
    """Return how late the functions of a bare scheduler are, in seconds."""
    late: list[float] = []

    def step(due: float) -> None:
        late.append(time.monotonic() - due)

    async with bare_wheel([step] * count, 0.01):
        await asyncio.sleep(0.3)
        late.clear()
        await asyncio.sleep(SLICE)
    return percentile(late, share)


async def _one() -> list[Row]:
    """P6: one reaction at 100 Hz alone."""

    async def sleep_late() -> float:
        async with sleeping_tasks(1, 0.01) as late:
            await asyncio.sleep(SLICE)
            return percentile(late, 0.5)

    mine = statistics.median([await _lateness_of_robot(1, 0, 0.5) for _ in repeated(3)])
    scheduler = statistics.median([await _bare_late(1, 0.5) for _ in repeated(3)])
    sleep = statistics.median([await sleep_late() for _ in repeated(3)])
    return [
        Row(
            "P6 p50 lateness of one, to a bare timerfd",
            ms(mine),
            ms(scheduler),
            mine / scheduler,
            1.5,
        ),
        Row(
            "P6 p50 lateness of one, to asyncio.sleep",
            ms(mine),
            ms(sleep),
            mine / sleep,
            0.25,
        ),
    ]


async def _drift() -> Row:
    """P6: an hour of virtual time at 100 Hz."""

    def hour() -> int:
        async def main() -> int:
            class Count(esair.Reaction):
                rate = 100.0

                def react(self) -> None:
                    return None

            async with esair.Robot(behaviors=[Count()]) as robot:
                await asyncio.sleep(HOUR)
                return robot.behaviors.query("count").steps

        with asyncio.Runner(loop_factory=VirtualLoop) as runner:
            return runner.run(main())

    steps = await asyncio.to_thread(hour)
    drift = abs(steps - round(HOUR * 100)) * 0.01
    return Row(
        "P6 drift in an hour of virtual time",
        f"{drift:.2f} s",
        "0.01 s",
        drift / 0.01,
        1.0,
    )


async def _growth() -> list[Row]:
    """P7: what one more step costs, for few and for many reactions."""

    async def share(count: int) -> float:
        return await _share(reacting_robot(count, acting=0))

    idle = await share(0)
    few: list[float] = []
    many: list[float] = []
    for _ in repeated(3):
        few.append((await share(10) - idle) / 10)
        many.append((await share(1000) - idle) / 1000)
    small, large = statistics.median(few), statistics.median(many)
    found = [
        Row(
            "P7 cost of a step: 1,000 reactions to 10",
            us(large / 100),
            us(small / 100),
            large / small,
            1.3,
            "CPU of one step of one reaction",
        )
    ]
    tick = await _tick(100)
    found.append(Row("P7 one tick of 100 ready reactions", us(tick), "", 0.0, None))
    found.extend(_tick_peers(tick))
    return found


async def _tick(count: int) -> float:
    """Return the time of one tick over ready reactions, in seconds."""
    robot = reacting_robot(count, acting=0)
    times = []
    async with robot:
        await asyncio.sleep(0.3)
        steps: list[Callable[[float], object]] = []
        for name in robot.behaviors.names():
            runner = robot._behaviors.members[name].runner
            assert runner is not None
            steps.append(runner.job.function)
        for _ in range(50):
            now = time.monotonic()
            begin = time.perf_counter()
            for step in steps:
                step(now)
            times.append(time.perf_counter() - begin)
            await asyncio.sleep(0.002)
    return statistics.median(times)


def _tick_peers(tick: float) -> list[Row]:
    missing = "not installed: pip install -r benchmarks/requirements-peers.txt"
    found = []
    for case, peer, goal in (
        ("P7 peer: commands2, 100 commands", _commands2, 1 / 4),
        ("P7 peer: py_trees, 100 behaviours", _py_trees, 1 / 8),
    ):
        seconds = peer()
        if seconds is None:
            found.append(Row(case, us(tick), "", 0.0, None, missing))
        else:
            found.append(Row(case, us(tick), us(seconds), tick / seconds, goal))
    return found


def _commands2() -> float | None:
    try:
        import commands2
    except ImportError:
        return None
    scheduler = commands2.CommandScheduler.getInstance()
    for _ in range(100):
        scheduler.schedule(commands2.RunCommand(lambda: None).ignoringDisable(True))
    scheduler.run()
    return _timed(scheduler.run)


def _py_trees() -> float | None:
    try:
        import py_trees
    except ImportError:
        return None
    root = py_trees.composites.Parallel(
        "root", policy=py_trees.common.ParallelPolicy.SuccessOnAll(synchronise=False)
    )
    root.add_children([py_trees.behaviours.Running(f"b{n}") for n in range(100)])
    tree = py_trees.trees.BehaviourTree(root)
    tree.setup()
    return _timed(tree.tick)


def _timed(function: Callable[[], object]) -> float:
    times = []
    for _ in range(50):
        begin = time.perf_counter()
        function()
        times.append(time.perf_counter() - begin)
    return statistics.median(times)
