"""What is wrong with resources, found before any of them is opened."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

from esair.connections import check_declaration
from esair.exceptions import ConfigError, EsairError
from esair.resources import Actuator, Resource, Sensor, bus_kind
from esair.values import is_positive


def in_use(resource: Resource) -> bool:
    """Tell whether a resource is deployed, in this robot or in another one."""
    return resource._listener is not None  # noqa: SLF001 - set by a supervisor


def used_already(name: str) -> ConfigError:
    """Make the error for a component that a running robot has."""
    told = "it is in a running robot already: make another one for this place"
    return ConfigError(name, "", told)


def mistakes_in_resource(
    resource: object, instead_of: Resource | None = None
) -> list[EsairError]:
    """Return everything that is wrong with one resource.

    Args:
        resource: What is about to be deployed.
        instead_of: A resource that gives its place; it may take it again.
    """
    if not isinstance(resource, Sensor | Actuator):
        wanted = "expected an esair.Sensor or esair.Actuator"
        return [ConfigError(repr(resource), "", wanted)]
    try:
        name = resource.name
    except EsairError as error:
        return [error]
    found: list[EsairError] = [*_in_declaration(resource), *_in_bus(resource)]
    if in_use(resource) and resource is not instead_of:
        found.insert(0, used_already(name))
    if isinstance(resource, Actuator):
        found.extend(check_declaration(resource))
        if getattr(resource.write, "__func__", None) is Actuator.write:
            told = "an actuator must have a write method"
            found.append(ConfigError(name, "write", told))
    elif not (resource.can_be_asked or resource.pushes):
        told = "a sensor must have a read or stream method"
        found.append(ConfigError(name, "read", told))
    return found


def claimed_twice(
    new: Iterable[Resource], there: Iterable[Resource]
) -> Iterator[EsairError]:
    """Name the resources that claim what another one has for itself alone.

    Args:
        new: Sound resources that are about to be deployed.
        there: Those that are deployed already.
    """
    owners = {_claim(each): each.name for each in there}
    for resource in new:
        first = owners.setdefault(_claim(resource), resource.name)
        if resource.claim is not None and first != resource.name:
            told = f"{resource.claim} belongs to {first!r}: they cannot share it"
            yield ConfigError(resource.name, "", told)


def _claim(resource: Resource) -> tuple[int, str | None]:
    return id(resource.bus), resource.claim


def _in_declaration(resource: Resource) -> list[ConfigError]:
    found = []
    name, seconds = resource.name, resource.deadline
    if not is_positive(seconds):
        found.append(
            ConfigError(name, "deadline", f"expected seconds > 0, not {seconds!r:.80}")
        )
    if resource.identity is not None and not resource.identifies:
        found.append(
            ConfigError(
                name, "identity", "its class has no identify to compare it with"
            )
        )
    repeats = resource.max_repeat if isinstance(resource, Sensor) else None
    if repeats is not None and (type(repeats) is not int or repeats < 1):
        found.append(
            ConfigError(
                name, "max_repeat", f"expected a whole number > 0, not {repeats!r:.80}"
            )
        )
    return found


def _in_bus(resource: Resource) -> list[ConfigError]:
    """Compare the bus with what the class declares: ``bus: I2CBus``."""
    kind = bus_kind(type(resource))
    try:
        if kind is Any or isinstance(resource.bus, kind):
            return []
    except TypeError:  # a type that nothing can be compared with at run time
        return []
    expected = getattr(kind, "__name__", str(kind))
    told = f"expected a bus of the class {expected}, not {resource.bus!r:.80}"
    return [ConfigError(resource.name, "bus", told)]
