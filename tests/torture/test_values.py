"""Values that torture makes wrong, and judges."""

import dataclasses
import math
from typing import Any, NamedTuple

import attrs
import pytest

from esair.torture._values import is_good, wrong


@attrs.frozen
class Twist:
    linear: float = attrs.field(alias="forward")
    _angular: float = 0.0


@dataclasses.dataclass(frozen=True)
class Speed:
    unit: str
    value: float


class Pair(NamedTuple):
    left: Speed
    right: Speed


VALUES: list[Any] = [
    0.5,
    [0.5, 1.0],
    (0.5, 1.0),
    {"left": 0.5},
    Twist(0.5),
    Speed("m/s", 0.5),
    Pair(Speed("m/s", 0.5), Speed("m/s", 1.0)),
]


@pytest.mark.parametrize("value", VALUES, ids=repr)
@pytest.mark.parametrize(
    ("how", "good"), [("nan", False), ("inf", False), ("huge", True)]
)
def test_the_first_number_of_a_value_is_made_wrong(value, how, good) -> None:
    """Of every class of values; what is not finite is found again by the judge."""
    bad = wrong(value, how)

    assert is_good(value)
    assert is_good(bad) is good
    assert type(bad) is type(value)
    assert bad != value


def test_a_value_that_is_no_number_becomes_one() -> None:
    """There is no number in it to be replaced."""
    assert math.isnan(wrong("north", "nan"))
