"""From a file to a robot."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar, overload

import attrs

from esair.actions import Behavior, ProfiledAction, Reaction
from esair.buses import Bus
from esair.config._parts import make_draft, refused_by_robot
from esair.config._source import read_source
from esair.exceptions import ConfigError
from esair.messages import BehaviorsPolicy, Policy
from esair.plan import examine
from esair.resources import Resource
from esair.standard import Robot

R = TypeVar("R")


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


def load(
    path: str | os.PathLike[str],
    *,
    simulated: bool = False,
    robot_class: type = Robot,
    text: str | None = None,
) -> Description:
    """Read and check a configuration; nothing is opened, nothing moves.

    Modules that the file names are also found in its own folder.

    Args:
        path: The file, in TOML.
        simulated: Whether the ``sim`` tables replace what they stand beside.
        robot_class: The class of the robot, if it is not `esair.Robot`: its
            keywords are the keys of the table ``[robot]``.
        text: What the file says; it is read unless given.

    Raises:
        ConfigError: The file cannot be read, or is no TOML.
        ExceptionGroup: Every mistake in it at once, each a `ConfigError` that
            names file, line, key, and what was expected.
    """
    source = read_source(path, text)
    draft = make_draft(source, simulated=simulated, robot_class=robot_class)
    for finding in examine(draft.plan()):
        if finding.is_error:
            source.mistakes.add(draft.key_of(finding), finding.text)
    refused_by_robot(draft, robot_class, sound=not source.mistakes.errors)
    source.mistakes.raise_all()
    return Description(
        path=source.path,
        digest=source.digest,
        text=source.text,
        simulated=simulated,
        robot=draft.robot,
        buses=draft.made(Bus),
        resources=draft.made(Resource),
        behaviors=draft.made(ProfiledAction),
        policies=draft.policies,
    )


@overload
def build(description: Description) -> Robot: ...
@overload
def build(description: Description, robot_class: Callable[..., R]) -> R: ...
def build(description: Description, robot_class: Callable[..., Any] = Robot) -> Any:
    """Make the robot that was described. It is not started.

    Args:
        description: What `load` returned; it serves for one robot.
        robot_class: The class of the robot; `esair.Robot` unless given.

    Raises:
        ConfigError: A robot was made of this description already.
        ExceptionGroup: The robot refuses what is described.
    """
    if description.is_built:
        raise ConfigError(
            str(description.path),
            "",
            "a robot was made of it already: load the file again",
        )
    robot = robot_class(
        resources=list(description.resources.values()),
        behaviors=list(description.behaviors.values()),
        policies=list(description.policies.values()),
        **description.robot,
    )
    description.is_built = True
    robot.source = (description.path, description.simulated)
    return robot


def load_robot(
    path: str | os.PathLike[str], robot_class: type[R], simulated: bool = False
) -> R:
    """Make a robot from a file; see `load` and `build`."""
    description = load(path, simulated=simulated, robot_class=robot_class)
    return build(description, robot_class)
