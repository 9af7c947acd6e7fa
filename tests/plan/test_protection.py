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


class MutableGuard(Watch):
    mute_limit = 60.0


class MutableOpinion(parts.Brake):
    wheels = esair.writes(float, blind="release")
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


def test_a_mute_limit_of_what_protects_nothing_is_nobodys_business() -> None:
    """A guard protects, and what has no say while it is blind does not."""
    assert told(parts.Drive(), MutableGuard()) == [
        "the user may mute what it protects for 60 s: 0 if never"
    ]
    assert told(parts.Drive(), MutableOpinion(), motor=parts.Wheels) == []


class Told(Motor):
    """Its device stops by itself, or a broker has its last will, or it can be watched."""

    own_timeout: float | None = None
    will: float | None = None

    @property
    def last_will(self) -> float | None:
        return self.will


class Watched(Told):
    def safe_frames(self) -> Any:
        return None


@pytest.mark.parametrize(
    ("motor", "watchdog", "own", "will", "process", "host"),
    [
        (Told, False, None, None, "UNWATCHED: the robot has no watchdog",
         "it keeps its last command"),
        (Told, True, 0.5, None,
         "UNWATCHED: its driver cannot say its safe command as bytes",
         "it stops itself after 0.5 s"),
        (Told, False, None, 2.0, "its last will is published at once",
         "its last will is published after 2 s"),
        (Watched, True, None, None, "the watchdog sends its safe command",
         "it keeps its last command"),
        (Watched, True, 0.5, 2.0, "the watchdog sends its safe command",
         "it stops itself after 0.5 s"),
    ],
)  # fmt: skip
def test_the_table_says_who_stops_it_when_nobody_can(
    motor: Any, watchdog: bool, own: Any, will: Any, process: str, host: str
) -> None:
    """When this process dies, and when this computer does."""
    wheels = motor(name="wheels")
    wheels.own_timeout, wheels.will = own, will
    (row,) = protection(Plan(resources=[wheels], watchdog=watchdog))
    assert (row.when_the_process_dies, row.when_the_host_dies) == (process, host)
    assert row.own_timeout == own


def test_the_table_says_who_sends_what_is_safe() -> None:
    """And when; one that says it wrongly has no time-out, and no safe command."""
    unsafe: Any = parts.Unsafe(name="bare")
    unsafe.command_timeout = None
    rows = protection(
        Plan(resources=[parts.Sonar(), Motor(name="wheels"), unsafe], behaviors=[])
    )
    assert [(each.name, each.safe, each.command_timeout) for each in rows] == [
        ("wheels", "0.0", 0.2),
        ("bare", None, None),
    ]
    assert [each.sent_by for each in rows] == [
        "esair: 0.2 s after the last command, and at every exit",
        "esair: at every exit",
    ]
    assert [each.driver for each in rows] == [
        f"{__name__}:Motor",
        "tests.plan.rulebook_parts:Unsafe",
    ]


def test_the_table_is_in_the_order_in_which_they_count() -> None:
    """The highest priority first, and equals by their names."""
    ports = {"b": 0, "c": 5, "a": 0}
    writers = [
        esair.Behavior(name=n, writes={"wheels": esair.writes(float, priority=p)})
        for n, p in ports.items()
    ]
    guards = [
        Watch(name=f"g_{n}", guards={"wheels": esair.guards(float, priority=p)})
        for n, p in ports.items()
    ]
    plan = Plan(
        resources=[parts.Sonar(), Motor(name="wheels")], behaviors=[*writers, *guards]
    )
    (row,) = protection(plan)
    assert [(w.behavior, w.priority, w.kind) for w in row.writers] == [
        ("c", 5, "behavior"),
        ("a", 0, "behavior"),
        ("b", 0, "behavior"),
    ]
    assert [(g.reaction, g.priority) for g in row.guards] == [
        ("g_c", 5),
        ("g_a", 0),
        ("g_b", 0),
    ]


def test_where_something_is_missing_nothing_is_said_of_protection() -> None:
    """What could not be made may be what protects it."""
    resources = [parts.Sonar(), Motor(name="wheels")]
    for missing, count in (({"brake": "behavior"}, 0), ({"eye": "sensor"}, 1)):
        plan = Plan(resources=resources, behaviors=[parts.Drive()], missing=missing)
        assert len([f for f in examine(plan) if f.rule == "protect"]) == count


def test_a_reaction_protects_from_above_alone() -> None:
    """Not at the same priority; one that nobody but reactions write needs none."""
    level = parts.Brake(
        name="level", writes={"wheels": esair.writes(float, blind="release")}
    )
    (finding,) = told(parts.Drive(), level)
    assert finding.startswith("it moves, and nothing protects it")
    assert told(level) == []


def test_a_motor_may_say_its_time_out_in_itself() -> None:
    """It moves as one whose class says so."""
    for timeout in (0.2, None):
        wheels = parts.Wheels(name="wheels")
        if timeout is not None:
            wheels.command_timeout = timeout
        plan = Plan(resources=[wheels], behaviors=[parts.Drive()])
        found = [each for each in examine(plan) if each.rule == "protect"]
        assert len(found) == (timeout is not None)


def test_both_parts_guarded_or_none_is_no_half() -> None:
    """And a behavior commands one after the other."""

    class Both(esair.Behavior):
        wheels = esair.writes(float)
        other = esair.writes(float)

    other = Watch(name="too", guards={"wheels": esair.guards(float, name="other")})
    assert not [each for each in told(Pair(), Watch(), other) if "together" in each]
    assert not [each for each in told(Pair()) if "together" in each]
    assert not [each for each in told(Both(), Watch()) if "together" in each]
