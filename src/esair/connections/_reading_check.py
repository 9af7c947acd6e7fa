"""The check of a reading before it reaches an action: time, type, finite, limits."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import attrs

from esair.connections._command_check import limits_by_field, part_of
from esair.exceptions import describe
from esair.messages import Stamped
from esair.resources import Sensor
from esair.values import checked_class, once_for_class, passes_as, type_name

AHEAD = 0.01  # how far in the future a device may say that it has measured, in seconds
_DEPTH = 4  # how deeply a value is looked into

_ATOMS = (str, bytes, bytearray, memoryview, bool, int, type(None))
"""What cannot hide a number that is not finite."""


class ReadingCheck:
    """Says what is wrong with a value of one sensor, if anything is.

    NaN compares as false with everything, so a reaction would take it for "nothing is
    near". A number of its own, and one in a field, must be finite; in a row of numbers,
    such as a scan, infinity stands for "nothing in reach".
    """

    def __init__(self, sensor: Sensor[Any]) -> None:
        self._wanted = checked_class(sensor.value_type)
        self._limits = limits_by_field(sensor.limits)
        self._low, self._high = self._limits.get("", (math.nan, math.nan))
        bounded = math.isfinite(self._low) and math.isfinite(self._high)
        self.wrong: Callable[[Any], str | None] = self._any
        """Return what is wrong with a value, in words; None if nothing is."""
        if self._wanted is float and not self._limits:
            self.wrong = self._number
        elif self._wanted is float and bounded:
            self.wrong = self._number_in_limits
        elif self._wanted in _ATOMS and not self._limits:
            self.wrong = self._atom

    def _number(self, value: Any) -> str | None:
        if type(value) is float and math.isfinite(value):
            return None
        return self._any(value)

    def _number_in_limits(self, value: Any) -> str | None:
        # Between two numbers, which NaN never is.
        if type(value) is float and self._low <= value <= self._high:
            return None
        return self._any(value)

    def _atom(self, value: Any) -> str | None:
        return None if type(value) is self._wanted else self._any(value)

    def _any(self, value: Any) -> str | None:
        wanted = self._wanted
        if wanted is not None and type(value) is not wanted:
            number = wanted is int or wanted is float
            if (number and isinstance(value, bool)) or not (
                isinstance(value, wanted) or passes_as(value, wanted)
            ):
                return f"expected {type_name(wanted)}, it gave {value!r:.80}"
        if type(value) is float:
            if not math.isfinite(value):
                return f"expected a finite number, it gave {value!r}"
            if not self._limits:
                return None
        try:
            if wanted is float:
                float(value)  # a whole number may be too large for one
            return _not_finite(value, "", _DEPTH) or self._outside(value)
        except Exception as error:  # a value may be an object of any class
            return f"it cannot be checked: {describe(error)}"

    def _outside(self, value: Any) -> str | None:
        for field, (low, high) in self._limits.items():
            number = part_of(value, field)
            if not low <= number <= high:
                what = f"{field} = {number!r:.80}" if field else f"{number!r:.80}"
                return f"expected {low:g} to {high:g}, it gave {what}"
        return None


def measured_at(stamped: Stamped[Any], now: float) -> float | str:
    """Return when a value was measured, or say what is wrong with its stamp."""
    try:
        at = now - stamped.age if stamped.time is None else stamped.time
        if math.isfinite(at) and at <= now + AHEAD:
            return min(at, now)
    except TypeError:
        pass
    return f"expected a time of measurement until now ({now:.3f} s), it gave {stamped!r:.120}"


class FrozenCheck:
    """Says so when a device gives the same value too often: it may be frozen."""

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._last: Any = None
        self._repeats = 0

    def begin_anew(self) -> None:
        """Count from one: the device was opened."""
        self._repeats = 0

    def __call__(self, value: Any) -> str | None:
        """Return what is wrong, in words; None if nothing is."""
        if self._repeats == 0 or not equal(value, self._last):
            self._last, self._repeats = value, 0
        self._repeats += 1
        if self._repeats <= self._limit:
            return None
        return f"frozen: it gave {value!r:.80} {self._repeats} times in a row"


def equal(one: Any, other: Any) -> bool:
    """Tell whether two values are equal; an array is if each of its parts is."""
    try:
        same = one == other
        return bool(same.all()) if hasattr(same, "all") else bool(same)
    except Exception:  # a value may be an object of any class
        return False


def _not_finite(value: Any, where: str, depth: int) -> str | None:
    kind: type = type(value)
    if isinstance(value, _ATOMS) or depth == 0:
        return None
    if isinstance(value, float):
        if math.isfinite(value):
            return None
        return f"expected a finite number, it gave {where or 'value'} = {value!r}"
    if hasattr(value, "dtype"):
        bad = value.dtype.kind == "f" and bool((value != value).any())
        return (
            f"expected numbers, it gave NaN in {where or 'an array'}" if bad else None
        )
    if isinstance(value, Mapping):
        parts = [(str(key), part) for key, part in value.items()]
    elif names := fields_of(kind):
        parts = [(name, getattr(value, name)) for name in names]
    elif isinstance(value, tuple | list):
        return _not_a_number(value, where, depth)
    else:
        return None
    for name, part in parts:
        wrong = _not_finite(part, f"{where}.{name}" if where else name, depth - 1)
        if wrong is not None:
            return wrong
    return None


def _not_a_number(
    row: tuple[Any, ...] | list[Any], where: str, depth: int
) -> str | None:
    try:
        if not any(map(math.isnan, row)):
            return None
        return f"expected numbers, it gave NaN in {where or 'a row'}"
    except TypeError:  # they are no numbers: each is looked into
        for number, part in enumerate(row):
            if not isinstance(part, float):
                wrong = _not_finite(part, f"{where}[{number}]", depth - 1)
                if wrong is not None:
                    return wrong
            elif math.isnan(part):
                return f"expected a number, it gave {where}[{number}] = nan"
        return None


@once_for_class
def fields_of(cls: type) -> tuple[str, ...]:
    """The fields of a structured value: attrs, a dataclass, or a named tuple."""
    if attrs.has(cls):
        return tuple(field.name for field in attrs.fields(cls))
    return tuple(
        getattr(cls, "__dataclass_fields__", ()) or getattr(cls, "_fields", ())
    )
