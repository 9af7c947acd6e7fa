"""The check of a command before it may leave: type, finite, limits, slew."""

from __future__ import annotations

import copy
import enum
import inspect
import math
import numbers
import operator
import types
import typing
from collections.abc import Callable, Collection, Iterator, Mapping
from typing import Any

import attrs

from esair.exceptions import BadValueError, describe
from esair.resources import HOLD, Actuator
from esair.values import checked_class, passes_as, type_name

_DEPTH = 8  # How deep parts of a command are looked at


class CommandCheck:
    """Checks, and where declared clamps, the commands of one actuator."""

    def __init__(self, actuator: Actuator[Any]) -> None:
        self.name = actuator.name
        self.wanted = checked_class(actuator.value_type)
        self._clamp = actuator.clamp
        overridden = type(actuator).check is not Actuator.check
        self._own_check = actuator.check if overridden else None
        self._stays = actuator.safe is HOLD
        self._limits = limits_by_field(actuator.limits)
        self._slew = limits_by_field(actuator.slew)
        self._fields = _number_fields(actuator.safe)
        get: Any = operator.attrgetter(*self._fields or [""])
        self._get = (lambda command: (get(command),)) if len(self._fields) == 1 else get
        if isinstance(actuator.safe, tuple):
            self._get = iter  # its places are its fields
        self._kinds = dict(_kinds_in(actuator.safe))
        """What is where in a command: a number, or what has numbers in it."""
        self._of_numbers = _is_of_numbers(actuator.value_type)
        self._length = _length_of(actuator.value_type)
        self.copies = not (_is_frozen(self.wanted) and _is_fixed(actuator.safe))
        """Whether somebody could change a command after its check."""
        self.slews = bool(self._slew)  # whether how fast a command changes is limited
        self.checked: Callable[[Any], Any] = self._quickest(actuator)
        """Return the command that may be sent.

        Raises:
            BadValueError: The type is wrong, a number is not finite, or it is
                outside the limits.
        """

    def _quickest(self, actuator: Actuator[Any]) -> Callable[[Any], Any]:
        """Choose, once, the check for the kind of commands that it takes."""
        if self._own_check is not None:
            return self._any
        if not self._limits:
            if self.wanted is float:
                return self._number
            # What is no number may hide one: then each part is looked at.
            plain = _all_numbers(actuator.safe, self._fields)
            return self._numbers if plain and not self._length else self._any
        self._low, self._high = self._limits.get("", (math.nan, math.nan))
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
            try:
                if all(map(math.isfinite, self._get(command))):
                    return command
            except (TypeError, OverflowError):
                pass  # a field is no number: it is named below
        return self._any(command)

    def _any(self, command: Any) -> Any:
        if command is HOLD and self._stays:
            return command
        wanted: Any = self.wanted
        try:
            if wanted is not None and type(command) is not wanted:
                command = self._accept(command, wanted)
            if self._length and len(command) != self._length:
                raise self._bad(
                    "", f"expected {self._length} values, not {command!r:.80}"
                )
            if not isinstance(command, _ATOMS_AND_NUMBERS):
                command = copy.deepcopy(command)  # what is checked is what leaves
            self._check_finite("", command)
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
        except Exception as error:  # a command may be an object of any class
            raise self._bad("", f"it cannot be checked: {describe(error)}") from error

    def slewed(self, command: Any, last: Any, seconds: float) -> Any:
        """Return the command, moved towards the last one if it changes too fast."""
        changes: dict[str, float] = {}
        for field, slew in self._slew.items():
            try:
                value, before = part_of(command, field), part_of(last, field)
            except (AttributeError, LookupError):
                raise self._bad(
                    field, "its change is limited: each command must have it"
                ) from None
            step = slew * max(seconds, 0.0)
            try:
                bounded = min(before + step, max(before - step, value))
            except TypeError:
                raise self._bad(
                    field,
                    f"its change is limited: expected a number, not {value!r:.80}",
                ) from None
            if bounded != value:
                changes[field] = bounded
        return changed(command, changes)

    def _bad(self, field: str, told: str) -> BadValueError:
        return BadValueError(self.name, field or "command", told)

    def _accept(self, command: Any, wanted: type) -> Any:
        if isinstance(command, wanted) and not (
            wanted is int and isinstance(command, bool)
        ):
            return command
        if passes_as(command, wanted):
            return wanted(command)
        raise self._bad("", f"expected {type_name(wanted)}, not {command!r:.80}")

    def _check_finite(self, field: str, value: Any, depth: int = _DEPTH) -> None:
        if isinstance(value, numbers.Number):
            if not (value - value == 0):  # type: ignore[operator]
                raise self._bad(field, f"expected a finite number, not {value!r:.80}")
            kind = self._kinds.get(field, _NUMBER)
            if kind != _NUMBER:
                raise self._bad(field, f"expected {kind}, not {value!r:.80}")
            return
        parts = _parts(value)
        kind = self._kinds.get(field, "")
        if kind == _NUMBER or (kind and not parts):
            raise self._bad(field, f"expected {kind}, not {value!r:.80}")
        if depth == 0:
            raise self._bad(field, "it is nested too deeply")
        for name, part in parts:
            self._check_finite(
                f"{field}.{name}" if field else str(name), part, depth - 1
            )

    def _limited(self, command: Any) -> Any:
        changes: dict[str, float] = {}
        for field, (low, high) in self._limits.items():
            try:
                value = part_of(command, field)
                if low <= value <= high:
                    continue
            except (AttributeError, LookupError, TypeError):
                if self._own_check is not None:  # which knows more about it
                    continue
                raise
            if not self._clamp:
                raise self._bad(field, f"expected {low:g} to {high:g}, not {value:g}")
            changes[field] = min(
                high, max(low, value)
            )  # value is finite: checked before
        return changed(command, changes)


def _is_frozen(wanted: Any) -> bool:
    """Whether nobody can change a value of a class whose parts are numbers."""
    if wanted is None:
        return False
    if wanted in {int, float, bool, str, bytes} or issubclass(
        wanted, tuple | enum.Enum
    ):
        return True
    options = getattr(wanted, "__dataclass_params__", None)
    if options is not None:
        return bool(options.frozen)
    # A frozen class of attrs, which has no other way to say so.
    return getattr(wanted.__setattr__, "__name__", "") == "_frozen_setattrs"


def _is_fixed(value: Any) -> bool:
    """Whether nobody can change a value, nor a part of it."""
    if value is HOLD or isinstance(value, _ATOMS_AND_NUMBERS):
        return True
    parts = [part for _, part in _parts(value)]
    return _is_frozen(type(value)) and all(map(_is_fixed, parts))


def limits_by_field(value: Any) -> dict[str, Any]:
    """One entry for each field; the command itself is the field without a name."""
    if value is None:
        return {}
    return dict(value) if isinstance(value, Mapping) else {"": value}


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
    for name, part in _parts(safe) if fields or _has_fields(safe) else ():
        where = f"{place}.{name}" if place else str(name)
        if str(name) in fields:
            yield where, _NUMBER
        elif not _has_fields(part) or where.count(".") >= _DEPTH:
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
        for name, part in _parts(safe)
        if isinstance(part, int | float) and not isinstance(part, bool)
    ]


def _all_numbers(safe: Any, fields: list[str]) -> bool:
    """Whether a structured command has no other parts than its number fields."""
    return bool(fields) and len(fields) == len(_parts(safe))


_NUMBER = "a number"

_ATOMS_AND_NUMBERS = (int, float, complex, str, bytes, enum.Enum, type(None))
"""What cannot be changed."""

_ATOMS = (str, bytes, bytearray, memoryview, range, type, types.ModuleType)
"""What cannot hide a number that is not finite."""


def _parts(value: Any) -> list[tuple[object, Any]]:
    """The parts of a value by their names or places: fields, entries, attributes."""
    if value is None or isinstance(value, _ATOMS) or inspect.isroutine(value):
        return []
    if isinstance(value, enum.Enum):
        return [("value", value.value)]
    if isinstance(value, Mapping):
        return [*value.items(), *enumerate(value)]
    if hasattr(value, "__array__"):
        return list(enumerate(value.ravel().tolist()))
    parts: dict[object, Any] = {}
    if isinstance(value, Collection):
        parts.update(enumerate(value))
    for cls in type(value).__mro__:
        for name, slot in vars(cls).items():
            if isinstance(slot, types.MemberDescriptorType) and hasattr(value, name):
                parts[name] = getattr(value, name)
    parts.update(getattr(value, "__dict__", {}))
    return list(parts.items())


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
