"""A robot as its file describes it: every part made and checked, nothing opened."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import attrs

from esair.actions import Behavior, Reaction
from esair.buses import Bus
from esair.messages import BehaviorsPolicy, Policy
from esair.resources import Resource


@attrs.define(eq=False)
class Description:
    """What one configuration file says, checked as a whole.

    The components are made, so that their own checks have passed; no device or
    bus is opened. They serve one robot: load the file again for another one.

    Attributes:
        path: The file.
        digest: SHA-256 of the file as it was read, in hexadecimal.
        text: What it says.
        simulated: Whether the ``sim`` tables of the devices were used.
        robot: The keywords of the robot, its name among them.
        buses: The buses, by name.
        resources: The sensors and actuators, by name.
        behaviors: The behaviors and reactions, by name.
        policies: Who may do what with a resource, by the name of the resource; under
            ``behaviors`` who may manage others.
    """

    path: Path
    digest: str
    text: str
    simulated: bool
    robot: Mapping[str, Any]
    buses: Mapping[str, Bus]
    resources: Mapping[str, Resource]
    behaviors: Mapping[str, Behavior | Reaction]
    policies: Mapping[str, Policy | BehaviorsPolicy]
    is_built: bool = attrs.field(default=False, init=False)
    """Whether a robot was made of it."""

    @property
    def name(self) -> str:
        """The name of the robot."""
        return str(self.robot["name"])
