"""What actions read and write: is it there, of the type, and in time?"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

from esair.actions import Behavior, Derived, Guards, Need, Reaction, Reads, Writes
from esair.exceptions import UnknownNameError
from esair.plan._finding import Finding, mistake, warning
from esair.plan._plan import Plan
from esair.resources import APPLIED, Actuator, Sensor
from esair.values import is_positive, same_type, type_name

_DOING: Final = {Reads: "reads", Writes: "writes", Guards: "guards"}


def unmet(
    plan: Plan, action: Behavior | Reaction | Derived[Any], attribute: str, need: Need
) -> Finding | None:
    """Find out if nobody provides what a port of an action, or a derived sensor, asks for."""
    name, wanted = action.name, need.resource
    resource = plan.provided(need)
    if resource is None:
        if (
            need.provider in plan.resource_names
            and need.provider not in plan.resource_of
        ):
            return None  # its own mistakes are told already
        user = f"{name}: {attribute}"
        cause = UnknownNameError("resource", wanted, plan.resource_names, user=user)
        told = str(cause).removeprefix(f"{user}: ")
        return mistake("need", action, attribute, told, cause=cause)
    writes = not isinstance(need, Reads)
    doing = _DOING[type(need)]
    if writes is not isinstance(resource, Actuator):
        is_a = "a sensor" if writes else "an actuator"
        told = f"it {doing} {wanted!r}, which is {is_a}"
        applied = f"its last command is read as name={wanted + APPLIED!r}"
        advice = "" if writes else applied
        return mistake("need", action, attribute, told, advice)
    has = resource.value_type
    if not (same_type(need.type, has) if writes else same_type(has, need.type)):
        told = (
            f"it {doing} {type_name(need.type)}, but {wanted!r} "
            f"{'takes' if writes else 'gives'} {type_name(has)}"
        )
        return mistake("need", action, attribute, told)
    return None


def untimely(
    plan: Plan, action: Behavior | Reaction, attribute: str, need: Need
) -> Iterator[Finding]:
    """Find times that can never be met; both numbers are named."""
    if not isinstance(action, Reaction):
        return  # a behavior asks the device again when a reading is too old for it
    resource = plan.provided(need)
    if isinstance(need, Reads) and isinstance(resource, Sensor):
        yield from _too_young(action, attribute, need, resource)
        yield from _silent(action, attribute, need, resource)
    elif isinstance(need, Writes) and isinstance(resource, Actuator) and action.rate:
        timeout = resource.command_timeout
        if not is_positive(timeout):
            return
        longest = timeout if need.hold is None else min(need.hold, timeout)
        if 1 / action.rate >= longest:
            told = (
                f"it writes {need.resource!r} every {1 / action.rate:.3g} s, but a "
                f"command is good for {longest:.3g} s only"
            )
            yield warning(
                "time", action, attribute, told, "raise its rate or the command_timeout"
            )


def _too_young(
    action: Reaction, attribute: str, need: Reads[Any], sensor: Sensor[Any]
) -> Iterator[Finding]:
    if need.max_age is None or not sensor.can_be_asked or sensor.pushes:
        return
    period = 1 / sensor.rate
    if need.max_age <= period * (1 + 1e-9):  # 1 / 0.1 is not quite 10
        told = (
            f"its readings of {need.resource!r} may be {need.max_age:.3g} s old at "
            f"most, but come every {period:.3g} s only"
        )
        yield mistake(
            "time", action, f"{attribute}.max_age", told, "raise the rate or max_age"
        )


def _silent(
    action: Reaction, attribute: str, need: Reads[Any], sensor: Sensor[Any]
) -> Iterator[Finding]:
    """A device that pushes when something happens may have nothing to say at first."""
    if not sensor.pushes or sensor.can_be_asked or need.optional:
        return
    if hasattr(sensor, "initial") or sensor.period is not None:
        return  # it says its value at once, or how soon it speaks
    told = f"it is blind until {need.resource!r} first speaks"
    advice = (
        f"give {type(sensor).__name__} a read, an initial value, or a period (its "
        "greatest silence)"
    )
    yield warning("silent", action, attribute, told, advice)
