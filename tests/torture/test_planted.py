"""`torture` finds what was planted, and the test that it writes fails until it is mended."""

from __future__ import annotations

from pathlib import Path

import pytest

from esair.torture import Report, Target, torture, write_test

PLANTED = Path(__file__).parent / "planted.py"
SEED = 1
FAULTS = 1500
"""How many faults are enough to find each of them."""


def tortured(robot: str, *, own: bool = True) -> tuple[Target, Report]:
    target = Target.of(f"{PLANTED}:{robot}", own=own)
    report = torture(target, seed=SEED, faults=FAULTS, findings=1)
    return target, report


def rerun(pytester: pytest.Pytester, target: Target, report: Report) -> Path:
    """Write the test of the first finding, and see it fail."""
    (finding, *_) = report.findings
    pytester.makeini("[pytest]\nasyncio_default_fixture_loop_scope = function\n")
    folder = pytester.path / "tests"
    file = write_test(target, finding.violation, finding.story, SEED, folder)
    pytester.runpytest("-q", "-p", "no:cacheprovider", file).assert_outcomes(failed=1)
    return file


@pytest.mark.long
def test_a_driver_that_waits_for_a_minute_is_no_fault() -> None:
    """The stop has one deadline, whatever that of a driver is."""
    _, report = tortured("no_deadline")
    assert not report.findings


@pytest.mark.long
@pytest.mark.parametrize(
    ("robot", "rule", "component", "steps"),
    [
        pytest.param("blind", "blind", "wheels", 1, marks=pytest.mark.long),
        pytest.param("no_bound", "queue", "diary", 0, marks=pytest.mark.long),
        pytest.param("stubborn", "left", "stubborn", 0, marks=pytest.mark.long),
        ("no_safe", "start", "robot", 0),
        pytest.param("no_word_for_safe", "ready", "wheels", 0, marks=pytest.mark.long),
    ],
)
def test_a_planted_fault_is_found_and_written_as_a_test(
    robot: str, rule: str, component: str, steps: int, pytester: pytest.Pytester
) -> None:
    """A mistake of each kind: found, shrunk, and shown by a test that fails."""
    target, report = tortured(robot)
    (finding,) = report.findings
    assert finding.violation.key == (rule, component)
    assert len(finding.story.steps) == steps
    file = rerun(pytester, target, report)
    mended = file.with_name("test_mended.py")  # a file of one second has one compiled
    mended.write_text(file.read_text().replace(f":{robot}", ":sound"))
    pytester.runpytest("-q", "-p", "no:cacheprovider", mended).assert_outcomes(passed=1)
