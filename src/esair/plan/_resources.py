"""What one sensor or actuator declares: is it sound, whatever the robot?"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator
from typing import Any

from esair.actions import Derived
from esair.connections import CommandCheck, limits_by_field, part_of
from esair.exceptions import BadValueError
from esair.plan._derived import wrong_derived
from esair.plan._finding import Finding, mistake, warning
from esair.plan._signatures import wrong_signatures
from esair.resources import HOLD, Actuator, Sensor, wrong_bus, wrong_operations
from esair.values import is_positive


def mistakes_in_resource(resource: Sensor[Any] | Actuator[Any]) -> Iterator[Finding]:
    """Find what is wrong with the class of a resource, or with its values."""

    def wrong(field: str, told: str) -> Finding:
        return mistake("declaration", resource, field, told)

    for field, told in (*_in_plain(resource), *_in_limits(resource)):
        yield wrong(field, told)
    if resource.identity is not None and not resource.identifies:
        yield wrong("identity", "its class has no identify to compare it with")
    if wrong_one := wrong_bus(type(resource), resource.bus):
        yield wrong("bus", wrong_one)
    if isinstance(resource, Actuator):
        for field, told in _in_actuator(resource):
            yield wrong(field, told)
        if getattr(resource.write, "__func__", None) is Actuator.write:
            yield wrong("write", "an actuator must have a write method")
    else:
        if isinstance(resource, Derived):
            for field, told in wrong_derived(resource):
                yield wrong(field, told)
        elif not (resource.can_be_asked or resource.pushes):
            yield wrong("read", "a sensor must have a read or stream method")
    for field, told in wrong_signatures(resource):
        yield wrong(field, told)
    for field, told in wrong_operations(type(resource)):
        yield wrong(field, told)
    if isinstance(resource, Actuator):
        for name, each in resource.operations.items():
            limit = resource.deadline if each.deadline is None else each.deadline
            if blocks_safe(resource, name, limit):
                told = (
                    f"it blocks its thread for up to {limit:g} s, and the safe "
                    "command waits behind it"
                )
                advice = (
                    "write it as async def, or let it only begin what the device does"
                )
                yield warning("time", resource, name, told, advice)


def blocks_safe(actuator: Actuator[Any], operation: str, limit: object) -> bool:
    """Tell whether an operation keeps the safe command waiting for too long."""
    plain = not inspect.iscoroutinefunction(getattr(actuator, operation))
    if not (plain and actuator.blocking):
        return False
    return is_positive(limit) and float(str(limit)) > actuator.deadline


def _in_actuator(actuator: Actuator[Any]) -> Iterator[tuple[str, str]]:
    if not hasattr(actuator, "safe"):
        yield "safe", "an actuator must declare its safe command: safe = ..."
        return
    wrong_slew = [*_in_slew(actuator)]
    yield from wrong_slew
    if (
        actuator.safe is HOLD
        or wrong_slew
        or any(_in_plain(actuator))
        or any(_in_limits(actuator))
    ):
        return
    field = "safe"
    try:
        check = CommandCheck(actuator)
        safe = check.checked(actuator.safe)
        field = "slew"
        check.slewed(safe, actuator.safe, 1.0)
    except (BadValueError, TypeError) as error:
        yield field, f"does not fit: {error}"


def _in_slew(actuator: Actuator[Any]) -> Iterator[tuple[str, str]]:
    for field, slew in limits_by_field(actuator.slew).items():
        if not is_positive(slew):
            told = f"expected a change per second > 0, not {slew!r:.80}"
            yield f"slew.{field}".rstrip("."), told


def _in_plain(resource: Sensor[Any] | Actuator[Any]) -> Iterator[tuple[str, str]]:
    for wanted, is_one, fields in _PLAIN:
        for field in fields.split():
            value = getattr(resource, field, _NONE_HERE)
            if value is not _NONE_HERE and not is_one(value):
                yield field, f"expected {wanted}, not {value!r:.80}"


_NONE_HERE = object()


def _is_count(value: object) -> bool:
    return type(value) is int and value > 0


_PLAIN: tuple[tuple[str, Callable[[object], bool], str], ...] = (
    ("seconds > 0", is_positive, "deadline set_up_period command_timeout"),
    (
        "seconds > 0 or None",
        lambda value: value is None or is_positive(value),
        "own_timeout period",
    ),
    ("a whole number > 0", _is_count, "fault_limit history_size"),
    (
        "a whole number > 0",
        lambda value: value is None or _is_count(value),
        "max_repeat",
    ),
    (
        "True or False",
        lambda value: type(value) is bool,
        "required blocking clamp safe_moves",
    ),
)
"""What a class, or one of its objects, may say wrongly: the test, the fields."""


def _in_limits(resource: Sensor[Any] | Actuator[Any]) -> Iterator[tuple[str, str]]:
    safe = getattr(resource, "safe", HOLD)
    for field, bounds in limits_by_field(resource.limits).items():
        try:
            part = None if safe is HOLD else part_of(safe, field)
        except (AttributeError, LookupError):
            yield f"limits.{field}", f"{safe!r:.80} has no such field"
            continue
        try:
            low, high = bounds
            told = "" if low <= high else f"not {bounds!r:.80}"
        except (TypeError, ValueError):
            told = f"not {bounds!r:.80}"
        if told:
            yield f"limits.{field}".rstrip("."), f"expected (least, greatest), {told}"
            continue
        try:
            if part is not None and not low <= part <= high:
                yield "safe", f"{safe!r} is outside the limits"
        except TypeError:
            told = f"expected a pair for each field of {part!r:.80}, not {bounds!r:.80}"
            yield f"limits.{field}".rstrip("."), told
