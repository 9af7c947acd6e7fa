"""What a turn means on each event loop: ``python -m tests.turn.passes``.

For each loop it prints how many turns lie between a reading that a device pushes and the
command that leaves for it, between a loss that a driver tells and LOST, and in which order
things of one moment are called.
"""

from __future__ import annotations

import asyncio
from typing import NamedTuple

from tests.turn.loops import LOOPS, Make, run

import esair
from esair.loop import Deadlines, DeadMan, Order, Scheduler, turn_of

MOMENT = 0.05


class Meaning(NamedTuple):
    """What was seen on one loop."""

    to_command: list[int]  # turns from each reading to its command
    to_lost: int  # turns from the loss told to LOST
    at_once: bool  # whether it is LOST before the border
    order: list[str]  # of what is due at one moment


class Pushes(esair.Sensor[float]):
    """Pushes what a test puts in."""

    blocking = False

    def __init__(self) -> None:
        super().__init__(name="sonar")
        self.values: asyncio.Queue[float] = asyncio.Queue()
        self.turns: list[int] = []

    async def read(self) -> float:
        return 0.0

    async def stream(self):  # type: ignore[no-untyped-def]
        while True:
            value = await self.values.get()
            self.turns.append(turn_of(asyncio.get_running_loop()).number)
            yield value


class Counts(esair.Actuator[float]):
    """Keeps in which turn a command has come."""

    value_type = float
    safe = 0.0
    blocking = False

    def __init__(self) -> None:
        super().__init__(name="wheels")
        self.turns: list[int] = []

    async def write(self, command: float) -> None:
        if command:
            self.turns.append(turn_of(asyncio.get_running_loop()).number)


class Drives(esair.Reaction):
    sonar = esair.reads(float)
    wheels = esair.writes(float)

    def react(self, sonar: float) -> float:
        return sonar


async def in_order() -> list[str]:
    """Set what is due at one moment, the last first; return the order of the calls.

    Again if the computer was held up: a deadline is put off then.
    """
    clock = turn_of(asyncio.get_running_loop()).clock
    for _ in range(20):
        began = clock()
        called = await _one_moment()
        if clock() - began < 3.5 * MOMENT:
            break
    return called


async def _one_moment() -> list[str]:
    loop = asyncio.get_running_loop()
    scheduler, called = Scheduler.of(loop), list[str]()
    due = turn_of(loop).time() + MOMENT
    DeadMan(loop, lambda: due, lambda: called.append("dead man")).arm()
    deadlines = Deadlines.of(loop)
    deadlines.at(due, lambda: called.append("stale"), order=Order.STALE)
    deadlines.idle(called.append, "deadline").start(due)
    scheduler.at(due, lambda _: called.append("due"))
    await asyncio.sleep(3 * MOMENT)
    return called


async def seen() -> Meaning:
    """See what a turn means on the running loop."""
    loop = asyncio.get_running_loop()
    sonar, wheels = Pushes(), Counts()
    robot = esair.Robot(resources=[sonar, wheels], behaviors=[Drives()])
    async with robot:
        for _ in range(500):  # however busy the computer is
            if robot.resources.query("wheels").state is esair.ResourceState.READY:
                break
            await asyncio.sleep(0.005)
        await asyncio.sleep(0.02)
        for number, value in enumerate((0.1, 0.2, 0.3)):
            for _ in range(10):  # a loop that was held up makes safe what moves
                sonar.values.put_nowait(value)
                for _ in range(100):
                    if len(wheels.turns) > number:
                        break
                    await asyncio.sleep(0.005)
                if len(wheels.turns) > number:
                    break
                sonar.turns.pop()
        told = turn_of(loop).number
        wheels.report_lost()
        state = robot.resources.query("wheels").state
        at_once = state is esair.ResourceState.LOST
        for _ in range(20):
            if robot.resources.query("wheels").state is esair.ResourceState.LOST:
                break
            await asyncio.sleep(0)
        lost = turn_of(loop).number - told
    passed = [b - a for a, b in zip(sonar.turns, wheels.turns, strict=True)]
    return Meaning(passed, lost, at_once, await in_order())


def meanings() -> dict[str, Meaning]:
    """Return what a turn means, by loop."""
    return {name: meaning_on(make) for name, make in LOOPS.items()}


def meaning_on(make: Make) -> Meaning:
    """Return what a turn means on a loop of a kind."""
    return run(make, seen())


if __name__ == "__main__":
    for name, meaning in meanings().items():
        print(  # noqa: T201 - that is its purpose
            f"{name:10} reading to command {meaning.to_command}"
            f"  told to lost {meaning.to_lost} (at once: {meaning.at_once})"
            f"  one moment: {', '.join(meaning.order)}"
        )
