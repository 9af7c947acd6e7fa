"""Torture kills and stops the processes of components that have one."""

from __future__ import annotations

import os
import time
from collections.abc import Callable

import pytest
from tests.placement.test_attacks import children_of
from tests.torture.planted import children, exits, locked

import esair
from esair.placement import PlacedRunner
from esair.torture import Step, Story, Target, World, tell, torture
from esair.torture._kinds import KINDS, cast_of

pytestmark = [pytest.mark.promise("PLC-3", "PLC-4"), pytest.mark.xdist_group("torture")]


def target(make: Callable[[], esair.Robot]) -> Target:
    return Target(make.__name__, make)


def told(make: Callable[[], esair.Robot], *steps: Step, lasts: float = 4.0) -> World:
    """Tell a story, and see that no process is left."""
    world = World(target(make), Story(1, steps, lasts))
    world.run()
    assert none_is_left()
    return world


def none_is_left() -> bool:
    """Tell whether all processes end: what makes them does so soon after the robot."""
    give_up = time.monotonic() + 5.0
    while left := children_of(os.getpid()):
        if time.monotonic() > give_up:
            break
        time.sleep(0.01)
    return not left


def decisions(world: World, name: str, *, since: float) -> list[float]:
    """Return when what an action moves was told to move, since a moment."""
    moved = {"turns": "wheels", "locks": "arm"}[name]
    (gate,) = (each for each in world.gates if each.name == moved)
    return [each.begun for each in gate.told if each.begun >= since and not each.safe]


@pytest.mark.parametrize(
    "how",
    [
        pytest.param(how, marks=[pytest.mark.long] * (how != "SIGKILL"))
        for how in KINDS["killed"].hows
    ],
)
@pytest.mark.parametrize("name", ["turns", "locks"])
def test_a_death_is_safe_and_the_next_life_decides(name: str, how: str) -> None:
    """No rule is broken, whichever of them dies."""
    world = told(children, Step(1.0, "killed", name, how=how))
    assert world.judge.found == []
    assert world.done["killed"] == 1
    moved = {"turns": "wheels", "locks": "arm"}[name]
    (gate,) = (each for each in world.gates if each.name == moved)
    after = [each for each in gate.told if each.begun >= 1.0]
    assert after[0].safe
    assert after[0].begun == pytest.approx(1.0, abs=0.051)
    assert any(not each.safe for each in after[1:])


@pytest.mark.parametrize("name", ["turns", "locks"])
def test_who_gets_no_time_is_safe_and_goes_on_where_it_was(name: str) -> None:
    """It decides nothing meanwhile, and is the same process afterwards."""
    world = told(children, Step(1.0, "stopped", name, lasts=2.0), lasts=5.0)
    assert world.judge.found == []
    assert world.deeds.crashes == {}
    after = decisions(world, name, since=1.0)
    assert after[0] == pytest.approx(3.0, abs=0.011)


@pytest.mark.parametrize("name", ["turns", "locks"])
def test_who_gets_no_time_for_long_is_killed_and_lives_again(name: str) -> None:
    """That is a hang: after the stall of its placement."""
    world = told(children, Step(1.0, "stopped", name, lasts=8.0), lasts=9.0)
    assert world.judge.found == []
    assert world.deeds.crashes == {name: [True]}
    after = decisions(world, name, since=1.0)
    assert 6.0 < after[0] < 6.5


@pytest.mark.parametrize("how", KINDS["filled"].hows)
@pytest.mark.parametrize("name", ["turns", "locks"])
def test_who_gets_no_more_memory_or_files_breaks_no_rule(name: str, how: str) -> None:
    """It may well go on; what it cannot do is an error of its own."""
    world = told(children, Step(1.0, "filled", name, how=how, lasts=1.0))
    assert world.judge.found == []
    assert world.done["filled"] == 1
    assert decisions(world, name, since=2.5)


def test_who_has_died_unheard_gets_nothing_to_bear() -> None:
    """The story goes on: the robot was held up, and has not heard of the death."""
    world = told(
        children,
        Step(1.0, "held up", much=1.0),
        Step(1.0, "killed", "locks", how="SIGKILL"),
        Step(1.0, "filled", "locks", how="files", lasts=0.1),
    )
    assert world.judge.found == []
    assert world.done["filled"] == 0


def test_who_has_a_process_is_in_the_cast() -> None:
    """Devices are simulated here, whatever they say."""
    cast = cast_of(children())
    assert cast["placed"] == ("locks", "turns")


@pytest.mark.long
def test_what_a_death_leaves_is_found() -> None:
    """A lock that only its owner takes away: it never works again."""
    killed = Step(3.0, "killed", "locks", how="SIGKILL")
    outcome = tell(target(locked), Story(1, (killed,), 18.5))
    assert outcome.keys == {("works", "locks")}


@pytest.mark.long
def test_the_search_finds_it() -> None:
    """It kills who has a process, among all else that it does."""
    report = torture(target(locked), seed=1, faults=3000, findings=1)
    (finding,) = report.findings
    assert finding.violation.key == ("works", "locks")
    assert {each.kind for each in finding.story.steps} <= {"killed", "stopped"}
    assert none_is_left()


@pytest.mark.long
def test_a_death_that_nobody_takes_for_a_crash_is_seen(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Its last command stands, and it never decides again."""
    monkeypatch.setattr(PlacedRunner, "crash", lambda *_: None)
    killed = Step(3.0, "killed", "turns", how="SIGKILL")
    outcome = tell(target(children), Story(1, (killed,), 18.5))
    assert ("works", "turns") in outcome.keys


@pytest.mark.promise("TOR-1")
def test_a_death_that_torture_has_no_part_in_is_its_own() -> None:
    """It fails for good by that: an error of its own, as any other."""
    steps = (Step(3.0, "unplugged", "sonar", lasts=6.0),)
    outcome = tell(target(exits), Story(1, steps, 25.0))
    assert ("ended", "exits") in outcome.keys
