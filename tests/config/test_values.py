"""Values of a TOML file become what Python code asks for, or are told."""

import dataclasses
import datetime
import enum
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, NewType, TypedDict

import attrs
import pytest

from esair.config._values import INVALID, convert


class Gear(enum.Enum):
    LOW = 1
    HIGH = "fast"


@attrs.frozen
class Point:
    x: float
    _y: float = 0.0
    label: str = attrs.field(default="", init=False)


@attrs.frozen
class Line:
    begin: Point
    end: Point | None = None


@dataclasses.dataclass
class Range:
    low: int
    high: int = 9
    steps: list[int] = dataclasses.field(default_factory=list)

    def __post_init__(self) -> None:
        if self.low > self.high:
            raise ValueError("low is above high")


class Pair(NamedTuple):
    left: float
    right: float = 0.0


class Options(TypedDict, total=False):
    fast: bool


Metres = NewType("Metres", float)

FITS = [
    (1, float, 1.0),
    (1.5, float, 1.5),
    (1, int, 1),
    (True, bool, True),
    ("a", str, "a"),
    ("\r\n", bytes, b"\r\n"),
    ("map.bin", Path, Path("/robot/map.bin")),
    ("/etc/map.bin", Path, Path("/etc/map.bin")),
    ("map.bin", str | Path, Path("/robot/map.bin")),
    ("map.bin", str | None, "map.bin"),
    (1, Gear, Gear.LOW),
    ("high", Gear, Gear.HIGH),
    ("fast", Gear, Gear.HIGH),
    ("fast", Literal["slow", "fast"], "fast"),
    (3, Annotated[float, "metres"], 3.0),
    (3, Metres, 3.0),
    ([1, 2], list[float], [1.0, 2.0]),
    ([1, 2], tuple[float, ...], (1.0, 2.0)),
    ([1, "a"], tuple[int, str], (1, "a")),
    ([1, 1], set[int], {1}),
    ([1], Sequence[int], (1,)),
    ([1, "a"], list, [1, "a"]),
    ({"a": 1}, dict[str, float], {"a": 1.0}),
    ({"a": 1}, Mapping[str, Any], {"a": 1}),
    ({"x": 1, "y": 2}, Point, Point(1.0, 2.0)),
    ({"begin": {"x": 1}}, Line, Line(Point(1.0))),
    ({"low": 1, "steps": [2]}, Range, Range(1, 9, [2])),
    ({"left": 1}, Pair, Pair(1.0, 0.0)),
    ({"fast": True}, Options, {"fast": True}),
    ({"a": 1}, Any, {"a": 1}),
    (datetime.date(2020, 1, 2), datetime.date, datetime.date(2020, 1, 2)),
]

DOES_NOT = [
    (True, float, "at", "expected a number, not true"),
    (True, int, "at", "expected a whole number, not true"),
    (1.0, int, "at", "expected a whole number, not 1.0"),
    ("1", float, "at", "expected a number, not '1'"),
    (1, bool, "at", "expected true or false, not 1"),
    (1, str, "at", "expected a string, not 1"),
    (1, Path, "at", "expected a path, not 1"),
    ("", Path, "at", "expected a path, not ''"),
    ("a\0", Path, "at", "expected a path"),
    (2, Gear, "at", "expected one of 1, 'fast', not 2"),
    (True, Gear, "at", "expected one of 1, 'fast', not true"),
    (True, Literal[1], "at", "expected 1, not true"),
    (
        [1],
        tuple[int, int],
        "at",
        "expected a list of 2 (a whole number, a whole number)",
    ),
    ([1, "a"], list[int], "at.1", "expected a whole number, not 'a'"),
    ([{}], set[dict], "at", "expected a list"),
    ("ab", list[str], "at", "expected a list, each a string, not 'ab'"),
    ({"a": "b"}, dict[str, float], "at.a", "expected a number, not 'b'"),
    ([], dict[str, float], "at", "expected a table, each a number, not []"),
    ({"x": 1}, list[int], "at", "expected a list"),
    ({"y": 1}, Point, "at", "'x' is missing: expected a number"),
    ({"x": 1, "_y": 1}, Point, "at._y", "there is no such key; did you mean 'y'?"),
    ({"x": 1, "label": ""}, Point, "at.label", "there is no such key"),
    ({"begin": {"x": "a"}}, Line, "at.begin.x", "expected a number, not 'a'"),
    ({"begin": {"x": 1}, "end": {"z": 1}}, Line, "at.end.z", "there is no such key"),
    ({"low": 10}, Range, "at", "ValueError: low is above high"),
    ({"a b": 1}, Pair, "at.'a b'", "there is no such key"),
    ({"fast": 1}, Options, "at.fast", "expected true or false, not 1"),
    (3, Point, "at", "expected a table with the keys x, y, not 3"),
    ([], float | str, "at", "expected a number or a string, not []"),
    ("x", int | None, "at", "expected a whole number, not 'x'"),
    ("2020", datetime.date, "at", "expected a date, not '2020'"),
    (datetime.time(1), str, "at", "expected a string"),
]


def converted(value, kind):
    told: dict[str, str] = {}
    found = convert(value, kind, "at", told.__setitem__, Path("/robot"))
    return found, told


@pytest.mark.parametrize(("value", "kind", "wanted"), FITS)
def test_what_fits_is_converted(value, kind, wanted) -> None:
    """The value has exactly the type that was asked for."""
    found, told = converted(value, kind)

    assert (found, told) == (wanted, {})
    assert type(found) is type(wanted)


@pytest.mark.fault("G03")
@pytest.mark.parametrize(("value", "kind", "key", "reason"), DOES_NOT)
def test_what_does_not_fit_is_told_at_its_key(value, kind, key, reason) -> None:
    """Nothing is guessed, and the words say what would fit."""
    found, told = converted(value, kind)

    assert found is INVALID
    assert reason in told[key]


def test_every_field_that_does_not_fit_is_told() -> None:
    """Not only the first."""
    _, told = converted({"begin": {"x": "a", "z": 1}, "end": 3}, Line)

    assert told.keys() == {"at.begin.x", "at.begin.z", "at.end"}
