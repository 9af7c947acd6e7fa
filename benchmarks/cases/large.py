"""P10: the life of a large robot, and what it costs to change one."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Callable, Coroutine, Iterator
from typing import Any

import esair
from benchmarks.cases.components import Decide, Idle, Meter, Motor
from benchmarks.harness import Row, ms, repeated
from esair.loop import TurnLoop
from esair.testing import VirtualLoop

FEW = 1_000
"""Reactions of the robot that one of four times as many is compared with."""

MOST = 10_000
REQUESTS = 5_000


class Rare(Decide):
    """One that is there, and hardly ever steps."""

    rate = None  # type: ignore[assignment]


class RareMeter(Meter):
    rate = 0.01


def robot_of(reactions: int, sensors: int, motors: int) -> esair.Robot:
    """Make a robot whose reactions share sensors and actuators in turn."""
    return esair.Robot(
        resources=[
            *(RareMeter(name=f"meter_{number}") for number in range(sensors)),
            *(Motor(name=f"motor_{number}") for number in range(motors)),
        ],
        behaviors=[
            Rare(
                name=f"decide_{number}",
                reads={"meter": esair.reads(float, name=f"meter_{number % sensors}")},
                writes={"motor": esair.writes(float, name=f"motor_{number % motors}")},
            )
            for number in range(reactions)
        ],
    )


async def rows() -> list[Row]:
    return await asyncio.to_thread(_rows)


def _rows() -> list[Row]:
    found: list[Row] = []
    for case, shared in (("", 1), (", 20 share an actuator", 20)):
        best: dict[tuple[int, str], float] = {}
        for _ in repeated(3):
            for count in (FEW, 4 * FEW):
                shape = count, 2 * -(-count // shared), -(-count // shared)
                for part, cpu in _virtually(_life(*shape)).items():
                    best[count, part] = min(best.get((count, part), cpu), cpu)
        for part in ("start", "why of all", "stop"):
            few, many = best[FEW, part], best[4 * FEW, part]
            text = f"P10 {part}: {4 * FEW:,} reactions to {FEW:,}{case}"
            found.append(Row(text, ms(many), ms(few), many / few, 4.5, "CPU"))
    expired = min(_virtually(_expired()) for _ in repeated(3))
    text = f"P10 {REQUESTS:,} requests expire together"
    found.append(Row(text, ms(expired), "200 ms", expired / 0.2, 1.0, "CPU"))
    life = _virtually(_life(MOST, MOST // 10, MOST // 20))
    text = f"P10 {MOST:,} reactions on {MOST // 10:,} sensors, {MOST // 20:,} motors"
    start = life["start"]
    found.append(Row(f"{text} start", ms(start), "10 s", start / 10, 1.0, "CPU"))
    with asyncio.Runner(loop_factory=TurnLoop) as runner:
        stretches = runner.run(_stretches())
    for what, stretch in stretches.items():
        text = f"P10 add {what} beside {MOST:,}: its longest stretch"
        found.append(Row(text, ms(stretch), "1 ms", stretch / 1e-3, 1.0, "CPU"))
    return found


def _virtually(main: Coroutine[Any, Any, Any]) -> Any:
    with asyncio.Runner(loop_factory=VirtualLoop) as runner:
        return runner.run(main)


async def _life(reactions: int, sensors: int, motors: int) -> dict[str, float]:
    """Start a robot, ask why of all, stop it; return the CPU of each, in seconds."""
    robot, clock = robot_of(reactions, sensors, motors), time.thread_time
    start = clock()
    await robot.__aenter__()
    started = clock()
    asked = []
    for _ in range(3):  # the first finds nothing in the processor's cache
        begin = clock()
        for number in range(motors):
            robot.resources.why(f"motor_{number}")
        asked.append(clock() - begin)
    stopping = clock()
    await robot.stop("it is measured")
    return {
        "start": started - start,
        "why of all": min(asked),
        "stop": clock() - stopping,
    }


async def _expired() -> float:
    """Return the CPU of requests that nobody answers, when their time is over.

    They are those of two robots: 4,096 may wait in one at a time.
    """
    async with contextlib.AsyncExitStack() as stack:
        asked: list[asyncio.Task[Any]] = []
        for robot in range(2):
            askers = [Idle(name=f"asker_{n}") for n in range(-(-REQUESTS // 32))]
            givers = [Idle(name=f"giver_{n}") for n in range(len(askers))]
            await stack.enter_async_context(
                esair.Robot(name=f"robot_{robot}", behaviors=[*askers, *givers])
            )
            asked += [
                asyncio.create_task(
                    askers[n // 16].get(f"giver_{n % len(givers)}", interval=1.0)
                )
                for n in range(REQUESTS // 2)
            ]
        await asyncio.sleep(0.9)
        begin = time.thread_time()
        ends = await asyncio.gather(*asked, return_exceptions=True)
        spent = time.thread_time() - begin
    assert {type(end) for end in ends} == {esair.BehaviorUnavailableError}
    return spent


async def _stretches() -> dict[str, float]:
    """Return how long the loop is held at a time while something is added."""
    third = MOST // 3
    async with robot_of(third, third, third) as robot:
        await asyncio.sleep(0.5)
        found = {}
        changes: tuple[tuple[str, Any, Callable[..., Any]], ...] = (
            ("a behavior", robot.behaviors, Idle),
            ("a sensor", robot.resources, RareMeter),
            ("an actuator", robot.resources, Motor),
        )
        for what, there, kind in changes:
            longest = []
            for number in repeated(5):
                with _held() as held:
                    await there.add(kind(name=f"new_{number}"))
                longest.append(max(held))
                await there.remove(f"new_{number}")
            found[what] = sorted(longest)[len(longest) // 2]
    return found


@contextlib.contextmanager
def _held() -> Iterator[list[float]]:
    """Note how long each callback of the loop takes, in seconds of CPU."""
    held: list[float] = []
    handles: Any = asyncio.Handle
    run = handles._run

    def timed(handle: asyncio.Handle) -> None:
        begin = time.thread_time()
        run(handle)
        held.append(time.thread_time() - begin)

    handles._run = timed
    try:
        yield held
    finally:
        handles._run = run
