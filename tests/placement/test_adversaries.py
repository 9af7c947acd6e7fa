"""Children that are stuck, swallow, flood or lie: a robot that hears them keeps its time."""

from __future__ import annotations

import asyncio
import logging
import time
from typing import Any

import pytest
from tests import patience
from tests.placement.adversaries import LIES, WORDS, Speaker
from tests.placement.parts import Twist
from tests.placement.test_life import STOP, fake_wheels, place, until

import esair

pytestmark = [
    pytest.mark.real_clock,
    pytest.mark.long,
    pytest.mark.xdist_group("placement"),
]

SILENT = {"swallow", "asks for ever", "long lists for ever"}
"""What is seen by its time alone: its loop does not go on."""

LATE = 0.02
"""How much later the step of somebody else may be for it, in seconds."""


class Steps(esair.Behavior):
    """Somebody else: notes how late each of its steps was."""

    def __init__(self) -> None:
        super().__init__()
        self.late: list[float] = []

    async def run(self) -> None:
        due = time.monotonic()
        async for _ in esair.every(0.01):
            now = time.monotonic()
            self.late.append(now - due - 0.01)
            due = now

    def usual(self) -> float:
        """Return below what nine of ten were since the last time, in seconds."""
        late, self.late = sorted(self.late), []
        return late[int(0.9 * len(late))]


def liar(what: str, **terms: Any) -> Speaker:
    made = Speaker(what)
    place(made, esair.Placement(**{"stall": 2.0, **terms}))
    return made


@pytest.mark.promise("PLC-4", "PLC-5")
@pytest.mark.parametrize("lie", LIES)
async def test_a_lie_is_the_end_of_its_process(lie: str) -> None:
    """What nobody says who keeps to the protocol: it is killed, and nobody else is late."""
    wheels, steps = fake_wheels(), Steps()
    behaviors = [liar(lie), steps]
    async with esair.Robot(resources=[wheels], behaviors=behaviors) as robot:
        await until(lambda: robot.behaviors.query("liar").restarts >= 1)
        error = robot.behaviors.query("liar").error
        assert isinstance(error, esair.ProcessDiedError)
        assert ("hung" in str(error)) == (lie in SILENT), error
        await until(lambda: wheels.commands[-1] == STOP)
        assert set(wheels.commands) <= {STOP, Twist(0.1, 0.0)}
        assert len(asyncio.all_tasks()) < 50
        assert patience.within(LATE, steps.usual())
        assert robot.behaviors.query("steps").restarts == 0


@pytest.mark.promise("PLC-4", "PLC-6", "SEC-1")
@pytest.mark.parametrize("words", WORDS)
async def test_bad_words_are_words(
    words: str, caplog: pytest.LogCaptureFixture
) -> None:
    """A line that is no record is a line; a name is escaped, and no name is kept for ever."""
    caplog.set_level("INFO")
    before = len(logging.root.manager.loggerDict)
    async with esair.Robot(resources=[fake_wheels()], behaviors=[liar(words)]) as robot:
        await until(lambda: "that was it" in caplog.text)
        assert robot.behaviors.query("liar").error is None
    assert len(logging.root.manager.loggerDict) - before < 70
    assert not any("\n" in each.name for each in caplog.records)
    assert "Exception in callback" not in caplog.text


@pytest.mark.promise("PLC-4")
@pytest.mark.parametrize("what", ["lines", "records", "wakes"])
async def test_a_flood_makes_nobody_late(what: str) -> None:
    """However much it says, others have their steps, and it can be removed."""
    steps = Steps()
    async with esair.Robot(
        resources=[fake_wheels()], behaviors=[liar(what), steps]
    ) as robot:
        await asyncio.sleep(0.5)
        steps.usual()
        await asyncio.sleep(1.0)
        late = steps.usual()
        await robot.behaviors.remove("liar")
    assert patience.within(LATE, late)


@pytest.mark.promise("PLC-1", "PLC-3")
async def test_what_takes_more_memory_than_it_may_is_a_crash() -> None:
    """It dies of its own greed, with words, and is started again as it was added."""
    wheels = fake_wheels()
    made = liar("memory", memory=300)
    async with esair.Robot(resources=[wheels], behaviors=[made]) as robot:
        await until(lambda: robot.behaviors.query("liar").restarts >= 1)
        assert isinstance(robot.behaviors.query("liar").error, MemoryError)
        await until(lambda: wheels.commands[-1] == STOP)
        before = len(wheels.commands)
        await until(lambda: Twist(0.1, 0.0) in wheels.commands[before:])


class Taker(esair.Behavior):
    """Takes what is put to it."""

    def __init__(self) -> None:
        super().__init__(name="taker")
        self.taken = 0

    async def run(self) -> None:
        while True:
            await self.receive()
            self.taken += 1


@pytest.mark.promise("PLC-5")
async def test_much_at_once_goes_in_parts() -> None:
    """Calls that have more together than a message may have reach the robot all the same."""
    taker = Taker()
    async with esair.Robot(
        resources=[fake_wheels()], behaviors=[liar("much"), taker]
    ) as robot:
        await until(lambda: taker.taken == 20)
        assert robot.behaviors.query("liar").restarts == 0
