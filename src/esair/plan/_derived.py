"""Sensors that are computed of others: are those there, and is there a first one?"""

from __future__ import annotations

import inspect
from collections.abc import Iterator, Sequence
from typing import Any

from esair.actions import Derived
from esair.plan._actions import wrong_port
from esair.plan._finding import Finding, mistake
from esair.plan._needs import unmet
from esair.plan._plan import Plan, name_of
from esair.plan._rights import refused
from esair.plan._signatures import wrong_compute
from esair.resources import Resource
from esair.values import is_positive


def wrong_derived(derived: Derived[Any]) -> Iterator[tuple[str, str]]:
    """Yield each field of a derived sensor that is wrong, and what was expected."""
    for attribute, need in derived.inputs.items():
        yield from wrong_port(attribute, need)
        if need.configure:
            told = "what is computed of a sensor does not change its settings"
            yield f"{attribute}.configure", told
    if not derived.inputs:
        yield "", "it is computed of nothing: declare what with esair.reads"
    if derived.can_be_asked or derived.pushes or hasattr(derived, "initial"):
        told = "a derived sensor has no read, stream or initial value: write compute"
        yield "compute", told
    if derived.bus is not None:
        yield "bus", "it is computed, and is on no bus"
    if inspect.iscoroutinefunction(derived.open):
        yield "open", "expected a plain function, not async"
    if derived.budget is not None and not is_positive(derived.budget):
        yield "budget", f"expected seconds > 0, not {derived.budget!r:.80}"
    for name in derived.operations:
        if not inspect.iscoroutinefunction(getattr(derived, name)):
            told = "expected async def: a thread would meet compute at work"
            yield name, told
    for told in wrong_compute(derived):
        yield "compute", told


def underivable(plan: Plan, derived: Derived[Any]) -> Iterator[Finding]:
    """Find out if a derived sensor lacks what it is computed of, or is one of those."""
    for attribute, need in derived.inputs.items():
        if missing := unmet(plan, derived, attribute, need):
            yield missing
        yield from refused(plan, derived.name, need)
    if path := _circle(plan, derived):
        told = f"it is computed of itself: {' of '.join(path)}"
        yield mistake("need", derived, "", told)


def _circle(plan: Plan, derived: Derived[Any]) -> list[str]:
    """Return the way from a derived sensor back to itself; nothing if there is none."""
    paths = [[derived.name]]
    seen: set[str] = set()
    while paths:
        path = paths.pop()
        source = plan.resource_of.get(path[-1])
        if not isinstance(source, Derived):
            continue
        for need in source.inputs.values():
            if need.resource == derived.name:
                return [*path, derived.name]
            if need.resource not in seen:
                seen.add(need.resource)
                paths.append([*path, need.resource])
    return []


def depths(resources: Sequence[Resource]) -> dict[Resource, int]:
    """Return how many computations come before each resource, one of the other."""
    known = {name_of(each): each for each in resources}
    found: dict[Resource, int] = {}

    def depth(each: Resource) -> int:
        if each not in found:
            found[each] = 0  # were it a circle, it would end here
            if isinstance(each, Derived):
                below = (known.get(need.resource) for need in each.inputs.values())
                found[each] = 1 + max((depth(b) for b in below if b), default=0)
        return found[each]

    for each in resources:
        depth(each)
    return found
