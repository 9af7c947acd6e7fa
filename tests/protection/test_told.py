"""What `check` and `why` tell of each actuator agrees, and says all of it."""

from __future__ import annotations

import asyncio
import logging
from typing import Any

import attrs
import pytest
from tests.protection.road import Drive, ObstacleGuard, ObstacleStop

import esair
from esair.plan import Plan, examine, protection
from esair.testing import FakeActuator, FakeSensor

pytestmark = [pytest.mark.virtual_clock, pytest.mark.promise("PRO-13", "GRD-2")]


class Framed(FakeActuator[float]):
    """Its driver can say its safe command ahead."""

    own_timeout = 0.5

    def safe_frames(self) -> Any:
        raise AssertionError("check opens nothing, and asks nobody")


def test_check_tells_who_writes_who_guards_and_what_happens_when() -> None:
    """Of each actuator: blind, this process dead, this computer dead."""
    sonar = FakeSensor("sonar", 2.0, type=float)
    wheels: FakeActuator[float] = FakeActuator("wheels", safe=0.0)
    framed = Framed("framed", safe=0.0)
    behaviors = [Drive(), ObstacleStop(), ObstacleGuard()]
    plan = Plan(resources=[sonar, wheels, framed], behaviors=behaviors, watchdog=True)
    bare, watched = protection(plan)

    assert [attrs.astuple(each) for each in bare.guards] == [
        ("obstacle_guard", 0, "nothing passes", False)
    ]
    assert [attrs.astuple(each) for each in bare.writers] == [
        ("obstacle_stop", "reaction", 100, "the actuator is kept safe"),
        ("drive", "behavior", 0, "it has no say"),
    ]
    assert bare.sent_by == "esair: 0.2 s after the last command, and at every exit"
    unwatched = "UNWATCHED: its driver cannot say its safe command as bytes"
    assert bare.when_the_process_dies == unwatched
    assert bare.when_the_host_dies == "it keeps its last command"
    assert watched.when_the_process_dies == "the watchdog sends its safe command"
    assert watched.when_the_host_dies == "it stops itself after 0.5 s"
    (bare, watched) = protection(Plan(resources=[wheels, framed]))
    assert watched.when_the_process_dies == "UNWATCHED: the robot has no watchdog"


async def test_why_tells_the_same_of_a_robot_that_runs() -> None:
    """And how each of them stands now."""
    sonar = FakeSensor("sonar", 2.0, type=float)
    wheels: FakeActuator[float] = FakeActuator("wheels", safe=0.0)
    async with esair.Robot(
        resources=[sonar, wheels],
        behaviors=[Drive(), ObstacleStop(), ObstacleGuard()],
    ) as robot:
        (why,) = robot.resources.why()
        assert len(why.writers) == 2
        assert why.writers[0].startswith("obstacle_stop writes with priority 100")
        assert any("obstacle_guard guards it" in each for each in why.guards)
        assert why.dies == (
            "when this process dies: UNWATCHED, the robot has no watchdog; "
            "when this computer dies: it keeps its last command"
        )
        assert why.dies in str(why)


def test_what_could_not_be_made_is_not_said_to_be_missing() -> None:
    """A guard with a mistake in the file is a mistake, not a robot without a guard."""
    wheels: FakeActuator[float] = FakeActuator("wheels", safe=0.0, command_timeout=0.2)
    parts: Any = {"resources": [wheels], "behaviors": [Drive()]}
    bare = [each.rule for each in examine(Plan(**parts))]
    assert bare == ["protect"]
    unmade = Plan(**parts, missing={"keep_clear": "behavior"})
    assert [each.rule for each in examine(unmade)] == []


async def test_the_log_says_that_a_guard_stops_and_lets_pass_again(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """Once each, although the guard is asked at every command."""
    caplog.set_level(logging.INFO, "esair")

    class Slowly(esair.Reaction):
        sonar = esair.reads(float)
        wheels = esair.guards(float)

        def react(self, sonar: float, wheels: float) -> float | None:
            return wheels if wheels < 0.8 else None

    sonar = FakeSensor("sonar", 1.0, type=float)
    wheels = FakeActuator("wheels", safe=0.0)
    drive: Any = esair.Behavior(name="drive", writes={"wheels": esair.writes(float)})
    robot = esair.Robot(resources=[sonar, wheels], behaviors=[drive, Slowly()])
    async with robot:
        caplog.clear()
        for speed in (1.0, 1.0, 0.5, 0.5):
            assert bool(await drive.wheels.write(speed)) == (speed < 0.8)
        told = [r.getMessage() for r in caplog.records if "slowly" in r.getMessage()]
    assert [line.partition(" lets ")[2] for line in told] == [
        "nothing pass",
        "commands pass again",
    ]


async def test_who_may_write_is_told_with_what_happens_when_it_is_blind(
    fake_sensor: Any, fake_actuator: Any
) -> None:
    """A hold of its own is what counts, and no guard of the same name."""

    class Stops(esair.Reaction):
        sonar = esair.reads(float)
        wheels = esair.writes(float, priority=10)

        def react(self, sonar: float) -> float | None:
            return None

    class Lets(Stops):
        wheels = esair.writes(float, blind="release")

    resources = [fake_sensor("sonar", 1.0), fake_actuator("wheels", safe=0.0)]
    async with esair.Robot(resources=resources, behaviors=[Stops(), Lets()]) as robot:
        assert robot.resources.why("wheels").writers == (
            "stops writes with priority 10; when blind: safe",
            "lets writes with priority 0; when blind: release",
        )


async def test_why_names_the_loss_of_a_device_before_anything_else() -> None:
    """Whoever is blind keeps a device still that is there; of one that is lost, that."""
    sonar = FakeSensor("sonar", 2.0, type=float)
    wheels: FakeActuator[float] = FakeActuator("wheels", safe=0.0)
    async with esair.Robot(
        resources=[sonar, wheels], behaviors=[Drive(), ObstacleStop()]
    ) as robot:
        await wheels.until(lambda command: command > 0.0)
        sonar.unplug()
        wheels.unplug()
        await asyncio.sleep(1.0)
        why = robot.resources.why("wheels")
        assert str(why).startswith("wheels is lost: it is unplugged\n")
        assert (why.holder, why.frees) == (None, "the device, when it is back")
        wheels.plug()
        await asyncio.sleep(5.0)
        assert robot.resources.why("wheels").holder == "obstacle_stop"
