"""From the tables of a file to the parts of a robot: as far as they are sound."""

from __future__ import annotations

import functools
import operator
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, Literal

import attrs

from esair.actions import Reaction
from esair.config._components import (
    keywords_of,
    make_behavior,
    make_bus,
    make_device,
    named_tables,
)
from esair.config._draft import BEHAVIORS, Draft, Part
from esair.config._mistakes import below, dotted, show, unknown
from esair.config._network import TABLES as OF_NETWORK
from esair.config._network import add_behaviors, add_buses, read_peers
from esair.config._ros import BUS, add_citizen, read_ros
from esair.config._source import Source, read_source
from esair.config._values import INVALID, WORDS, Invalid, make_of
from esair.exceptions import ConfigError, EsairError, did_you_mean
from esair.messages import Access, BehaviorsPolicy, Mode, Policy
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
    _add_boards(source, robot_class)
    draft.robot = _read_robot(source, robot_class)
    draft.peers = peers = read_peers(draft)
    ros = read_ros(draft)
    for name, table in named_tables(source, "bus"):
        draft.parts.append(Part("bus", name, make_bus(draft, name, table)))
    _refuse_shared_ports(draft)
    if peers is not None:
        add_buses(draft, "network", peers.names, peers.network)
    if ros is not None:
        add_buses(draft, "ros", [BUS], ros.network)
    for kind, base in (("sensor", Sensor), ("actuator", Actuator)):
        for name, table in named_tables(source, kind):
            key = f"{kind}.{name}"
            draft.parts.append(make_device(draft, key, name, table, base))
    for name, table in named_tables(source, "behavior"):
        draft.parts.append(Part("behavior", name, make_behavior(draft, name, table)))
    if peers is not None:
        add_behaviors(draft, peers)
    if ros is not None:
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


def _refuse_shared_ports(draft: Draft) -> None:
    """Note each bus that could not be opened beside another one of the file."""
    owners: dict[str, str] = {}
    for part in draft.parts:
        place = None if part.made is None else part.made.alone_at()
        owner = part.name if place is None else owners.setdefault(place, part.name)
        if owner != part.name:
            told = f"{place} belongs to the bus {owner!r}: a port has one bus"
            draft.source.mistakes.add(below(part.key, "port"), told)


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


_RIGHTS: Final = {
    "read": Access.READ,
    "write": Access.WRITE,
    "configure": Access.CONFIGURE,
    "guard": Access.GUARD,
    "none": Access(0),
}


def read_policies(source: Source) -> dict[str, Policy | BehaviorsPolicy]:
    """Return the rules of a file, by the name of the resource."""
    tables = source.data.get("access", {})
    policies: dict[str, Policy | BehaviorsPolicy] = {}
    for name, table in tables.items():
        key = dotted("access", name)
        if not isinstance(table, dict):
            source.wrong(key, 'a table such as { wander = "write" }', table)
        else:
            read = _managers if name == BEHAVIORS else _policy
            policies[name] = read(source, key, name, table)
    return policies


def _managers(
    source: Source, key: str, name: str, table: dict[str, Any]
) -> BehaviorsPolicy:
    return BehaviorsPolicy(_by_behavior(source, key, table, Literal["manage"]))


def _policy(source: Source, key: str, name: str, table: dict[str, Any]) -> Policy:
    rest = dict(table)
    exclusive = rest.pop("exclusive", False)
    levels = rest.pop("max_priority", {})
    if not isinstance(levels, dict):
        source.wrong(
            below(key, "max_priority"), "a table such as { wander = 5 }", levels
        )
        levels = {}
    return Policy(
        name,
        allow=_by_behavior(source, key, rest, Access),
        exclusive=source.convert(exclusive, bool, below(key, "exclusive")) is True,
        max_priority=_by_behavior(source, below(key, "max_priority"), levels, int),
    )


def _by_behavior(
    source: Source, key: str, table: Mapping[str, object], kind: Any
) -> dict[str, Any]:
    """Return what a table says of each behavior, and of all others by ``*``."""
    found: dict[str, Any] = {}
    for behavior, value in table.items():
        where = below(key, behavior)
        if behavior != "*" and not source.is_name("behavior", behavior, where):
            continue
        result = (
            _access(source, where, value)
            if kind is Access
            else source.convert(value, kind, where)
        )
        if result is not INVALID:
            found[behavior] = result
    return found


def _access(source: Source, key: str, value: object) -> Access | Invalid:
    if not isinstance(value, str):
        source.wrong(key, 'rights such as "read, write"', value)
        return INVALID
    words = [word.strip() for word in value.split(",")]
    for word in words:
        if word not in _RIGHTS:
            told = f"expected some of {', '.join(_RIGHTS)}, with commas between them, "
            told += f"not {show(word)}{did_you_mean(word, _RIGHTS)}"
            source.mistakes.add(key, told)
            return INVALID
    return functools.reduce(operator.or_, (_RIGHTS[word] for word in words))


@attrs.frozen
class _Board:
    """A table ``[board.NAME]``."""

    port: str = attrs.field(metadata={WORDS: "its serial port, as 'usb:2e8a:0005'"})
    robot: Path = attrs.field(
        metadata={WORDS: "the file that its firmware is built from, as 'base.toml'"}
    )
    baudrate: int | None = None
    arm: bool | None = None


_DRIVERS: Final = "esair.drivers.board"


def _add_boards(source: Source, robot_class: type) -> None:
    """Write the tables that the boards of a file stand for.

    A board has a bus and a sensor (how it is) of its own name, and its sensors and
    actuators have the names of its own file. A table of such a name adds keys to it.
    """
    for name, table in named_tables(source, "board"):
        key = dotted("board", name)
        board = source.convert(table, _Board, key)
        if name in source.data.get("bus", {}):
            told = f"the board {name!r} has a bus of this name already"
            source.mistakes.add(dotted("bus", name), told)
        elif board is not INVALID:
            for bus, other in named_tables(source, "bus"):
                if other.get("port") == board.port:
                    text = f"{board.port!r} is the port of the bus {bus!r} already"
                    where = dotted("board", name, "port")
                    source.mistakes.add(where, f"{text}: it has one user")
            _add_board(source, name, board, robot_class)


def _add_board(source: Source, name: str, board: _Board, robot_class: type) -> None:
    where = dotted("board", name, "robot")
    try:
        inner = read_source(board.robot)
        parts = make_draft(inner, simulated=False, robot_class=robot_class).parts
        inner.mistakes.raise_all()
    except (ConfigError, ExceptionGroup) as error:
        for each in getattr(error, "exceptions", (error,)):
            source.mistakes.add(where, str(each))
        return
    bus: dict[str, Any] = {"type": "serial", "port": board.port, "framing": "cobs"}
    if board.baudrate is not None:
        bus["baudrate"] = board.baudrate
    source.data.setdefault("bus", {})[name] = bus
    source.mistakes.lines.put(dotted("bus", name), dotted("board", name))
    state: dict[str, Any] = {"driver": f"{_DRIVERS}:Board"}
    if board.arm is not None:
        state["arm"] = board.arm
    _add(source, "sensor", name, {**state, "bus": name}, name)
    for part in parts:
        found = _table_of(part, parts)
        if found is not None:
            _add(source, part.kind, part.name, {**found, "bus": name}, name)


def _table_of(part: Part, parts: list[Part]) -> dict[str, Any] | None:
    if isinstance(part.made, Sensor):
        return {"driver": f"{_DRIVERS}:BoardSensor"}
    if not isinstance(part.made, Actuator):
        return None
    actuator = part.made
    safe = actuator.safe
    return {
        "driver": f"{_DRIVERS}:BoardActuator",
        "safe": list(safe) if isinstance(safe, tuple) else safe,
        "command_timeout": actuator.command_timeout,
        "own_guards": [
            each.name
            for each in parts
            if isinstance(each.made, Reaction)
            and any(need.resource == part.name for need in each.made.needs.values())
        ],
    }


def _add(
    source: Source, kind: str, name: str, table: dict[str, Any], board: str
) -> None:
    source.mistakes.lines.put(dotted(kind, name), dotted("board", board))
    tables = source.data.setdefault(kind, {})
    given = tables.get(name, {})
    if not isinstance(given, dict):
        return  # told already
    if "driver" in given:
        source.mistakes.add(
            dotted(kind, name), f"the board has a {kind} of this name: take another"
        )
        return
    tables[name] = {**table, **given}
    source.implied.add(name)
