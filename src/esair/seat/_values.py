"""Values that an operator gives, and values as short texts."""

from __future__ import annotations

import contextlib
import math
import numbers
from collections.abc import Mapping, Sized
from pathlib import Path
from typing import Any

from esair.config import INVALID, convert, fields_of
from esair.exceptions import BadValueError
from esair.recording import fields_of as parts_of
from esair.resources import Actuator
from esair.values import alternatives

Range = tuple[float, float] | None


def typed(value: Any, kind: Any, component: str, field: str) -> Any:
    """Return a value of JSON as the type that is asked for."""
    wrong: list[str] = []

    def note(where: str, told: str) -> None:
        wrong.append(f"{where}: {told}" if where != field else told)

    found = convert(value, kind, field, note, Path())
    if found is INVALID:
        raise BadValueError(component, field, "; ".join(wrong))
    return found


def as_text(value: Any, kind: Any) -> Any:
    """Return digits that were typed, 5678, as a text where only a text is taken.

    Of 1.10 nobody knows the last one.
    """
    kinds = alternatives(kind)
    is_text = str in kinds and int not in kinds and float not in kinds
    return str(value) if is_text and type(value) is int else value


def fitted(value: Any, kind: Any, component: str, field: str) -> Any:
    """Return a value of JSON as a type that JSON does not have, any other as it is."""
    value = as_text(value, kind)
    is_plain = kind in {float, int, bool, str, type(None)}
    return value if is_plain else typed(value, kind, component, field)


def command_of(actuator: Actuator[Any], value: Any) -> Any:
    """Return a value of JSON as a command of an actuator."""
    return typed(value, command_type(actuator), actuator.name, "command")


def command_type(actuator: Actuator[Any]) -> Any:
    """Return the type of an actuator's commands; that of its safe one if it says none."""
    kind = actuator.value_type
    if kind is not Any:
        return kind
    safe = getattr(actuator, "safe", None)
    return type(safe) if fields_of(type(safe)) is not None else Any


def axes(actuator: Actuator[Any]) -> dict[str, Range]:
    """Return the numbers of an actuator's commands, each with its limits.

    A command that is one number has one axis, whose name is empty.
    """
    limits = actuator.limits
    kind = command_type(actuator)
    fields = fields_of(kind) if isinstance(kind, type) else None
    safe = getattr(actuator, "safe", None)
    whole = _range(limits)
    if fields is not None:
        names = [name for name, each in fields.items() if each.kind in {int, float}]
    elif isinstance(safe, Mapping):
        names = [name for name, each in safe.items() if isinstance(each, numbers.Real)]
    else:
        return {"": whole}
    by_name = limits if isinstance(limits, Mapping) else {}
    return {name: _range(by_name.get(name)) or whole for name in names}


def _range(limits: object) -> Range:
    """Return limits as JSON has them: a side without a limit is that of no limits."""
    if not isinstance(limits, tuple | list):
        return None
    low, high = (
        float(each) if math.isfinite(each) else math.copysign(1.0, each)
        for each in limits
    )
    return low, high


TEXT = 120  # How long the text of a value may be; what is longer is cut
PARTS = 6  # How many parts of a list or table are shown
NUMBERS = 4  # How many numbers of a value are told, to be drawn over time


def numbers_of(value: Any) -> dict[str, float]:
    """Return the first finite numbers in a value by the names of their fields."""
    fields = {"": value} if isinstance(value, float | int) else parts_of(value)
    found = {}
    for name, part in (fields or {}).items():
        with contextlib.suppress(OverflowError):  # a whole number may be of any size
            if isinstance(part, float | int) and math.isfinite(part):
                found[name] = float(part)
        if len(found) == NUMBERS:
            break
    return found


def short(value: Any, room: int = TEXT) -> str:
    """Return a value as a text of one line; what lies in it is somebody else's.

    It costs little for a value of any size.
    """
    try:
        text = _text(value, 4)
    except Exception as error:  # somebody's __repr__ or __len__
        text = f"<{type(value).__name__}: {type(error).__name__}>"
    return text if len(text) <= room else text[: room - 1] + "…"


def _text(value: Any, depth: int) -> str:
    if value is None:
        return ""
    if isinstance(value, float):
        return f"{value:.4g}" if math.isfinite(value) else str(float(value))
    if isinstance(value, str | bytes | bytearray):
        return repr(value[:TEXT])
    fields = parts_of(value)
    if depth and fields is not None:
        inside = ", ".join(
            f"{name}={_text(part, depth - 1)}" for name, part in fields.items()
        )
        return f"{type(value).__name__}({inside})"
    if hasattr(value, "__array_interface__"):
        return f"{value.dtype} array of {' x '.join(map(str, value.shape))}"
    if depth and isinstance(value, list | tuple | dict | set | frozenset):
        return _parts(value, depth)
    return "…" if isinstance(value, Sized) else repr(value)


def _parts(value: Any, depth: int) -> str:
    found = []
    for place, part in enumerate(value):
        if place == PARTS:
            found.append(f"… {len(value) - PARTS} more")
            break
        shown = _text(part, depth - 1)
        if isinstance(value, Mapping):
            shown = f"{shown}: {_text(value[part], depth - 1)}"
        found.append(shown)
    return ", ".join(found).join("[]" if isinstance(value, list | tuple) else "{}")
