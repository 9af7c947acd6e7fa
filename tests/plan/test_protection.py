"""Who moves each actuator, who guards it, and what is said about its protection."""

from __future__ import annotations

from typing import Any

import pytest
from tests.plan import rulebook_parts as parts

import esair
from esair.plan import Guard, Plan, examine, protection

pytestmark = pytest.mark.promise("PRO-13")


class Motor(parts.Wheels):
    """It moves: it says for how long a command is good."""

    command_timeout = 0.2


class Watch(esair.Reaction):
    """A guard."""

    sonar = esair.reads(float)
    wheels = esair.guards(float)

    def react(self, sonar: float, wheels: float) -> float | None:
        return wheels if sonar > 0.4 else None


class Creep(Watch):
    """A guard that decides what passes while it is blind."""

    def blind(self, wheels: float) -> float | None:
        return min(wheels, 0.1)


class Latched(Watch):
    wheels = esair.guards(float, latch=True)


class Level(parts.Brake):
    """A blind hold at the priority of those that it is against."""

    wheels = esair.writes(float)


class Mutable(parts.Brake):
    mute_limit = 60.0


class Pair(esair.Reaction):
    """It commands two motors together."""

    sonar = esair.reads(float)
    wheels = esair.writes(float)
    other = esair.writes(float)

    def react(self, sonar: float) -> dict[str, float]:
        return {"wheels": 0.0, "other": 0.0}


def told(*behaviors: Any, motor: type = Motor) -> list[str]:
    """Return what is said about the protection of a robot."""
    resources = [
        parts.Sonar(name="sonar"),
        motor(name="wheels"),
        parts.Wheels(name="other"),
    ]
    plan = Plan(resources=resources, behaviors=behaviors)
    return [each.text for each in examine(plan) if each.rule == "protect"]


def test_the_table_names_writers_and_guards() -> None:
    """With priorities, and what happens while each of them is blind."""
    plan = Plan(
        resources=[parts.Sonar(), Motor(name="wheels")],
        behaviors=[parts.Drive(), parts.Brake(), Creep(), Watch()],
    )

    (row,) = protection(plan)
    assert [(each.behavior, each.when_blind) for each in row.writers] == [
        ("brake", "the actuator is kept safe"),
        ("drive", "it has no say"),
    ]
    assert row.guards == (
        Guard("creep", 0, "its blind() decides", latch=False),
        Guard("watch", 0, "nothing passes", latch=False),
    )
    assert row.when_the_host_dies == "it keeps its last command"


def test_what_guards_in_the_device_itself_comes_last() -> None:
    """After all guards of the robot, whose priorities say nothing about it."""

    class Board(Motor):
        own_guards = ("bumper",)

    plan = Plan(
        resources=[parts.Sonar(), Board(name="wheels")],
        behaviors=[parts.Drive(), Watch()],
    )
    (row,) = protection(plan)
    guards = [(each.reaction, each.priority) for each in row.guards]
    assert guards == [("watch", 0), ("bumper", 0)]


def test_what_moves_without_protection_is_found() -> None:
    """It says that it moves, a behavior writes it, and nobody is above."""
    (finding,) = told(parts.Drive())
    assert finding.startswith("it moves, and nothing protects it")


@pytest.mark.parametrize("protector", [parts.Brake, Watch])
def test_a_guard_or_a_reaction_above_is_protection(protector: type) -> None:
    """Either is enough."""
    assert told(parts.Drive(), protector()) == []


def test_what_does_not_move_needs_no_protection() -> None:
    """A lamp declares no time-out of its own."""
    assert told(parts.Drive(), motor=parts.Wheels) == []


@pytest.mark.parametrize(("says", "warnings"), [(None, 1), (True, 1), (False, 0)])
def test_an_actuator_says_whether_it_moves(says: bool | None, warnings: int) -> None:
    """A lamp with a time-out of its own is no motor."""

    class Lamp(Motor):
        moves = says

    assert len(told(parts.Drive(), motor=Lamp)) == warnings


@pytest.mark.parametrize("seconds", [0.5, 30.0, 500.0])
def test_milliseconds_for_seconds_are_found(seconds: float) -> None:
    """So long it would move with nobody who commands it."""

    class Held(parts.Drive):
        wheels = esair.writes(float, hold=seconds)

    class Slow(Motor):
        command_timeout = seconds

    plan = Plan(resources=[Slow(name="wheels")], behaviors=[Held()])
    found = [each for each in examine(plan) if each.rule == "time"]
    fields = [each.field for each in found]
    assert fields == (["command_timeout", "wheels.hold"] if seconds > 30.0 else [])
    assert all("moves on for 500 s after" in each.text for each in found)


def test_a_hold_at_the_priority_of_those_it_is_against_is_found() -> None:
    """Blind it stops them, seeing it does not."""
    findings = told(parts.Drive(), Level(), motor=parts.Wheels)
    assert findings == [
        "while it is blind it keeps 'wheels' safe against 'drive', but while it sees "
        "they have the same priority (0): raise its priority"
    ]


def test_a_latch_and_a_mute_limit_are_told() -> None:
    """Somebody has to be there for either."""
    assert "until robot.behaviors.reset('latched')" in told(parts.Drive(), Latched())[0]
    assert told(parts.Drive(), Mutable()) == [
        "the user may mute what it protects for 60 s: 0 if never"
    ]


def test_a_command_of_which_a_part_is_guarded_is_found() -> None:
    """The partner goes on while this one is stopped: the robot turns."""
    assert told(Pair(), Watch()) == [
        "it commands 'wheels' and 'other' together, but only 'wheels' is guarded: "
        "guard 'other' too"
    ]
