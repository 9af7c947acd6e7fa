"""From the tables of a file to the parts of a robot: as far as they are sound."""

from __future__ import annotations

from typing import Any, Final

from esair.config._boards import add_boards
from esair.config._components import make_behavior, make_bus, make_device
from esair.config._construct import keywords_of
from esair.config._draft import Draft, Part
from esair.config._mistakes import below, dotted, unknown
from esair.config._network import TABLES as OF_NETWORK
from esair.config._network import add_behaviors, add_buses, read_peers
from esair.config._policies import read_policies
from esair.config._records import make_of
from esair.config._ros import add_bus, add_citizen, read_ros
from esair.config._source import Source
from esair.config._tables import named_tables
from esair.config._values import INVALID
from esair.exceptions import EsairError
from esair.messages import Mode
from esair.resources import Actuator, Sensor

OF_ROBOT: Final = frozenset({"operator", "record", "page"})
"""The tables that are keywords of the robot with fields of their own."""

TABLES: Final = (
    *("robot", "board", "bus", "sensor", "actuator", "behavior", "mode", "access"),
    *OF_ROBOT,
    *sorted(OF_NETWORK),
    "ros",
)
"""The tables of a file."""


def make_draft(source: Source, *, simulated: bool, robot_class: type) -> Draft:
    """Make every component that a file describes; mistakes go to the source."""
    draft = Draft(source, simulated)
    for name, value in list(source.data.items()):
        if name not in TABLES:
            source.mistakes.add(dotted(name), unknown("table", name, TABLES))
        elif not isinstance(value, dict):
            source.wrong(name, "a table", value)
            del source.data[name]
    add_boards(
        source,
        lambda other: make_draft(other, simulated=False, robot_class=robot_class),
    )
    draft.robot = _read_robot(source, robot_class)
    draft.peers = peers = read_peers(source)
    ros = read_ros(source)
    for name, table in named_tables(source, "bus"):
        draft.parts.append(Part("bus", name, make_bus(draft, name, table)))
    add_buses(draft, peers)
    add_bus(draft, ros)
    for kind, base in (("sensor", Sensor), ("actuator", Actuator)):
        for name, table in named_tables(source, kind):
            key = f"{kind}.{name}"
            draft.parts.append(make_device(draft, key, name, table, base))
    for name, table in named_tables(source, "behavior"):
        draft.parts.append(Part("behavior", name, make_behavior(draft, name, table)))
    add_behaviors(draft, peers)
    add_citizen(draft, ros)
    draft.policies = read_policies(source)
    modes = {
        name: source.convert(table, Mode, f"mode.{name}")
        for name, table in named_tables(source, "mode")
    }
    sound = {name: mode for name, mode in modes.items() if mode is not INVALID}
    if sound:
        draft.robot["modes"] = sound
    return draft


def _read_robot(source: Source, robot_class: type) -> dict[str, Any]:
    table = source.data.get("robot", {})
    parts = {"resources", "behaviors", "policies", "buses", "modes", *OF_ROBOT}
    keywords = keywords_of(robot_class).fields
    settings: dict[str, Any] = {"name": "robot"}
    given = {below("robot", name): (name, value) for name, value in table.items()}
    given |= {each: (each, source.data[each]) for each in OF_ROBOT & source.data.keys()}
    for key, (name, value) in given.items():
        if name not in keywords or (name in parts and key != name):
            source.mistakes.add(key, unknown("key", name, keywords.keys() - parts))
            continue
        result = source.convert(value, keywords[name].kind, key)
        if result is not INVALID:
            settings[name] = result
    source.is_name("robot", settings["name"], "robot.name")
    return settings


def refused_by_robot(draft: Draft, robot_class: type, *, sound: bool) -> None:
    """Note what the constructor of the robot refuses.

    Args:
        draft: What could be made of the file.
        robot_class: The class of the robot.
        sound: Whether it has no mistake yet; else only what its tables say is looked at.
    """
    plan = draft.plan()
    parts = {
        "resources": plan.resources,
        "behaviors": plan.behaviors,
        "policies": plan.policies,
    }

    def refused(error: BaseException) -> None:
        if not isinstance(error, EsairError | ExceptionGroup):
            raise error
        about = getattr(error, "component", "")
        key = about if about in OF_ROBOT else "robot"
        draft.source.mistakes.caught(key, error, "the robot")

    make_of(robot_class, {**parts, **draft.robot}, refused, sound=sound)
