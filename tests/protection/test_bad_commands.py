"""Who wants what must not be sent cannot decide: it is blind until it can."""

from __future__ import annotations

import asyncio
import math
from typing import Any

import pytest

import esair
from esair.messages import BehaviorState, Refused
from esair.testing import FakeActuator, FakeSensor

pytestmark = [pytest.mark.virtual_clock, pytest.mark.promise("PRO-1")]

STEP = 0.05


class Drive(esair.Behavior):
    """Wants to move all the time."""

    def __init__(self, name: str = "drive", priority: int = 0) -> None:
        writes = {"wheels": esair.writes(float, priority=priority)}
        super().__init__(name=name, writes=writes)
        self.answers: list[Any] = []

    async def run(self) -> None:
        async for _ in esair.every(STEP):
            self.answers.append(await self.wheels.write(0.5))


class Avoid(esair.Reaction):
    """Wants what its table says."""

    sonar = esair.reads(float)
    wheels = esair.writes(float, priority=10)
    table: dict[float, Any]

    def react(self, sonar: float) -> Any:
        return self.table.get(sonar)


def parts(bad: Any, **options: Any) -> tuple[Any, Any, Avoid]:
    """Make a sonar, wheels, and what is fine at 1, bad at 2 and moves at 3."""
    avoid = Avoid(**options)
    avoid.table = {2.0: bad, 3.0: -0.5}
    wheels = FakeActuator("wheels", safe=0.0, limits=(-1.0, 1.0))
    return FakeSensor("sonar", 1.0, rate=20.0), wheels, avoid


@pytest.mark.parametrize("bad", [math.nan, "x", 2.0, {"wheels": math.inf}])
async def test_nobody_with_less_drives_on_a_bad_command(bad: Any) -> None:
    """Safe at once, whoever drove; the refusal names the command, as `why` does."""
    sonar, wheels, avoid = parts(bad)
    drive = Drive()
    async with esair.Robot(
        resources=[sonar, wheels], behaviors=[avoid, drive]
    ) as robot:
        await asyncio.sleep(4 * STEP)
        assert wheels.commands[-1] == 0.5
        sonar.feed(2.0)
        await asyncio.sleep(2 * STEP)
        told, drive.answers = len(wheels.commands), []
        await asyncio.sleep(10 * STEP)

        assert wheels.commands[-1] == 0.0
        assert wheels.commands[told:] == []
        assert {type(each) for each in drive.answers} == {Refused}
        refused = drive.answers[-1]
        assert (refused.holder, refused.until) == ("avoid", None)
        assert refused.rule.startswith("avoid is blind: its command is bad: wheels: ")
        assert refused.since == drive.answers[0].since
        assert robot.resources.why("wheels").holder == "avoid"
        status = robot.behaviors.query("avoid")
        assert status.state is BehaviorState.PARKED
        assert status.detail in refused.rule
        assert status.restarts == 0

        sonar.feed(1.0)  # it decides again: no opinion
        await wheels.until(0.5, timeout=4 * STEP)
        assert robot.behaviors.query("avoid").state is BehaviorState.RUNNING


async def test_who_has_more_drives_on() -> None:
    """Undisturbed, and what the blind one held itself is over."""
    sonar, wheels, avoid = parts(math.nan)
    captain = Drive("captain", priority=11)
    async with esair.Robot(resources=[sonar, wheels], behaviors=[avoid, captain]):
        sonar.feed(2.0)
        await asyncio.sleep(0.5)
        assert set(wheels.commands[1:]) == {0.5}
        assert all(captain.answers)


async def test_it_counts_though_another_command_wins() -> None:
    """The moment that one lets go, nobody with less moves: it was bad all the time."""
    sonar, wheels, avoid = parts(math.nan)
    low, high = Drive("low"), Drive("high", priority=11)
    async with esair.Robot(resources=[sonar, wheels], behaviors=[avoid, low]) as robot:
        sonar.feed(2.0)
        await robot.behaviors.add(high)
        await asyncio.sleep(0.5)
        assert wheels.commands[-1] == 0.5
        await robot.behaviors.remove("high")
        told = len(wheels.commands)
        await asyncio.sleep(0.5)
        assert 0.5 not in wheels.commands[told:]
        assert wheels.commands[-1] == 0.0


async def test_where_an_opinion_may_be_missing_others_get_through() -> None:
    """Its own last command is over at once."""
    release = {"wheels": esair.writes(float, priority=10, blind="release")}
    sonar, wheels, avoid = parts(math.nan, writes=release)
    async with esair.Robot(resources=[sonar, wheels], behaviors=[avoid, Drive()]):
        sonar.feed(3.0)
        await wheels.until(-0.5, timeout=1.0)
        sonar.feed(2.0)
        await wheels.until(0.5, timeout=2 * STEP)
        await asyncio.sleep(0.5)
        assert wheels.commands[-1] == 0.5


async def test_one_bad_command_of_two_blinds_for_both() -> None:
    """A decision is one: nothing of it is sent, whatever the order of the ports."""

    class Both(esair.Reaction):
        sonar = esair.reads(float)
        left = esair.writes(float)
        right = esair.writes(float)

        def react(self, sonar: float) -> Any:
            bad = {2.0: "left", 3.0: "right"}.get(sonar)
            return {
                each: math.nan if each == bad else 0.5 for each in ("left", "right")
            }

    sonar = FakeSensor("sonar", 1.0, rate=20.0)
    wheels = [FakeActuator(name, safe=0.0) for name in ("left", "right")]
    async with esair.Robot(resources=[sonar, *wheels], behaviors=[Both()]):
        for reading in (2.0, 3.0):
            await asyncio.gather(*(each.until(0.5, timeout=1.0) for each in wheels))
            sonar.feed(reading)
            await asyncio.sleep(2 * STEP)
            told = [len(each.commands) for each in wheels]
            await asyncio.sleep(4 * STEP)
            assert [each.commands[-1] for each in wheels] == [0.0, 0.0]
            assert [len(each.commands) for each in wheels] == told
            sonar.feed(1.0)


async def test_a_step_that_is_blind_by_its_command_ends_with_its_error() -> None:
    """After `blind_timeout`, as with a sensor that is away."""
    sonar, wheels, avoid = parts(math.nan)

    class Captain(esair.Behavior):
        error: Any = None

        async def run(self) -> None:
            try:
                await self.perform(avoid, blind_timeout=0.3)
            except esair.BadValueError as error:
                self.error = error
                await self.stop_robot("seen")

    captain = Captain()
    async with esair.Robot(resources=[sonar, wheels], behaviors=[captain]) as robot:
        sonar.feed(2.0)
        await asyncio.sleep(0.2)
        detail = robot.behaviors.query("captain").detail
        await asyncio.wait_for(robot.ended(), 1.0)

    assert detail.startswith("step avoid is blind: its command is bad: ")
    assert captain.error.component == "wheels"
    assert -0.5 not in wheels.commands
