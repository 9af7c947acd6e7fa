"""Values that come and leave: whether they are good.

Commands are compared, and weighed against each other, part by part. A reading is checked
before it reaches an action, a command before it may leave, and what a guard returns before
it takes a command's place.
"""

from __future__ import annotations

import contextlib
import copy
import enum
import math
import numbers
import operator
import typing
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from typing import Any

import attrs

from esair.exceptions import BadValueError, describe
from esair.flaws import (
    DEPTH,
    NUMBER,
    TOO_DEEP,
    Flaw,
    fields_of,
    flaw,
    honest,
    is_fixed,
    parts_of,
    slots_of,
)
from esair.messages import Stamped
from esair.resources import HOLD, Actuator, Sensor
from esair.values import (
    checked_class,
    fits,
    hints_of,
    passes_as,
    type_name,
)

ATOMS_AND_NUMBERS = (int, float, complex, str, bytes, enum.Enum, type(None))
"""What cannot be changed."""

_WHOLE = (str, bytes, bytearray, enum.Enum, type)  # what is compared as a whole

_REAL = frozenset({float, int})

_MISSING: Any = object()


# Commands beside each other.


def is_weaker(result: Any, command: Any, safe: Any) -> bool:
    """Tell whether a command may take the place of a stronger one.

    Each of its numbers lies between that of the safe command and that of the stronger
    one; everything else is as in one of the two.
    """
    if result is command:
        return True
    if _is_number(result) and _is_number(command):
        result, command, safe = honest(result), honest(command), honest(safe)
        if isinstance(result, float) and not math.isfinite(result):
            return False
        if _is_number(safe):
            return bool(min(safe, command) <= result <= max(safe, command))
        return bool(result == command)
    parts = _pairs(result, command)
    if parts is None:
        return is_same(result, command) or is_same(result, safe)
    return all(
        is_weaker(part, theirs, _part(safe, key))
        for key, (part, theirs) in parts.items()
    )


def weaker_of(one: Any, other: Any, safe: Any) -> Any:
    """Return a command of which each part is that of the two that is nearer to safe.

    What cannot be compared is as in the first one.
    """
    if _is_number(one) and _is_number(other) and _is_number(safe):
        one, other, safe = honest(one), honest(other), honest(safe)
        return one if abs(one - safe) <= abs(other - safe) else other
    parts = _pairs(one, other)
    if parts is None:
        return other if is_same(other, safe) else one
    changes = {
        key: weaker_of(mine, theirs, _part(safe, key))
        for key, (mine, theirs) in parts.items()
    }
    return _rebuilt(one, changes)


def _is_number(value: Any) -> bool:
    return passes_as(value, float)


def is_same(one: Any, other: Any) -> bool:
    """Tell whether two commands ask for the same."""
    same = equal(one, other)
    if one is other or type(one) in _REAL or (_compares(one) and not same):
        return same
    parts = _pairs(one, other)  # its class may compare some of them only
    return same if parts is None else all(is_same(*p) for p in parts.values())


def is_opaque(command: Any) -> bool:
    """Tell whether nobody can say if two commands of this class ask for the same."""
    return not _compares(command) and _pairs(command, command) is None


def _compares(command: Any) -> bool:
    """Tell whether its class says when two of them are equal."""
    equal: Any = type(command).__eq__
    return equal is not object.__eq__


def _pairs(one: Any, other: Any) -> dict[Any, tuple[Any, Any]] | None:
    """The parts of two commands of one shape, by name or place; None if they have none."""
    if type(one) is not type(other) or isinstance(one, _WHOLE):
        return None
    if isinstance(one, Mapping):
        if one.keys() != other.keys():
            return None
        return {key: (one[key], other[key]) for key in one}
    if hasattr(one, "tolist"):
        one, other = one.tolist(), other.tolist()
    if isinstance(one, Sequence):
        if len(one) != len(other):
            return None
        return {place: (one[place], other[place]) for place in range(len(one))}
    names = list(fields_of(type(one))) or [
        *getattr(one, "__dict__", ()),
        *slots_of(type(one)),
    ]
    if not names:
        return None
    return {
        name: (getattr(one, name, _MISSING), getattr(other, name, _MISSING))
        for name in names
    }


def _part(whole: Any, key: Any) -> Any:
    """A part of the safe command; what it lacks equals nothing."""
    if isinstance(key, str) and not isinstance(whole, Mapping):
        return getattr(whole, key, _MISSING)
    try:
        return whole[key]
    except (TypeError, LookupError):
        return _MISSING


def _rebuilt(command: Any, parts: dict[Any, Any]) -> Any:
    if isinstance(command, Sequence) and not hasattr(command, "__setitem__"):
        kind: Any = type(command)
        named = hasattr(command, "_fields")
        return kind(*parts.values()) if named else kind(parts.values())
    by_key = isinstance(command, Mapping | Sequence) or hasattr(command, "tolist")
    put: Any = operator.setitem if by_key else object.__setattr__  # it may be frozen
    rebuilt = copy.deepcopy(command)
    for key, part in parts.items():
        if part is not _MISSING:
            put(rebuilt, key, part)
    return rebuilt


def equal(one: Any, other: Any) -> bool:
    """Tell whether two values are equal; an array is if each of its parts is."""
    try:
        same = one == other
        return bool(same.all()) if hasattr(same, "all") else bool(same)
    except BaseException:  # a value may be an object of any class
        return False


# Fields.


def limits_by_field(value: Any) -> dict[str, Any]:
    """One entry for each field; the command itself is the field without a name."""
    if value is None:
        return {}
    return dict(value) if isinstance(value, Mapping) else {"": value}


def part_of(command: Any, field: str) -> Any:
    """Return a field of a command; the command itself if the field has no name."""
    if not field:
        return command
    if isinstance(command, Mapping):
        return command[field]
    return getattr(command, field)


def changed(command: Any, changes: Mapping[str, Any]) -> Any:
    """Return a command like another one, with some fields changed."""
    if not changes:
        return command
    if "" in changes:
        return type(command)(changes[""])
    if isinstance(command, Mapping):
        return {**command, **changes}
    if attrs.has(type(command)):
        aliases = {each.name: each.alias for each in attrs.fields(type(command))}
        return attrs.evolve(command, **{aliases[n]: v for n, v in changes.items()})
    if hasattr(command, "__dataclass_fields__"):
        import dataclasses  # only for the robots that use them

        return dataclasses.replace(command, **changes)
    if isinstance(command, tuple):
        return command._replace(**changes)  # type: ignore[attr-defined]
    other = copy.copy(command)
    for field, value in changes.items():
        setattr(other, field, value)
    return other


AHEAD = 0.01  # how far in the future a device may say that it has measured, in seconds

_UNSEEN = (str, bytes, bytearray, memoryview, bool, int, type(None))
"""What a reading may be as a whole without a look into it."""


class CommandCheck:
    """Checks, and where declared clamps, the commands of one actuator."""

    def __init__(self, actuator: Actuator[Any]) -> None:
        self.name: str = actuator.name
        self.wanted: type | None = checked_class(actuator.value_type)
        self._kind = actuator.value_type
        self._clamp = actuator.clamp
        overridden = type(actuator).check is not Actuator.check
        self._own_check = actuator.check if overridden else None
        self._stays = actuator.safe is HOLD
        self._limits = limits_by_field(actuator.limits)
        self._slew = limits_by_field(actuator.slew)
        self._whole = {each for each in self._slew if kind_of(actuator, each) is int}
        self._exact: dict[str, float] = {}
        """How far whole numbers are in truth that change by less than one at a time."""
        self._fields = _number_fields(actuator.safe)
        get: Any = operator.attrgetter(*self._fields or [""])
        self._get = (lambda command: (get(command),)) if len(self._fields) == 1 else get
        if isinstance(actuator.safe, tuple):
            self._get = tuple  # its places are its fields
        self._kinds = dict(_kinds_in(actuator.safe))
        """What is where in a command: a number, or what has numbers in it."""
        self._of_numbers = _is_of_numbers(actuator.value_type)
        self._length = _length_of(actuator.value_type)
        self.copies: bool = not is_fixed(actuator.value_type)
        """Whether somebody could change a command after its check."""
        self.slews: bool = bool(self._slew)
        self.checked: Callable[[Any], Any] = self._quickest(actuator)
        """Return the command that may be sent.

        Raises:
            BadValueError: The type is wrong, a number is not finite, or it is
                outside the limits.
        """
        self.takes_time: bool = self.checked == self._any
        """Whether it may run code of others."""

    def _quickest(self, actuator: Actuator[Any]) -> Callable[[Any], Any]:
        """Choose, once, the check for the kind of commands that it takes."""
        if self._own_check is not None:
            return self._any
        self._low, self._high = self._limits.get("", (math.nan, math.nan))
        if not self._limits:
            if self.wanted is float:
                return self._number
            if self.wanted is int:  # which is always finite
                self._low, self._high = -math.inf, math.inf
                return self._number_in_limits
            # What is no number may hide one: then each part is looked at.
            plain = _all_numbers(actuator.safe, self._fields)
            return self._numbers if plain and not self._length else self._any
        bounded = math.isfinite(self._low) and math.isfinite(self._high)
        if bounded and (self.wanted is float or self.wanted is int):
            return self._number_in_limits
        return self._any

    def _number(self, command: Any) -> Any:
        """Check what is a number without limits: most commands end here."""
        if type(command) is float and math.isfinite(command):
            return command
        return self._any(command)

    def _number_in_limits(self, command: Any) -> Any:
        """Check what is a number between two others, which NaN never is."""
        if type(command) is self.wanted and self._low <= command <= self._high:
            return command
        return self._any(command)

    def _numbers(self, command: Any) -> Any:
        """Check a structure of numbers without limits."""
        if type(command) is self.wanted:
            if self.copies:
                command = copy.copy(command)  # its parts are numbers
            parts = self._get(command)
            # What else can pass for a number may be changed after this look at it.
            if _REAL.issuperset(map(type, parts)):
                with contextlib.suppress(OverflowError):
                    if all(map(math.isfinite, parts)):
                        return command
        return self._any(command)

    def _any(self, command: Any) -> Any:
        if command is HOLD and self._stays:
            return command
        wanted: Any = self.wanted
        try:
            if wanted is not None and type(command) is not wanted:
                command = self._accept(command, wanted)
            elif wanted is None and not fits(command, self._kind):
                told = f"expected {type_name(self._kind)}, not {command!r:.80}"
                raise self._bad("", told)
            if self._length and len(command) != self._length:
                raise self._bad(
                    "", f"expected {self._length} values, not {command!r:.80}"
                )
            if not isinstance(command, ATOMS_AND_NUMBERS):
                command = copy.deepcopy(command)  # what is checked is what leaves
            self._check_finite(command)
            if self._of_numbers:
                for field, value in command.items():
                    if not isinstance(value, numbers.Number):
                        raise self._bad(field, f"expected a number, not {value!r:.80}")
            if self._limits:
                command = self._limited(command)
            if self._own_check is not None and command is not HOLD:
                self._own_check(command)
            return command
        except BadValueError:
            raise
        except BaseException as error:  # a command may be an object of any class
            raise self._bad("", f"it cannot be checked: {describe(error)}") from error

    def slewed(self, command: Any, last: Any, seconds: float) -> Any:
        """Return the command, moved towards the last one if it changes too fast."""
        changes: dict[str, float] = {}
        for field, slew in self._slew.items():
            try:
                value = honest(part_of(command, field))
                before = honest(part_of(last, field))
            except (AttributeError, LookupError):
                raise self._bad(
                    field, "its change is limited: each command must have it"
                ) from None
            step = slew * max(seconds, 0.0)
            is_whole = field in self._whole and type(value) is type(before) is int
            start = self._exact.get(field, before) if is_whole else before
            if start != before and abs(start - before) >= 1:
                start = before  # it was told something else since
            try:
                bounded = min(start + step, max(start - step, value))
            except TypeError:
                raise self._bad(
                    field,
                    f"its change is limited: expected a number, not {value!r:.80}",
                ) from None
            if is_whole:
                self._exact[field] = bounded
                up, down = math.floor(bounded), math.ceil(bounded)
                bounded = max(before, up) if value > before else min(before, down)
            if bounded != value:
                changes[field] = bounded
        return changed(command, changes)

    def _bad(self, field: str, told: str) -> BadValueError:
        return BadValueError(self.name, field or "command", told)

    def _accept(self, command: Any, wanted: type) -> Any:
        if wanted is float and isinstance(command, float):
            return float.__float__(command)
        if isinstance(command, wanted) and not (
            wanted is int and isinstance(command, bool)
        ):
            # Its own class may compare as it likes.
            return (
                int.__int__(typing.cast("int", command)) if wanted is int else command
            )
        if passes_as(command, wanted):
            return wanted(command)
        raise self._bad("", f"expected {type_name(wanted)}, not {command!r:.80}")

    def _check_finite(self, command: Any) -> None:
        found = flaw(command, self._kinds)
        if found is None:
            return
        if found.expected == TOO_DEEP:
            raise self._bad(found.place(), "it is nested too deeply")
        told = f"expected {found.expected}, not {found.value!r:.80}"
        raise self._bad(found.place(), told)

    def _limited(self, command: Any) -> Any:
        changes: dict[str, float] = {}
        for field, (low, high) in self._limits.items():
            try:
                given = part_of(command, field)
                value = honest(given)
                if low <= value <= high:
                    if value is not given and not isinstance(given, enum.Enum):
                        changes[field] = value
                    continue
            except (AttributeError, LookupError, TypeError):
                if self._own_check is not None:  # which knows more about it
                    continue
                raise
            near = low if value < low else high
            if type(value) is int:  # the nearest whole number that lies within
                near = math.ceil(low) if value < low else math.floor(high)
            if not (self._clamp and low <= near <= high):
                told = str(value).removesuffix(".0")  # with all its digits
                raise self._bad(field, f"expected {low:g} to {high:g}, not {told:.80}")
            changes[field] = near
        return changed(command, changes)


def kind_of(actuator: Actuator[Any], field: str) -> Any:
    """Return the type of a command, or of a field of it; `typing.Any` if it is unknown."""
    kind, safe = actuator.value_type, actuator.safe
    if field:
        cls = type(safe) if safe is not HOLD else checked_class(kind)
        kind = hints_of(cls).get(field, Any) if cls is not None else Any
    if kind is Any:
        with contextlib.suppress(AttributeError, LookupError):
            return type(part_of(safe, field))
    return kind


def _length_of(kind: Any) -> int:
    """How many values a kind of tuple has; 0 for any number of them."""
    places = typing.get_args(kind) if typing.get_origin(kind) is tuple else ()
    return 0 if ... in places else len(places)


def _is_of_numbers(kind: Any) -> bool:
    """Whether all values of a kind of dictionary are numbers."""
    origin, inner = typing.get_origin(kind), typing.get_args(kind)
    is_mapping = isinstance(origin, type) and issubclass(origin, Mapping)
    return is_mapping and len(inner) == 2 and inner[1] in {int, float}


def _kinds_in(safe: Any, place: str = "") -> Iterator[tuple[str, str]]:
    """What commands have in the places where the safe one has numbers, and around them."""
    fields = _number_fields(safe)
    for name, part in parts_of(safe) if fields or _has_fields(safe) else ():
        where = f"{place}.{name}" if place else str(name)
        if str(name) in fields:
            yield where, NUMBER
        elif not _has_fields(part) or where.count(".") >= DEPTH:
            continue
        elif inside := list(_kinds_in(part, where)):
            yield where, type_name(type(part))
            yield from inside


def _has_fields(value: Any) -> bool:
    return attrs.has(type(value)) or hasattr(value, "__dataclass_fields__")


def _number_fields(safe: Any) -> list[str]:
    has_names = not isinstance(safe, Collection | int | float)
    if not (has_names or isinstance(safe, tuple)) or hasattr(safe, "__array__"):
        return []
    return [
        str(name)
        for name, part in parts_of(safe)
        if isinstance(part, int | float) and not isinstance(part, bool)
    ]


def _all_numbers(safe: Any, fields: list[str]) -> bool:
    """Whether a structured command has no other parts than its number fields."""
    return bool(fields) and len(fields) == len(parts_of(safe))


class ReadingCheck:
    """Says what is wrong with a value of one sensor, if anything is.

    NaN compares as false with everything, so a reaction would take it for "nothing is
    near". A number of its own, and one in a field, must be finite; in a row of numbers,
    such as a scan, infinity stands for "nothing in reach".
    """

    def __init__(self, sensor: Sensor[Any]) -> None:
        self._kind = sensor.value_type
        self._wanted = checked_class(self._kind)
        self.is_open: bool = not is_fixed(self._kind)
        """Whether one who reads a value could change it for others."""
        limit = sensor.max_repeat
        self.frozen: FrozenCheck | None = None if limit is None else FrozenCheck(limit)
        self._limits = limits_by_field(sensor.limits)
        self._low, self._high = self._limits.get("", (math.nan, math.nan))
        bounded = math.isfinite(self._low) and math.isfinite(self._high)
        self.wrong: Callable[[Any], str | None] = self._any
        """Return what is wrong with a value, in words; None if nothing is."""
        if self._wanted is float and not self._limits:
            self.wrong = self._number
        elif self._wanted is float and bounded:
            self.wrong = self._number_in_limits
        elif self._wanted in _UNSEEN and not self._limits:
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
        if type(value) is not wanted and not fits(value, self._kind):
            return f"expected {type_name(self._kind)}, it gave {value!r:.80}"
        if type(value) is float:
            if not math.isfinite(value):
                return f"expected a finite number, it gave {value!r}"
            if not self._limits:
                return None
        try:
            if wanted is float:
                float(value)  # a whole number may be too large for one
            found = flaw(value, rows=True)
            return self._outside(value) if found is None else _told(found, value)
        except BaseException as error:  # a value may be an object of any class
            return f"it cannot be checked: {describe(error)}"

    def _outside(self, value: Any) -> str | None:
        for field, (low, high) in self._limits.items():
            number = honest(part_of(value, field))
            if not low <= number <= high:
                what = f"{field} = {number!r:.80}" if field else f"{number!r:.80}"
                return f"expected {low:g} to {high:g}, it gave {what}"
        return None


def measured_at(stamped: Stamped[Any], now: float) -> float | str:
    """Return when a value was measured, or say what is wrong with its stamp."""
    with contextlib.suppress(BaseException):  # it may be an object of any class
        at = now - stamped.age if stamped.time is None else stamped.time
        if math.isfinite(at) and at <= now + AHEAD:
            return min(at, now)
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


def _told(found: Flaw, value: Any) -> str:
    """Say what is wrong with a reading, and where."""
    where = found.place_in(value)
    if found.row:
        return f"expected numbers, it gave NaN in {where or found.row}"
    if found.expected == TOO_DEEP:
        return f"{where or 'it'} is nested too deeply"
    return (
        f"expected {found.expected}, it gave {where or 'value'} = {found.value!r:.80}"
    )
