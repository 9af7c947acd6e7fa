"""Every promise of the contract has a test that carries it."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

TESTS = Path(__file__).parent

PROMISES = {
    *(f"ROB-{n}" for n in range(1, 4)),
    *(f"SUP-{n}" for n in range(1, 6)),
    *(f"BS-{n}" for n in range(1, 8)),
    *(f"RS-{n}" for n in range(1, 7)),
    *(f"SC-{n}" for n in range(1, 4)),
    *(f"AC-{n}" for n in range(1, 5)),
    *(f"BEH-{n}" for n in range(1, 4)),
    *(f"REA-{n}" for n in range(1, 4)),
    *(f"RES-{n}" for n in range(1, 3)),
}
"""What the library promises now."""

LATER = {"BUS-1", "BUS-2", "MIN-1", "MIN-2"}
"""Promises that may have tests already, and need not."""

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


def marks(kind: str, files: list[Path]) -> Iterator[tuple[str, str]]:
    """Yield each ID in ``pytest.mark.<kind>(...)``, and where it stands."""
    for path in files:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if (
                isinstance(node, ast.Call)
                and isinstance(node.func, ast.Attribute)
                and node.func.attr == kind
                and ast.unparse(node.func.value).endswith("mark")
            ):
                where = f"{path.relative_to(path.anchor)}:{node.lineno}"
                for each in node.args:
                    known = isinstance(each, ast.Constant) and isinstance(
                        each.value, str
                    )
                    yield (str(each.value) if known else ast.unparse(each)), where  # type: ignore[attr-defined]


def files() -> list[Path]:
    return sorted(TESTS.rglob("*.py"))


def test_the_catalogue_is_whole() -> None:
    """There are 193 faults in 14 groups, and 36 promises."""
    assert len(FAULTS) == 193
    assert len(PROMISES) == 36


def test_every_promise_has_a_test() -> None:
    """No promise is only words."""
    proved = {each for each, _ in marks("promise", files())}

    missing = sorted(PROMISES - proved)
    assert not missing, f"promises without a test: {', '.join(missing)}"


@pytest.mark.parametrize(
    ("kind", "known"), [("promise", PROMISES | LATER), ("fault", FAULTS)]
)
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
