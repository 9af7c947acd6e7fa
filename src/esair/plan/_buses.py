"""What resources share: what each claims on its bus for itself alone, and the ports."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Final

from esair.plan._finding import Finding, mistake, warning
from esair.plan._plan import Plan
from esair.resources import Resource, Sensor

if TYPE_CHECKING:
    from esair.buses import Bus

FULL: Final = 0.8
"""The part of its time that a bus can be asked: each transfer has its gaps."""

_RENUMBERED: Final = re.compile(r"/dev/tty(USB|ACM)\d+\Z")


def claimed_twice(
    about: Iterable[Resource], claims: Mapping[tuple[int, str], str]
) -> Iterator[Finding]:
    """Find the resources that claim what another one has for itself alone."""
    for resource in about:
        if resource.claim is None:
            continue
        first = claims.get((id(resource.bus), resource.claim), resource.name)
        if first != resource.name:
            told = f"{resource.claim} belongs to {first!r}: they cannot share it"
            yield mistake("claim", resource, "", told)


def odd_buses(plan: Plan) -> Iterator[Finding]:
    """Find buses that nobody is on, and ports that are not always the same device."""
    used = {id(each.bus) for each in plan.resource_of.values()}
    for name, bus in _buses(plan):
        if id(bus) not in used and not plan.missing:
            yield warning("unused", bus, "", "no device is on it", of=name)
        port = getattr(bus, "port", None)
        if isinstance(port, str) and _RENUMBERED.match(port):
            told = f"{port} may be another device after the next plugging"
            advice = "expected the path of the same device in /dev/serial/by-id"
            yield warning("port", bus, "port", told, advice, of=name)


def overloaded(plan: Plan) -> Iterator[Finding]:
    """Find buses of which their devices ask more than they have time for."""
    for name, bus in _buses(plan):
        of_bus = (each for each in plan.resource_of.values() if each.bus is bus)
        cost = getattr(bus, "seconds_for", lambda _: 0.0)  # whatever is given as one
        load = sum(_per_second(each) * cost(each.traffic) for each in of_bus)
        if load > FULL:
            told = f"its devices ask {load:.0%} of its time at their rates"
            advice = "lower their rates, or give some of them another bus"
            yield warning("load", bus, "", told, advice, of=name)


def _per_second(resource: Resource) -> float:
    """Return how often a device is asked in a second, or told at least."""
    if isinstance(resource, Sensor):
        return resource.rate if resource.can_be_asked and not resource.pushes else 0.0
    timeout = getattr(resource, "command_timeout", None)
    return 1.0 / timeout if timeout else 0.0


def _buses(plan: Plan) -> list[tuple[str, Bus]]:
    named = list(plan.buses.items())
    known = {id(bus) for _, bus in named}
    for resource in plan.resource_of.values():
        if resource.bus is not None and id(resource.bus) not in known:
            known.add(id(resource.bus))
            named.append((str(getattr(resource.bus, "name", "bus")), resource.bus))
    return named
