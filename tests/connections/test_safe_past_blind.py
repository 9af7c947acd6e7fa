"""What is safe passes a blind hold: on a free line, a busy one, and one that fails."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from typing import Any, NamedTuple

import pytest

import esair
from esair import Refused
from esair.journal import Event, Kind
from esair.testing import FakeActuator, FakeSensor

pytestmark = [pytest.mark.virtual_clock, pytest.mark.promise("PRO-1", "AC-2")]


class Watch(esair.Reaction):
    """It would stop what comes close, and has never heard its sonar."""

    sonar = esair.reads(float)
    wheels = esair.writes(float, priority=10)

    def react(self, sonar: float) -> None:
        return None


class Captain(esair.Behavior):
    """One with two hands: the strong one goes before the blind one, the gentle does not."""

    strong = esair.writes(float, name="wheels", priority=20, blind="release")
    gentle = esair.writes(float, name="wheels", priority=0, blind="release")


class Other(esair.Behavior):
    wheels = esair.writes(float, priority=5)


class Running(NamedTuple):
    wheels: FakeActuator[float]
    captain: Captain
    other: Other


@pytest.fixture
async def running() -> AsyncIterator[Running]:
    """A robot whose captain moves the wheels, and whose watch is blind."""
    wheels, sonar = FakeActuator("wheels", safe=0.0), FakeSensor("sonar", 1.0)
    captain, other = Captain(), Other()
    sonar.unplug()
    async with esair.Robot(
        resources=[sonar, wheels], behaviors=[Watch(), captain, other]
    ):
        yield Running(wheels, captain, other)


async def test_it_ends_the_motion_of_the_same_behavior(running: Running) -> None:
    """At once, and its time-out sends nothing more; a motion is refused."""
    wheels, captain, _ = running
    assert await captain.strong.write(0.5)
    refused = await captain.gentle.write(0.2)
    assert isinstance(refused, Refused)
    assert refused.holder == "watch"
    assert await captain.gentle.write(0.0)
    told = list(wheels.commands)
    assert told[-2:] == [0.5, 0.0]
    await asyncio.sleep(1.0)
    assert wheels.commands == told


async def test_who_holds_it_keeps_what_is_safe_away(running: Running) -> None:
    """A blind hold in between makes nobody stronger than who sees."""
    wheels, captain, other = running
    assert await captain.strong.write(0.5)
    refused = await other.wheels.write(0.0)
    assert isinstance(refused, Refused)
    assert wheels.commands[-1] == 0.5


async def test_on_a_busy_line_it_waits_for_its_turn(running: Running) -> None:
    """It is the last on the wire."""
    wheels, captain, _ = running
    wheels.slow(0.05)
    moves = asyncio.create_task(captain.strong.write(0.5))
    await asyncio.sleep(0.01)
    assert await captain.gentle.write(0.0)
    assert await moves
    assert wheels.commands[-2:] == [0.5, 0.0]


async def test_a_driver_that_fails_is_told_to_who_asked(running: Running) -> None:
    """Safe was not taken: that is an error, no answer."""
    wheels, captain, _ = running
    assert await captain.strong.write(0.5)
    wheels.fail(OSError("no acknowledge"))
    with pytest.raises(esair.DeviceFaultError, match="no acknowledge"):
        await captain.gentle.write(0.0)


@pytest.mark.parametrize("seconds", [0.0, 0.05])
async def test_a_motion_that_it_did_not_end_is_ended_by_its_time_out(
    running: Running, seconds: float
) -> None:
    """The device has not taken what is safe: it moves on, and its dead man knows."""
    wheels, captain, _ = running
    assert await captain.strong.write(0.5)
    wheels.fail(OSError("no acknowledge"))
    wheels.slow(seconds)
    with pytest.raises(esair.DeviceFaultError):
        await captain.gentle.write(0.0)
    assert wheels.commands[-1] == 0.5
    await wheels.until(0.0, timeout=0.4)


@pytest.mark.promise("ROB-4")
async def test_a_write_that_waits_is_told_when_a_halt_refuses_it(
    fake_actuator: Any,
) -> None:
    """Once: that it was wanted, as of one that leaves, and by what it was refused."""
    wheels, other = fake_actuator("wheels", safe=0.0), Other()
    robot = esair.Robot(resources=[wheels], behaviors=[other])
    events: list[Event] = []
    async with robot:
        robot.journal.listen(events.append, kinds=[Kind.COMMAND, Kind.REFUSED])
        wheels.slow(0.05)
        await asyncio.gather(other.wheels.write(0.5), other.wheels.write(0.6))
        first = asyncio.create_task(other.wheels.write(0.5))
        await asyncio.sleep(0.01)
        waits = asyncio.create_task(other.wheels.write(0.7))
        await asyncio.sleep(0.01)
        await robot.halt("somebody is in the cell")
        refused = await waits
        assert isinstance(refused, Refused)
        assert refused.holder == "halt"
        await first
    told = [event.value for event in events]
    assert told == [0.5, 0.6, 0.5, 0.7, refused]
    assert 0.7 not in wheels.commands
