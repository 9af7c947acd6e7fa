"""The table of protection: what an entry is, and when an actuator hears of it."""

from __future__ import annotations

import asyncio
import copy
import logging
from typing import Any

import pytest

import esair
from esair.connections import BLIND, UNDECIDED, Protection, Protections
from esair.loop import REACHED

pytestmark = [pytest.mark.virtual_clock, pytest.mark.promise("PRO-2", "PRO-7")]


def hold(priority: int = 5, actuator: str = "wheels", **options: Any) -> Protection:
    return Protection(f"hold_{priority}", actuator, priority, **options)


def guard(priority: int = 5, actuator: str = "wheels", **options: Any) -> Protection:
    return Protection(f"guard_{priority}", actuator, priority, guards=True, **options)


class Channel:
    """An actuator that notes what it hears."""

    def __init__(self) -> None:
        self.holds: list[str] = []
        self.guards: list[str] = []
        self.told = self.reviews = 0

    def protect(
        self, holds: tuple[Protection, ...], guards: tuple[Protection, ...]
    ) -> None:
        self.told += 1
        self.holds = [each.component for each in holds]
        self.guards = [each.component for each in guards]

    def review(self) -> None:
        self.reviews += 1

    def news(self) -> tuple[int, int]:
        """How often it was told, and asked to look, since this was called."""
        news = (self.told, self.reviews)
        self.told = self.reviews = 0
        return news


def channels(**named: Channel) -> Any:
    """Return the channels of a robot, as its table knows them."""
    return named


def weigh(entry: Protection, command: Any, *, moving: bool = True) -> Any:
    return entry.weigh(command, 0.0, moving=moving, hand=lambda each: each)


def deciding(entry: Protection, judge: Any = lambda command: command) -> Protection:
    entry.judge, entry.reason = judge, ""
    return entry


async def test_an_actuator_obeys_those_who_are_blind_and_all_guards() -> None:
    """The highest priority first; each change is told at once, to that one alone."""
    wheels, arm = Channel(), Channel()
    table = Protections(channels(wheels=wheels, arm=arm))
    low, high, first, last = hold(1), hold(9), guard(9), guard(1)
    table.enter([low, last, high, first])
    assert wheels.holds == ["hold_9", "hold_1"]
    assert wheels.guards == ["guard_9", "guard_1"]
    assert arm.news() == (0, 0)
    table.blind([high, first], "")
    assert wheels.holds == ["hold_1"]
    assert wheels.guards == ["guard_9", "guard_1"]
    table.leave([low])
    assert wheels.holds == []
    assert set(table) == {last, high, first}


async def test_only_a_change_of_a_guard_has_what_stands_looked_at() -> None:
    """A hold is obeyed by itself; saying the same again is no change."""
    wheels = Channel()
    table = Protections(channels(wheels=wheels))
    one, other = [hold()], [guard()]
    table.enter(one)
    assert wheels.news() == (1, 0)
    table.enter(other)
    assert wheels.news() == (1, 1)
    for entries, looks in ((one, 0), (other, 1)):
        table.blind(entries, "no sonar")
        table.blind(entries, "no sonar")
        assert wheels.news() == (1, looks)
        table.blind(entries, "")
        table.blind(entries, "")
        assert wheels.news() == (1, looks)
        table.mute(entries, 1.0, "a test")
        assert wheels.news() == (1, looks)
        table.reset(entries)
        assert wheels.news() == (1, looks)
        table.leave(entries)
        table.leave(entries)
        assert wheels.news() == (1, looks)
    assert list(table) == []
    await asyncio.sleep(1.1)  # until the mutes are over


async def test_an_entry_tells_since_when_it_is_as_it_is() -> None:
    """Blind for another reason, it is blind since the first."""
    entry, table = hold(), Protections({})
    await asyncio.sleep(1.0)
    table.enter([entry])
    began = entry.since
    assert began == asyncio.get_running_loop().time()
    await asyncio.sleep(1.0)
    table.blind([entry], "no sonar")
    assert entry.since == began
    table.blind([entry], "")
    assert entry.since == began + 1.0
    await asyncio.sleep(1.0)
    table.blind([entry], "no sonar")
    table.blind([entry], "no sonar, no scan")
    assert entry.since == began + 2.0
    await asyncio.sleep(1.0)
    table.leave([entry])
    table.enter([entry])
    assert entry.since == began + 2.0


async def test_nobody_has_decided_on_an_actuator_that_has_come() -> None:
    """A hold is blind again, what is blind stays so for its own reason; guards judge."""
    wheels = Channel()
    table = Protections(channels(wheels=wheels))
    sees, blind, guards = hold(1), hold(2), guard()
    table.enter([sees, blind, guards])
    table.blind([sees, guards], "")
    table.blind([blind], "no sonar")
    await asyncio.sleep(1.0)
    wheels.news()
    table.appear("wheels")
    assert (sees.reason, blind.reason, guards.reason) == (UNDECIDED, "no sonar", "")
    assert sees.since == asyncio.get_running_loop().time()
    assert wheels.holds == ["hold_2", "hold_1"]
    assert wheels.news() == (1, 1)


async def test_the_end_of_a_mute_is_told() -> None:
    """Until then the hold is none, and the guard lets everything pass."""
    wheels = Channel()
    table = Protections(channels(wheels=wheels))
    entries = [hold(), deciding(guard(), lambda _: None)]
    table.enter(entries)
    table.mute(entries, 1.0, "a test")
    assert wheels.holds == []
    assert weigh(entries[1], 0.5) == 0.5
    assert not entries[1].stops
    assert "MUTED by the user for 1 s more: a test" in entries[1].describe()
    await asyncio.sleep(1.001)
    assert wheels.holds == ["hold_5"]
    assert weigh(entries[1], 0.5) is None
    assert "MUTED" not in entries[1].describe()
    table.mute(entries, 1.0, "a test")
    table.mute(entries, 0.0, "")
    assert wheels.holds == ["hold_5"]
    await asyncio.sleep(1.1)


async def test_a_mute_ends_for_all_who_ask_at_the_same_moment() -> None:
    """A timer may come a hair early: then it is over, whoever looks."""
    table = Protections(channels(wheels=Channel()))
    entry = deciding(guard(), lambda _: None)
    table.enter([entry])
    entry.muted_until = asyncio.get_running_loop().time() + REACHED / 2
    assert weigh(entry, 0.5) is None
    entry.note(stops=True)
    assert entry.stops
    assert "MUTED" not in entry.describe()


async def test_a_mute_that_is_over_leaves_nothing_behind() -> None:
    """However often the user mutes: what waits is the ends of those in force."""
    table = Protections(channels(wheels=Channel()))
    entries = [hold()]
    table.enter(entries)
    for seconds in (2.0, 1.0, 1.0):
        table.mute(entries, seconds, "a test")
    assert len(table._ends) == 3
    await asyncio.sleep(1.1)
    assert len(table._ends) == 1
    await asyncio.sleep(1.0)
    assert table._ends == []


async def test_a_latch_goes_on_to_who_has_the_same_place() -> None:
    """With the command that latched it: the reset is refused while that is."""
    before = deciding(guard(latch=True), lambda _: None)
    assert weigh(before, 0.5) is None
    heir, other, plain = guard(latch=True), guard(0, "arm", latch=True), guard()
    for entry in (heir, other, plain):
        entry.inherit(before)
    assert (heir.latched, heir.refused) == (before.latched, 0.5)
    assert not other.latched
    assert not plain.latched
    heir.inherit(guard(latch=True))
    assert heir.latched
    assert "blind" in heir.why_latched_still()
    deciding(heir, lambda command: None if command == 0.5 else command)
    assert "still refuses 0.5" in heir.why_latched_still()
    deciding(heir, lambda _: BLIND)
    assert "still refuses" in heir.why_latched_still()
    deciding(heir, lambda command: command / 0)
    assert "ZeroDivisionError" in heir.why_latched_still()
    deciding(heir)
    assert heir.why_latched_still() == ""
    assert other.why_latched_still() == ""
    Protections({}).reset([heir])
    assert (heir.latched, heir.refused) == ("", None)


async def test_a_latched_guard_asks_nobody() -> None:
    """It lets nothing pass, and its rule says why."""
    asked: list[float] = []
    entry = deciding(guard(latch=True), asked.append)
    assert weigh(entry, 0.5) is None
    assert weigh(entry, 0.2) is None
    assert asked == [0.5]
    assert entry.stops
    assert "latched: it has refused a command" in entry.rule
    assert entry.rule in entry.describe()


@pytest.mark.parametrize("moving", [True, False])
async def test_blindness_latches_what_moves(moving: bool) -> None:
    """And then what it would let pass while blind does not either."""
    entry = guard(latch=True, fallback=lambda command: command)
    entry.judge = lambda command: command
    assert weigh(entry, 0.5, moving=moving) is None
    assert bool(entry.latched) is moving
    own = guard(fallback=lambda command: command / 2)
    assert weigh(own, 0.5, moving=moving) == 0.25
    assert not own.latched


async def test_what_a_guard_gives_is_weighed() -> None:
    """What is equal is the command itself; to stay is nothing; more is its failure."""
    command = 0.5
    assert weigh(deciding(guard(), lambda _: 1.0 - 0.5), command) is command
    assert weigh(deciding(guard(), lambda _: 0.25), command) == 0.25
    assert weigh(deciding(guard(), lambda _: esair.HOLD), command) is None
    entry = deciding(guard(), lambda _: 0.75)
    assert weigh(entry, command) is None
    assert "crashed" in entry.reason


async def test_who_has_crashed_is_asked_no_more() -> None:
    """Though it sees again: it decides when it was given a judge for its next run."""

    def judge(command: float) -> float:
        asked.append(command)
        return command

    asked: list[float] = []
    crashes: list[BaseException] = []
    entry = guard(fallback=lambda command: command / 0)
    entry.judge, entry.on_crash = judge, crashes.append
    assert weigh(entry, 0.5) is None
    entry.reason = ""
    assert weigh(entry, 0.5) is None
    assert asked == []
    await asyncio.sleep(0)
    assert [type(each) for each in crashes] == [ZeroDivisionError]
    assert weigh(deciding(entry, judge), 0.5) == 0.5


async def test_what_nobody_can_compare_passes_as_it_was_handed() -> None:
    """Of what has parts a guard may not change one behind the command's back."""

    class Opaque:
        __slots__ = ()

    class Parts:
        def __init__(self, speed: float) -> None:
            self.speed = speed

    def faster(handed: Any) -> Any:
        handed.speed *= 2
        return handed

    def given(judge: Any, command: Any, safe: Any) -> Any:
        entry = deciding(guard(), judge)
        return entry.weigh(command, safe, moving=True, hand=copy.copy)

    opaque, parts = Opaque(), Parts(1.0)
    assert given(lambda handed: handed, opaque, Opaque()) is opaque
    assert given(lambda _: Opaque(), opaque, Opaque()) is None
    assert given(lambda handed: handed, parts, Parts(0.0)) is not None
    assert given(faster, parts, Parts(0.0)) is None
    assert parts.speed == 1.0


async def test_what_a_guard_raises_is_told_outside_of_the_commit_point() -> None:
    """It is asked no more, neither is what it says while blind; the first reason stays."""
    told: list[BaseException] = []
    entry = deciding(guard(fallback=lambda command: command))
    entry.on_crash = told.append
    error = RuntimeError("a bug")
    entry.crash(error, 1.0)
    assert told == []
    await asyncio.sleep(0)
    assert told == [error]
    assert entry.reason == "it crashed: RuntimeError: a bug"
    assert weigh(entry, 0.5) is None
    entry.crash(RuntimeError("another"), 1.0)
    assert entry.reason == "it crashed: RuntimeError: a bug"


async def test_a_change_is_logged_not_each_refusal(caplog: Any) -> None:
    """When it begins to stop commands, and when it ceases to."""
    caplog.set_level(logging.INFO)
    entry = deciding(guard())
    for stops in (False, True, True, False, False):
        entry.note(stops)
        assert entry.stops is stops
        assert entry.describe().endswith("it lets nothing pass") is stops
    told = [each.getMessage() for each in caplog.records]
    assert [each.rpartition(" lets ")[2] for each in told] == [
        "nothing pass",
        "commands pass again",
    ]


async def test_a_hold_is_below_the_operator_a_guard_above() -> None:
    """And each says whose it is, and up to which priority it bars the actuator."""
    assert (hold(1000).priority, guard(1000).priority) == (999, 1000)
    own = Protection("drive", "wheels", 5)
    assert own.label == "drive"
    assert hold(5, label="step turn of drive").label == "step turn of drive"
    assert "up to priority 5; now: drive is blind" in own.describe()
    assert "with priority 5, latches; now:" in guard(latch=True).describe()
