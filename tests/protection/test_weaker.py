"""Which of two commands asks for less: of every kind of value that a command may be."""

from __future__ import annotations

import array
import collections
import dataclasses
import enum
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import attrs
import numpy as np
import pytest

from esair.connections._values import is_same, is_weaker, weaker_of

pytestmark = pytest.mark.promise("PRO-6", "PRO-8")


@attrs.frozen
class Frozen:
    linear: float
    angular: float


@dataclasses.dataclass(frozen=True)
class Data:
    linear: float
    angular: float


class Named(NamedTuple):
    linear: float
    angular: float


class Object:
    def __init__(self, linear: float, angular: float) -> None:
        self.linear = linear
        self.angular = angular

    def __eq__(self, other: object) -> bool:
        return vars(self) == vars(other)

    __hash__ = None  # type: ignore[assignment]


@attrs.frozen
class Derived:
    linear: float
    angular: float
    fast: bool = attrs.field(init=False, default=False)


@dataclasses.dataclass(frozen=True)
class DerivedData:
    linear: float
    angular: float
    fast: bool = dataclasses.field(init=False, default=False)


KINDS: dict[str, Callable[[float, float], Any]] = {
    "attrs": Frozen,
    "dataclass": Data,
    "named tuple": Named,
    "object": Object,
    "tuple": lambda linear, angular: (linear, angular),
    "list": lambda linear, angular: [linear, angular],
    "dict": lambda linear, angular: {"linear": linear, "angular": angular},
    "array": lambda linear, angular: np.array([linear, angular]),
    "attrs with more than is given": Derived,
    "dataclass with more than is given": DerivedData,
    "deque": lambda linear, angular: collections.deque([linear, angular]),
    "ordered dict": lambda linear, angular: collections.OrderedDict(
        linear=linear, angular=angular
    ),
    "row of the standard library": lambda linear, angular: array.array(
        "d", [linear, angular]
    ),
}


@pytest.fixture(params=list(KINDS))
def made(request: Any) -> Callable[[float, float], Any]:
    """Make a command of two numbers, of each kind."""
    return KINDS[request.param]


def test_less_lies_between_safe_and_the_command_in_each_part(made: Any) -> None:
    """More, another direction and NaN are no less; nor is a part that is missing."""
    safe, command = made(0.0, 0.0), made(0.8, -1.0)
    for less in (made(0.4, -0.5), made(0.0, -1.0), made(0.0, 0.0), command):
        assert is_weaker(less, command, safe)
    for more in (made(0.9, -0.5), made(0.4, 0.1), made(-0.1, 0.0), made(math.nan, 0.0)):
        assert not is_weaker(more, command, safe)
    assert not is_weaker(0.4, command, safe)


def test_beside_a_safe_that_is_no_number_only_the_same_number_passes() -> None:
    """Nobody knows in which direction an "off" lies."""
    assert is_weaker(0.37, float("0.37"), "off")
    for other in (0.36, 0.38, 0.0, -0.37, math.nan, 10**400):
        assert not is_weaker(other, 0.37, "off")


def test_of_two_commands_each_part_is_taken_that_is_nearer_to_safe(made: Any) -> None:
    """The result is of the same kind, and neither of the two is changed."""
    one, other = made(0.8, -0.1), made(0.3, -0.5)
    found = weaker_of(one, other, made(0.0, 0.0))
    assert type(found) is type(one)
    assert is_same(found, made(0.3, -0.1))
    assert is_same(one, made(0.8, -0.1))
    assert is_same(other, made(0.3, -0.5))


def test_commands_of_another_shape_are_no_less() -> None:
    """Fewer entries, other names, another class: nobody can tell."""
    assert not is_weaker([0.1], [0.5, 0.5], [0.0, 0.0])
    assert not is_weaker({"left": 0.1}, {"right": 0.5}, {"right": 0.0})
    assert not is_weaker(Frozen(0.1, 0.1), Data(0.5, 0.5), Data(0.0, 0.0))
    assert weaker_of([0.5, 0.5], [0.1], [0.0, 0.0]) == [0.5, 0.5]
    assert weaker_of([0.5, 0.5], [0.0], [0.0]) == [0.0]


def test_what_is_no_number_is_as_asked_or_as_when_safe() -> None:
    """A word, a switch, nothing: there is no between."""
    for less in ("fast", "off"):
        assert is_weaker(less, "fast", "off")
    assert not is_weaker("slow", "fast", "off")
    assert is_weaker(False, True, False)
    assert not is_weaker(0.5, True, False)
    assert weaker_of("fast", "off", "off") == "off"
    assert weaker_of("fast", "slow", "off") == "fast"
    assert is_weaker(None, None, 0.0)


@pytest.mark.parametrize("safe", [None, "off", {}, []])
def test_where_safe_has_no_such_part_a_number_must_be_as_asked(safe: Any) -> None:
    """Nobody knows on which side of it less would be."""
    assert is_weaker([0.5], [0.5], safe)
    assert not is_weaker([0.4], [0.5], safe)
    assert not is_weaker({"linear": 0.4}, {"linear": 0.5}, safe)
    assert not is_weaker(Frozen(0.4, 0.0), Frozen(0.5, 0.0), safe)
    assert weaker_of([0.5], [0.4], safe) == [0.5]


def test_what_cannot_be_compared_is_not_the_same() -> None:
    """A command may be an object of any class; its error is contained."""

    class Hostile:
        def __eq__(self, other: object) -> bool:
            raise RuntimeError("no")

        __hash__ = None  # type: ignore[assignment]

    assert not is_same(Hostile(), Hostile())
    assert is_same(np.zeros(3), np.zeros(3))
    assert not is_same(np.zeros(3), np.ones(3))


def test_an_object_without_parts_is_taken_as_a_whole() -> None:
    """It is what was asked, or what is safe."""
    one, other, safe = object(), object(), object()
    assert is_weaker(one, one, safe)
    assert is_weaker(safe, one, safe)
    assert not is_weaker(other, one, safe)
    assert weaker_of(one, safe, safe) is safe
    assert weaker_of(one, other, safe) is one


def test_a_choice_is_taken_as_a_whole() -> None:
    """Its name and value, and the class that it refers to, are no parts of it."""

    class Gear(enum.Enum):
        PARK = 0
        DRIVE = 1
        BACK = -1

    assert is_weaker(Gear.PARK, Gear.DRIVE, Gear.PARK)
    assert not is_weaker(Gear.BACK, Gear.DRIVE, Gear.PARK)
    assert weaker_of(Gear.DRIVE, Gear.PARK, Gear.PARK) is Gear.PARK
    assert weaker_of(Gear.DRIVE, Gear.BACK, Gear.PARK) is Gear.DRIVE


def test_of_two_that_are_as_near_to_safe_what_stands_stays() -> None:
    """On either side of it: nothing new is sent."""
    assert weaker_of(1.0, -1.0, 0.0) == 1.0
    assert weaker_of([-1.0, 2.0], [1.0, 1.0], [0.0, 0.0]) == [-1.0, 1.0]
    assert weaker_of(3.0, 0.5, 2.0) == 3.0
    assert weaker_of(0.0, 1.5, 2.0) == 1.5
