"""The page about `esair torture` shows what it finds, as it writes it."""

from __future__ import annotations

from pathlib import Path

import pytest

from esair.torture import Report, Step, Story, Target, tell, torture, write_test

FOLDER = Path(__file__).parents[2] / "docs" / "code" / "torture"
SEED = 7


def tortured(robot: str, faults: int) -> tuple[Target, Report]:
    target = Target.of(f"{FOLDER / 'rover.py'}:{robot}")
    return target, torture(target, seed=SEED, faults=faults, findings=1)


@pytest.mark.long
def test_the_page_shows_the_test_that_is_written(tmp_path: Path) -> None:
    """The story is the shortest: one cable."""
    target, report = tortured("robot", 500)
    (finding,) = report.findings
    target.name = "rover.py:robot"
    file = write_test(target, finding.violation, finding.story, SEED, tmp_path)
    shown = FOLDER / "tests" / file.name
    place = 'parent / "../rover.py"'
    written = [
        f"ROBOT = Path(__file__).{place}" if line.startswith("ROBOT") else line
        for line in file.read_text(encoding="utf-8").splitlines()
    ]
    assert written == shown.read_text(encoding="utf-8").splitlines()


@pytest.mark.long
def test_a_guard_mends_it() -> None:
    """The same story, and five hundred faults more, find nothing."""
    _, report = tortured("guarded", 500)
    assert report.findings == []
    assert report.done == report.survived


@pytest.mark.promise("TOR-1")
def test_what_may_rest_owes_nothing() -> None:
    """One comes to its end, the other one works once in 25 seconds."""
    target = Target.of(f"{FOLDER / 'habits.py'}:robot")
    steps = (Step(4.0, "crash", "patrol"), Step(4.0, "crash", "greet"))
    outcome = tell(target, Story(1, steps, lasts=50.0))
    assert target.habits is not None
    assert target.habits.known_for >= 50.0  # else nothing of it would be judged
    assert outcome.violations == ()
