"""What one sensor or actuator declares: is it sound, whatever the robot?"""

from __future__ import annotations

import inspect
from collections.abc import Iterator
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

    if not is_positive(resource.deadline):
        yield wrong("deadline", f"expected seconds > 0, not {resource.deadline!r:.80}")
    if resource.identity is not None and not resource.identifies:
        yield wrong("identity", "its class has no identify to compare it with")
    if told := wrong_bus(type(resource), resource.bus):
        yield wrong("bus", told)
    if isinstance(resource, Actuator):
        for field, told in _in_actuator(resource):
            yield wrong(field, told)
        if getattr(resource.write, "__func__", None) is Actuator.write:
            yield wrong("write", "an actuator must have a write method")
    else:
        repeats = resource.max_repeat
        if repeats is not None and (type(repeats) is not int or repeats < 1):
            told = f"expected a whole number > 0, not {repeats!r:.80}"
            yield wrong("max_repeat", told)
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
    timeout, own = actuator.command_timeout, actuator.own_timeout
    sound = True
    if not is_positive(timeout):
        sound = False
        yield "command_timeout", f"expected seconds > 0, not {timeout!r:.80}"
    if own is not None and not is_positive(own):
        sound = False
        yield "own_timeout", f"expected seconds > 0 or None, not {own!r:.80}"
    if not hasattr(actuator, "safe"):
        yield "safe", "an actuator must declare its safe command: safe = ..."
        return
    for field, told in (*_in_limits(actuator), *_in_slew(actuator)):
        sound = False
        yield field, told
    if not sound or actuator.safe is HOLD:
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


def _in_limits(actuator: Actuator[Any]) -> Iterator[tuple[str, str]]:
    for field, bounds in limits_by_field(actuator.limits).items():
        moves = actuator.safe is not HOLD
        try:
            part = part_of(actuator.safe, field) if moves else None
        except (AttributeError, LookupError):
            yield f"limits.{field}", f"{actuator.safe!r:.80} has no such field"
            continue
        try:
            low, high = bounds
            sound = low <= high
            fits = part is None or low <= part <= high
        except (TypeError, ValueError):
            sound = False
        if not sound:
            told = f"expected (least, greatest), not {bounds!r:.80}"
            yield f"limits.{field}".rstrip("."), told
        elif not fits:
            yield "safe", f"{actuator.safe!r} is outside the limits"
