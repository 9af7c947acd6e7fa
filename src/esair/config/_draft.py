"""What could be made of a file so far: sound parts, and the names of the others."""

from __future__ import annotations

from typing import Any

import attrs

from esair.actions import Behavior, Reaction
from esair.buses import Bus
from esair.config._source import Source
from esair.messages import Policy
from esair.resources import Resource


@attrs.define
class Draft:
    """What could be made of a file. Parts with mistakes are declared, but not made.

    Attributes:
        source: The file.
        simulated: Whether the ``sim`` tables were used.
        robot: The keywords of the robot.
        buses: The buses, by name; None for one that could not be made.
        resources: The sensors and actuators, likewise.
        behaviors: The behaviors and reactions, likewise.
        policies: Who may do what with a resource, by the name of the resource.
        keys: The key of each resource in the file.
        bus_of: The name of the bus of each resource that is on one.
    """

    source: Source
    simulated: bool
    robot: dict[str, Any] = attrs.field(factory=dict)
    buses: dict[str, Bus | None] = attrs.field(factory=dict)
    resources: dict[str, Resource | None] = attrs.field(factory=dict)
    behaviors: dict[str, Behavior | Reaction | None] = attrs.field(factory=dict)
    policies: dict[str, Policy] = attrs.field(factory=dict)
    keys: dict[str, str] = attrs.field(factory=dict)
    bus_of: dict[str, str] = attrs.field(factory=dict)
