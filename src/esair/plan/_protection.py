"""How each actuator is made safe: who moves it, and who stops it."""

from __future__ import annotations

import attrs

from esair.actions import Reaction
from esair.plan._plan import Plan
from esair.resources import Actuator
from esair.values import is_positive


@attrs.frozen
class Writer:
    """Who writes an actuator.

    Attributes:
        behavior: The name of the behavior or reaction.
        kind: ``"behavior"`` or ``"reaction"``.
        priority: With which priority it writes.
    """

    behavior: str
    kind: str
    priority: int


@attrs.frozen
class Protection:
    """How one actuator is made safe.

    Attributes:
        name: The actuator.
        driver: Its class, as ``module:Class``.
        safe: Its safe command, in Python's words; None if it has none.
        command_timeout: After how many seconds without a command it is sent; None if
            it does not say so as it must.
        writers: Who moves it, highest priority first.
        sent_by: Who sends the safe command, and when.
        own_timeout: After how many seconds the device stops by itself when it
            hears nothing more; None if it does not.
        when_the_host_dies: What that means.
    """

    name: str
    driver: str
    safe: str | None
    command_timeout: float | None
    writers: tuple[Writer, ...]
    sent_by: str
    own_timeout: float | None
    when_the_host_dies: str


def protection(plan: Plan) -> list[Protection]:
    """Return how each actuator of a robot is made safe, in the robot's order."""
    return [
        _of(plan, name, resource)
        for name, resource in plan.resource_of.items()
        if isinstance(resource, Actuator)
    ]


def _of(plan: Plan, name: str, actuator: Actuator[object]) -> Protection:
    writers = [
        Writer(
            behavior,
            "reaction"
            if isinstance(plan.action_of[behavior], Reaction)
            else "behavior",
            need.priority,
        )
        for behavior, need in plan.writes_of(name).items()
    ]
    timeout, own = actuator.command_timeout, actuator.own_timeout
    good = is_positive(timeout)
    after = f"{timeout:g} s after the last command, and " if good else ""
    return Protection(
        name=name,
        driver=f"{type(actuator).__module__}:{type(actuator).__qualname__}",
        safe=repr(actuator.safe) if hasattr(actuator, "safe") else None,
        command_timeout=float(timeout) if good else None,
        writers=tuple(sorted(writers, key=lambda writer: -writer.priority)),
        sent_by=f"esair: {after}at every exit",
        own_timeout=own,
        when_the_host_dies=(
            f"it stops itself after {own:g} s"
            if is_positive(own)
            else "it keeps its last command"
        ),
    )
