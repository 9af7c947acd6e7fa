"""Every promise of the contract has a test that carries it."""

from __future__ import annotations

import ast
import functools
from collections.abc import Iterator
from pathlib import Path

import pytest

# One worker reads all files, once.
pytestmark = pytest.mark.xdist_group("promises")

TESTS = Path(__file__).parent

PROMISE_GROUPS = {
    "ROB": 7, "SUP": 5, "BS": 11, "RS": 8, "SC": 4, "AC": 5, "BEH": 6, "REA": 4,
    "TURN": 7, "CALL": 4, "PRO": 14, "MODE": 3, "CTL": 1, "PLC": 7, "NET": 6, "ROS": 3,
    "RES": 4, "BUS": 5, "GRD": 4, "REC": 6, "REP": 3, "OPS": 5, "SEC": 2, "TOR": 1,
    "MIN": 7,
}  # fmt: skip
"""How many promises each group of the contract has."""

PROMISES = {
    f"{group}-{number}"
    for group, count in PROMISE_GROUPS.items()
    for number in range(1, count + 1)
}
"""What the library promises."""

NOT_YET: dict[str, str] = {}
"""Promises without a test, and why."""

GROUPS = {
    "D": 30, "C": 10, "I": 7, "B": 22, "X": 10, "M": 20, "R": 16, "L": 12,
    "G": 11, "T": 6, "O": 18, "P": 8, "H": 18, "V": 5,
}  # fmt: skip
"""How many faults each group of the catalogue has."""

FAULTS = {
    f"{group}{number:02}"
    for group, count in GROUPS.items()
    for number in range(1, count + 1)
}


@functools.cache
def calls(path: Path) -> list[ast.Call]:
    """Return the calls in a file that make a marker."""
    text = path.read_text(encoding="utf-8")
    if "mark.promise(" not in text and "mark.fault(" not in text:
        return []
    return [
        node
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Attribute)
        and ast.unparse(node.func.value).endswith("mark")
    ]


def marks(kind: str, files: list[Path]) -> Iterator[tuple[str, str]]:
    """Yield each ID in ``pytest.mark.<kind>(...)``, and where it stands."""
    for path in files:
        for node in calls(path):
            assert isinstance(node.func, ast.Attribute)
            if node.func.attr == kind:
                where = f"{path.relative_to(path.anchor)}:{node.lineno}"
                for each in node.args:
                    known = isinstance(each, ast.Constant) and isinstance(
                        each.value, str
                    )
                    yield (str(each.value) if known else ast.unparse(each)), where  # type: ignore[attr-defined]


def files() -> list[Path]:
    return sorted(TESTS.rglob("*.py"))


def test_the_catalogue_is_whole() -> None:
    """There are 193 faults in 14 groups, and 132 promises in 25."""
    assert len(FAULTS) == 193
    assert len(PROMISES) == 132
    assert NOT_YET.keys() < PROMISES


@pytest.mark.long
def test_every_promise_has_a_test() -> None:
    """No promise is only words."""
    proved = {each for each, _ in marks("promise", files())}

    missing = sorted(PROMISES - proved - NOT_YET.keys())
    assert not missing, f"promises without a test: {', '.join(missing)}"
    stale = sorted(NOT_YET.keys() & proved)
    assert not stale, f"not yet, but there is a test: {', '.join(stale)}"


def test_every_fault_has_a_test() -> None:
    """No fault is forgotten."""
    missing = sorted(FAULTS - {each for each, _ in marks("fault", files())})

    assert not missing, f"faults without a test: {', '.join(missing)}"


@pytest.mark.parametrize(("kind", "known"), [("promise", PROMISES), ("fault", FAULTS)])
def test_no_marker_names_what_is_not_there(kind: str, known: set[str]) -> None:
    """A misspelt ID proves nothing."""
    unknown = [
        f"{each} ({where})" for each, where in marks(kind, files()) if each not in known
    ]

    assert not unknown, f"unknown {kind} IDs: {', '.join(unknown)}"


def test_the_markers_are_found_wherever_they_stand(tmp_path: Path) -> None:
    """On functions, classes, modules and parameters; computed ones are reported."""
    module = tmp_path / "test_x.py"
    module.write_text(
        "import pytest\n"
        "pytestmark = [pytest.mark.promise('A-1')]\n"
        "@pytest.mark.promise('A-2', 'A-3')\n"
        "class TestX: ...\n"
        "ids = pytest.param(1, marks=pytest.mark.promise(f'A-{4}'))\n"
        "other = pytest.mark.fault('D01')\n"
    )

    assert {each for each, _ in marks("promise", [module])} == {
        "A-1", "A-2", "A-3", "f'A-{4}'",
    }  # fmt: skip
