"""Values that an operator gives, as the types that the robot asks for."""

from __future__ import annotations

import numbers
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from esair.config import INVALID, convert, fields_of
from esair.exceptions import BadValueError
from esair.resources import Actuator

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
    if fields is not None:
        names = [name for name, each in fields.items() if each.kind in {int, float}]
    elif isinstance(safe, Mapping):
        names = [name for name, each in safe.items() if isinstance(each, numbers.Real)]
    else:
        return {"": tuple(limits) if isinstance(limits, tuple | list) else None}  # type: ignore[dict-item]
    by_name = limits if isinstance(limits, Mapping) else {}
    whole = tuple(limits) if isinstance(limits, tuple | list) else None
    return {name: tuple(by_name[name]) if name in by_name else whole for name in names}  # type: ignore[misc]
