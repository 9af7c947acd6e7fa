"""Torture looks whether a robot does again what it did before its faults."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from tests.torture import lifeless
from tests.torture.generated import maker
from tests.torture.lifeless import PLANTS, SOUND

import esair
import esair.demo
from esair.torture import Step, Story, Target, tell, torture
from esair.torture._life import OF_LIFE

ROOT = Path(__file__).parents[2]
FAULTS = 6000  # Within how many each plant is found; a minute on a busy computer
TRIED = 400  # How many faults each sound robot gets, if that takes no longer than
AT_MOST = 30.0  # so many seconds of real time

UNPLUGGED = (Step(3.0, "unplugged", "sonar", lasts=1.0),)

Make = Callable[[], esair.Robot]


def found_in(
    make: Make, steps: tuple[Step, ...] = UNPLUGGED, calm: float = 15.5
) -> set[tuple[str, str]]:
    story = Story(1, steps)
    lasts = story.over_at + calm
    return set(tell(Target("robot", make), Story(1, steps, lasts)).keys)


@pytest.mark.promise("TOR-1")
@pytest.mark.parametrize(
    ("plant", "rule"), [("returns at a loss", "ended"), ("stays in panic", "works")]
)
def test_who_works_no_more_is_seen(plant: str, rule: str) -> None:
    """It has come to its end, or does nothing; it must have worked before."""
    make, who = PLANTS[plant]
    assert found_in(make) == {(rule, who)}


@pytest.mark.promise("TOR-1")
def test_who_works_again_in_time_is_no_finding() -> None:
    """And nobody is judged before the robot is itself again."""
    assert found_in(SOUND["drives"]) == set()
    assert found_in(PLANTS["stays in panic"][0], calm=14.5) == set()


@pytest.mark.promise("TOR-1")
def test_what_is_taken_away_slowly_comes_again() -> None:
    """A removal may outlast its step: nobody is blamed for what was never added."""
    removal = Step(3.0, "remove", "sonar", lasts=0.02)
    silence = Step(3.0, "silent", "sonar", lasts=0.1)
    assert found_in(SOUND["reacts"], (removal, silence)) == set()


@pytest.mark.long
@pytest.mark.promise("TOR-1")
def test_who_was_looked_at_for_less_is_not_judged() -> None:
    """A work that ends by itself, later than in the stories in which nothing is done."""
    steps = (Step(18.0, "unplugged", "sonar", lasts=0.1),)
    assert found_in(lifeless.mission, steps) == set()


@pytest.mark.long
@pytest.mark.promise("TOR-1")
def test_what_is_declared_is_owed_too() -> None:
    """A pause of ten seconds is no habit, but it may be promised."""
    steps = (Step(9.5, "unplugged", "sonar", lasts=1.0),)
    assert found_in(lifeless.patrol, steps, calm=20.0) == set()
    assert found_in(lifeless.patrol, steps, calm=23.5) == {("works", "patrol")}
    assert found_in(lifeless.patrol, (), calm=23.5) == set()


@pytest.mark.long
@pytest.mark.promise("TOR-1")
def test_who_may_be_idle_owes_nothing() -> None:
    """All of it, or to one partner."""
    assert found_in(lifeless.rests) == set()
    assert found_in(lifeless.may_panic) == set()


@pytest.mark.parametrize(
    ("partners", "within", "told"),
    [
        (("the wheels",), 4.0, "works 'the wheels'.*lower-case"),
        ((3,), 4.0, "works 3"),
        (("wheels",), 0.0, "within.*seconds > 0, not 0.0"),
        (("wheels",), float("nan"), "within"),
        (("wheels",), "soon", "within.*'soon'"),
    ],
)
def test_what_cannot_be_meant_is_told(partners, within, told) -> None:
    """Where it is declared."""
    with pytest.raises(esair.ConfigError, match=told):
        esair.works(*partners, within=within)


@pytest.mark.long
@pytest.mark.promise("TOR-1")
@pytest.mark.parametrize(
    "plant",
    [
        pytest.param(plant, marks=[pytest.mark.soak] if number % 4 else [])
        for number, plant in enumerate(PLANTS)
    ],
)
def test_each_plant_is_found(plant: str) -> None:
    """By random faults; who is blamed is the one that works no more."""
    make, who = PLANTS[plant]
    report = torture(Target(plant, make), seed=1, faults=FAULTS, findings=1)
    (finding,) = report.findings
    assert finding.violation.rule in OF_LIFE
    assert finding.violation.component == who
    assert len(finding.story.steps) <= 2


def sound_robots() -> dict[str, Target]:
    """Return robots that nobody may blame."""
    sys.path[:0] = [str(ROOT / "examples"), str(ROOT / "docs/code")]
    files = [Path(esair.demo.__file__).with_name("robot.toml")]
    files += sorted((ROOT / "docs/code").glob("*.toml"))
    modules = [
        file
        for file in sorted((ROOT / "examples").glob("*.py"))
        if "\nrobot = " in file.read_text("utf-8")
    ]
    robots = {name: Target(name, make) for name, make in SOUND.items()}
    robots |= {f"robot {n}": Target(f"robot {n}", maker(n)) for n in range(30)}
    robots |= {file.name: Target.of(f"{file}:robot") for file in modules}
    robots |= {file.name: Target.of(str(file)) for file in files}
    robots["planted.py"] = Target.of(f"{ROOT}/tests/torture/planted.py:sound", own=True)
    robots["guarded"] = Target.of(f"{ROOT}/docs/code/torture/rover.py:guarded")
    return robots


@pytest.mark.soak
@pytest.mark.promise("TOR-1")
def test_no_sound_robot_is_blamed() -> None:
    """The examples, the robots of the docs and tests, the demo: fifty of them."""
    robots = sound_robots()
    assert len(robots) >= 50
    blamed = {}
    for number, (name, target) in enumerate(robots.items()):
        report = torture(target, seed=number, faults=TRIED, seconds=AT_MOST)
        of_life = [each for each in report.findings if each.violation.rule in OF_LIFE]
        if of_life:
            blamed[name] = [(str(each.violation), each.story) for each in of_life]
    assert blamed == {}
