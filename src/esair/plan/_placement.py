"""What can live in a process of its own, and of what it is made there.

Of a class by name, and what that is constructed with; never a copy: what a component that
runs knows of its robot must not cross. So each start of it begins with it as it was made.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from typing import Any, Final

from esair.abc import Component, made_of
from esair.actions import Behavior, Reaction
from esair.codec import CodecError, Kinds, declared, encode
from esair.messages import placement_of
from esair.plan._finding import Finding, mistake
from esair.resources import Actuator, Sensor

SCRIPT: Final = "__main__"


def unplaceable(component: Any) -> Iterator[Finding]:
    """Find why a component cannot live in a process of its own, if it shall."""
    place = getattr(component, "placement", None)
    if place is None or place == "task":
        return
    found = _reason(component)
    if found is not None:
        field, wrong, advice = found
        yield mistake("placement", component, field, wrong, advice)


def inner_of(component: Any) -> Any:
    """Return what the user has written: a class of ESAIR MIN is in an adapter."""
    inner = vars(component).get("reaction", vars(component).get("device"))
    return component if inner is None else inner


def recipe_of(component: Any) -> dict[str, Any]:
    """Return what a child makes this component of; ``args`` and ``options`` are values."""
    inner = inner_of(component)
    kind = type(inner)
    args: tuple[Any, ...] = ()
    options: dict[str, Any] | None = None
    if isinstance(inner, Component):
        args, options = made_of(inner)
    found = {
        "module": kind.__module__,
        "class": kind.__qualname__,
        "args": args,
        "options": options,
        "fields": dict(vars(inner)) if options is None else {},
        "name": component.name,
    }
    if kind.__module__ == SCRIPT:
        found["script"] = getattr(sys.modules[SCRIPT], "__file__", None)
    return found


def _reason(component: Any) -> tuple[str, str, str] | None:
    """Return which field is wrong, why, and what to do."""
    try:
        placement_of(component.placement)
    except ValueError as error:
        return "placement", str(error), ""
    if isinstance(component, Actuator):
        return (
            "placement",
            "an actuator stays in the robot's process, where its safe command is",
            "place what decides, or what is read",
        )
    if getattr(component, "is_computed", False):
        return "placement", "what is computed of readings stays with them", ""
    if isinstance(component, Reaction) and component.guarded is not None:
        return (
            "placement",
            "a guard stays in the robot's process: commands cannot wait for another",
            "place what it reads as a sensor, or write it as a reaction",
        )
    if isinstance(component, Sensor) and component.bus is not None:
        return (
            "bus",
            f"its bus {component.bus.name!r} has one owner, the robot's process",
            "let the driver open its own device, or place what reads it",
        )
    if not isinstance(component, Behavior | Reaction | Sensor):
        return None
    return _unnamed(component) or _unsendable(component)


def _unnamed(component: Any) -> tuple[str, str, str] | None:
    recipe = recipe_of(component)
    module, path = recipe["module"], recipe["class"]
    found: Any = sys.modules.get(module)
    for part in path.split("."):
        found = getattr(found, part, None)
    inner = inner_of(component)
    if found is not type(inner):
        advice = "define it at the top of a module"
        return "placement", f"its class cannot be imported as {module}:{path}", advice
    if module == SCRIPT and not recipe.get("script"):
        return "placement", "its class is in no file", "put it into a module"
    return None


def _unsendable(component: Any) -> tuple[str, str, str] | None:
    recipe = recipe_of(component)
    if not (recipe["args"] or recipe["options"] or recipe["fields"]):
        return None
    try:
        kinds = Kinds(declared(type(inner_of(component))))
        encode((recipe["args"], recipe["options"], recipe["fields"]), kinds)
    except CodecError as error:
        what = error.path.partition("]")[2].removeprefix(".") or "what it is made of"
        advice = "give plain data, and make the rest of it in setup or open"
        return (
            "placement",
            f"{what} cannot be sent to a process: {error.reason}",
            advice,
        )
    return None
