"""Whether one command asks for less than another, seen from the safe one."""

from __future__ import annotations

import enum
import math
import types
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from esair.connections._command_check import changed
from esair.connections._reading_check import equal, fields_of

_MISSING: Any = object()

_WHOLE = (str, bytes, bytearray, enum.Enum, type)  # what is compared as a whole


def is_weaker(result: Any, command: Any, safe: Any) -> bool:
    """Tell whether a command may take the place of a stronger one.

    Each of its numbers lies between that of the safe command and that of the stronger
    one; everything else is as in one of the two.
    """
    if result is command:
        return True
    if _is_number(result) and _is_number(command):
        if not math.isfinite(result):
            return False
        if _is_number(safe):
            return bool(min(safe, command) <= result <= max(safe, command))
        return bool(result == command)
    parts = _parts(result, command)
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
        return one if abs(one - safe) <= abs(other - safe) else other
    parts = _parts(one, other)
    if parts is None:
        return other if is_same(other, safe) else one
    changes = {
        key: weaker_of(mine, theirs, _part(safe, key))
        for key, (mine, theirs) in parts.items()
    }
    return _rebuilt(one, changes)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def is_same(one: Any, other: Any) -> bool:
    """Tell whether two commands ask for the same."""
    same = equal(one, other)
    if same or _compares(one):
        return same
    parts = _parts(one, other)
    return parts is not None and all(is_same(*pair) for pair in parts.values())


def is_opaque(command: Any) -> bool:
    """Tell whether nobody can say if two commands of this class ask for the same."""
    return not _compares(command) and _parts(command, command) is None


def _compares(command: Any) -> bool:
    """Tell whether its class says when two of them are equal."""
    equal: Any = type(command).__eq__
    return equal is not object.__eq__


def _parts(one: Any, other: Any) -> dict[Any, tuple[Any, Any]] | None:
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
        *_slots(type(one)),
    ]
    if not names:
        return None
    return {
        name: (getattr(one, name, _MISSING), getattr(other, name, _MISSING))
        for name in names
    }


def _slots(cls: type) -> Iterator[str]:
    for each in cls.__mro__:
        for name, slot in vars(each).items():
            if isinstance(slot, types.MemberDescriptorType):
                yield name


def _part(whole: Any, key: Any) -> Any:
    """A part of the safe command; what it lacks equals nothing."""
    if isinstance(key, str) and not isinstance(whole, Mapping):
        return getattr(whole, key, _MISSING)
    try:
        return whole[key]
    except (TypeError, LookupError):
        return _MISSING


def _rebuilt(command: Any, parts: dict[Any, Any]) -> Any:
    if hasattr(command, "tolist"):
        rebuilt = command.copy()
        rebuilt[...] = [parts[place] for place in range(len(parts))]
        return rebuilt
    if isinstance(command, Sequence):
        values = [parts[place] for place in range(len(parts))]
        if not isinstance(command, tuple):
            return values
        named = hasattr(command, "_fields")
        return type(command)(*values) if named else type(command)(values)
    return changed(command, parts)
