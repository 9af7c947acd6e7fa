"""Values of any type: for stand-ins of sensors, for requests, and wrong ones."""

from __future__ import annotations

import enum
import inspect
import math
import random
import types
import typing
from collections.abc import Mapping
from typing import Any, Literal

from esair.config import fields_of
from esair.connections import changed
from esair.recording import fields_of as parts_of

LEAST, MOST = 0.0, 2.0  # Between which numbers lie that nobody has given limits
DEPTH = 6  # How deep records may lie in records

Limits = tuple[float, float] | Mapping[str, tuple[float, float]] | None


class CannotMakeError(TypeError):
    """Nothing says how a value of this type is made."""


def make(kind: Any, dice: random.Random, limits: Limits = None, depth: int = 0) -> Any:
    if depth > DEPTH:
        raise CannotMakeError("its type contains itself")
    if kind is None or kind is type(None):
        return None
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if origin is Literal:
        return dice.choice(arguments)
    if origin in {typing.Union, types.UnionType}:
        return make(dice.choice(arguments), dice, limits, depth + 1)
    cls = float if kind is Any else origin or kind  # a number is the likeliest
    if not inspect.isclass(cls):
        raise CannotMakeError(f"its type is {kind!r:.80}")
    if issubclass(cls, enum.Enum):
        return dice.choice(list(cls))
    made = _plain(cls, dice, limits)
    if made is not None:
        return made
    fields = fields_of(cls)
    if fields is not None:
        by_field = limits if isinstance(limits, Mapping) else {}
        return cls(
            **{
                name: make(field.kind, dice, by_field.get(name), depth + 1)
                for name, field in fields.items()
                if field.required or name in by_field
            }
        )
    return _container(kind, cls, arguments, dice, limits, depth)


def _plain(cls: type, dice: random.Random, limits: Limits) -> Any:
    least, most = limits if isinstance(limits, tuple) else (LEAST, MOST)
    if cls is bool:
        return dice.random() < 0.5
    if issubclass(cls, int):
        return dice.randint(math.ceil(least), math.floor(most))
    if issubclass(cls, float):
        return dice.uniform(max(least, -1e9), min(most, 1e9))
    if cls is str:
        return dice.choice(["", "a", "north", "esair"])
    if cls is bytes:
        return dice.randbytes(4)
    return None


def _container(
    kind: Any,
    cls: type,
    arguments: tuple[Any, ...],
    dice: random.Random,
    limits: Limits,
    depth: int,
) -> Any:
    if issubclass(cls, tuple) and arguments:
        if arguments[-1] is Ellipsis:
            arguments = arguments[:1] * 3
        return tuple(make(each, dice, limits, depth + 1) for each in arguments)
    if issubclass(cls, list | frozenset | set) and arguments:
        return cls(make(arguments[0], dice, limits, depth + 1) for _ in range(3))
    if issubclass(cls, dict) and arguments and isinstance(limits, Mapping):
        return {
            n: make(arguments[1], dice, lim, depth + 1) for n, lim in limits.items()
        }
    raise CannotMakeError(f"its type is {kind!r:.80}")


WRONG = ("nan", "inf", "huge", "type", "nothing")
"""The ways in which a value can be wrong."""


def wrong(value: Any, how: str) -> Any:
    """Return a value that its receiver must not take for good."""
    if how == "nothing":
        return None
    if how == "type":
        return b"?" if isinstance(value, str) else "?"
    bad = {"nan": math.nan, "inf": math.inf, "huge": 1e300}[how]
    return _with(value, bad)


def _with(value: Any, bad: float) -> Any:
    """Put a number in the place of the first one that is found in a value."""
    for name, inner in _inside(value).items():
        if has_number(inner):
            part = _with(inner, bad)
            if isinstance(name, int) and isinstance(value, list | tuple):
                return type(value)([*value[:name], part, *value[name + 1 :]])
            return changed(value, {name: part})
    return bad


def has_number(value: Any) -> bool:
    if isinstance(value, bool | float | int):
        return not isinstance(value, bool)
    return any(map(has_number, _inside(value).values()))


def is_good(value: Any) -> bool:
    if isinstance(value, float):
        return math.isfinite(value)
    return all(map(is_good, _inside(value).values()))


def same(one: Any, other: Any) -> bool:
    equal = one == other
    return equal if isinstance(equal, bool) else bool(all(equal))


def _inside(value: Any) -> dict[Any, Any]:
    fields = parts_of(value)
    if fields is None and isinstance(value, dict):
        return value
    if fields is None and isinstance(value, tuple | list):
        return dict(enumerate(value))
    return fields or {}
