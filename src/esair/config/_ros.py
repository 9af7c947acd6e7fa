"""ROS 2 in a file: ``[ros]``, ``[ros.topics."/NAME"]``, services and actions likewise.

Each stands for a part of the robot: a sensor that hears a topic, a behavior ``ros:/cmd_vel``
that drives an actuator by one, a behavior that stands for a service. What ROS may hear and
ask is one behavior ``ros``, as what is shared with a peer.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, Final

import attrs

from esair.actions import Request, answer_type
from esair.config._classes import find_class
from esair.config._draft import Draft, Part
from esair.config._mistakes import dotted, unknown
from esair.config._network import add_table
from esair.config._source import Source
from esair.config._values import INVALID
from esair.resources import Actuator, Sensor

BUS: Final = "ros"
_NAME: Final = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+")
_TYPE: Final = r"[a-z][a-z0-9_]*/{}/[A-Z][A-Za-z0-9]*"
_SCALARS: Final = {"Float": "float", "Int": "int", "UInt": "int", "String": "str"}


@attrs.frozen
class _Topic:
    """A table ``[ros.topics."/NAME"]``: one of sensor, drive and publish."""

    type: str
    sensor: str | None = None
    drive: str | None = None
    publish: str | None = None
    priority: int = 0
    rate: float | None = None
    value: str | None = None
    fields: Mapping[str, str] | str | None = None
    frame: str | None = None
    child: str | None = None
    fixed: Mapping[str, Any] = attrs.field(factory=dict)
    latched: bool = False


@attrs.frozen
class _Service:
    """A table ``[ros.services."/NAME"]`` or of actions: one of ask and behavior."""

    type: str
    request: str
    ask: str | None = None
    behavior: str | None = None
    fields: Mapping[str, str] | None = None
    answer: Mapping[str, str] | str | None = None


@attrs.frozen
class _Ros:
    """The table ``[ros]``."""

    python: str = "/usr/bin/python3"
    setup: str | None = None
    node: str | None = None
    namespace: str = ""
    domain: int | None = None
    topics: Mapping[str, Any] = attrs.field(factory=dict)
    services: Mapping[str, Any] = attrs.field(factory=dict)
    actions: Mapping[str, Any] = attrs.field(factory=dict)


@attrs.define
class Citizen:
    """What a file says of ROS, as far as it is sound."""

    table: _Ros
    topics: dict[str, _Topic]
    calls: dict[tuple[str, str], _Service]  # by kind, service or action, and name
    network: Any = None


def read_ros(source: Source) -> Citizen | None:
    """Return what a file says of ROS, and write the tables that it stands for."""
    if "ros" not in source.data:
        return None
    table = source.convert(source.data["ros"], _Ros, "ros")
    if table is INVALID:
        return None
    found: dict[str, dict[str, Any]] = {}
    names: dict[str, str] = {}
    for kind, suffix, form, ways in (
        ("topic", "msg", _Topic, ("sensor", "drive", "publish")),
        ("service", "srv", _Service, ("ask", "behavior")),
        ("action", "action", _Service, ("ask", "behavior")),
    ):
        tables = getattr(table, f"{kind}s")
        found[kind] = dict(_sound(source, kind, suffix, form, tables, ways))
        for name in found[kind]:
            other = names.setdefault(name, kind)
            if other != kind:  # by its name it is known what comes
                wrong = (
                    f"there is a {other} {name!r} already: a robot has one of a name"
                )
                source.mistakes.add(dotted("ros", f"{kind}s", name), wrong)
    calls = {
        (kind, name): each
        for kind in ("service", "action")
        for name, each in found[kind].items()
    }
    citizen = Citizen(table, found["topic"], calls)
    add_table(source, "ros", "sensor", BUS, {"driver": "esair.drivers.peer:Peer"}, BUS)
    for name, topic in citizen.topics.items():
        if topic.publish is None:
            told: dict[str, Any] = {"driver": "esair.drivers.peer:PeerSensor"}
            told |= {"remote": name, "link_rate": topic.rate or 100.0}
            if topic.drive is None and (value := _kind_of(topic)) is not None:
                told["type"] = value
            where = dotted("ros", "topics", name)
            add_table(source, where, "sensor", _sensor_of(name, topic), told, BUS)
    return citizen


def _sound(
    source: Source,
    kind: str,
    suffix: str,
    form: type,
    tables: Mapping[str, Any],
    ways: tuple[str, ...],
) -> Any:
    for name, table in tables.items():
        key = dotted("ros", f"{kind}s", name)
        told = source.convert(table, form, key)
        if told is INVALID:
            continue
        if not _NAME.fullmatch(name):
            source.mistakes.add(key, f"expected the whole name of a {kind}: '/name'")
        elif not re.fullmatch(_TYPE.format(suffix), told.type):
            source.wrong(f"{key}.type", f"'package/{suffix}/Name'", told.type)
        elif sum(getattr(told, way) is not None for way in ways) != 1:
            source.mistakes.add(key, f"expected one of {', '.join(ways)}")
        else:
            yield name, told


def _sensor_of(name: str, topic: _Topic) -> str:
    return topic.sensor or name.strip("/").replace("/", "_").lower()


def _kind_of(topic: _Topic) -> str | None:
    """Return the name of the class of a topic's readings."""
    from esair.buses.ros import READY

    if topic.value is not None or isinstance(topic.fields, str):
        return topic.value
    if topic.type in READY:
        is_row = topic.type == "tf2_msgs/msg/TFMessage"
        return "tuple" if is_row else f"esair.buses.ros:{READY[topic.type][0].__name__}"
    package, _, name = topic.type.rpartition("/")
    if package == "std_msgs/msg" and not name.endswith("Array"):
        kinds = {**_SCALARS, "Bool": "bool"}
        return next((kinds[each] for each in kinds if name.startswith(each)), None)
    return None


def add_bus(draft: Draft, citizen: Citizen | None) -> None:
    """Make the bus to ROS, before what is on it."""
    if citizen is None:
        return
    from esair.buses.peer import PeerBus
    from esair.buses.ros import Process, Ros

    source, told = draft.source, citizen.table
    robot = source.data.get("robot", {})
    me = robot.get("name", "robot") if isinstance(robot, dict) else "robot"
    made = None
    try:
        citizen.network = Ros(
            (),
            me=str(me),
            begin=Process(told.python, told.setup),
            node=told.node,
            namespace=told.namespace,
            domain=told.domain,
        )
        made = PeerBus(name=BUS, network=citizen.network)
    except Exception as error:
        source.mistakes.caught("ros", error, "ROS")
    if BUS in draft.buses:
        source.mistakes.add("ros", f"there is a bus or a peer {BUS!r} already")
    draft.parts.append(Part("bus", BUS, made))
    if draft.simulated:  # it is in ROS as the robot is
        source.data.setdefault("bus", {}).setdefault(BUS, {"sim": {}})


def add_citizen(draft: Draft, citizen: Citizen | None) -> None:
    """Make what ROS may move, hear and ask, and what stands for its services."""
    bus: Any = draft.buses.get(BUS)
    if citizen is None or bus is None:
        return
    from esair.peers import Share, Sharing, peer_behavior

    shares: dict[str, Share] = {}
    for name, topic in citizen.topics.items():
        _add_topic(draft, citizen, name, topic, shares)
    for (kind, name), call in citizen.calls.items():
        key = dotted("ros", f"{kind}s", name)
        request = _class(draft, f"{key}.request", call.request)
        if request is None:
            continue
        if not issubclass(request, Request):
            told = f"{call.request!r} is not derived from esair.Request"
            draft.source.mistakes.add(f"{key}.request", told)
            continue
        part = call.ask or call.behavior or ""
        if call.ask is not None:
            shares[part] = Share(part, "ask")
            _is_there(draft, f"{key}.ask", part, "behavior")
        else:
            made = peer_behavior(part, bus, [request], remote=name)
            _add_behavior(draft, key, part, made)
        flow = "in" if call.ask is not None else "out"
        forms = {
            "form": (request, call.fields),
            "answer": (answer_type(request), call.answer),
        }
        _link(draft, citizen, key, name, call, kind, flow, part, forms)
    if shares:
        _add_behavior(draft, "ros", BUS, Sharing(bus=bus, shares=shares.values()))


def _add_topic(
    draft: Draft, citizen: Citizen, name: str, topic: _Topic, shares: dict[str, Any]
) -> None:
    from esair.peers import Drive, Share

    key = dotted("ros", "topics", name)
    flow, part = "in", topic.publish or topic.drive or ""
    kind = None if topic.value is None else _class(draft, f"{key}.value", topic.value)
    if topic.drive is not None:
        if not _is_there(draft, f"{key}.drive", part, "actuator"):
            return
        found = draft.made(Actuator).get(part)
        kind = kind or getattr(found, "value_type", None)
        part = _sensor_of(name, topic)
        drive = Drive(
            topic=name, sensor=part, actuator=topic.drive, priority=topic.priority
        )
        _add_behavior(draft, key, drive.name, drive)
    elif topic.publish is not None:
        flow = "out"
        if not _is_there(draft, f"{key}.publish", part, "sensor"):
            return
        found = draft.made(Sensor).get(part)
        kind = kind or getattr(found, "value_type", None)
        rate = max(topic.rate or 20.0, shares[part].rate if part in shares else 0.0)
        try:
            shares[part] = Share(part, "read", rate=rate)
        except Exception as error:
            draft.source.mistakes.caught(key, error, "the topic")
    kind = None if kind is Any else kind
    _link(
        draft,
        citizen,
        key,
        name,
        topic,
        "topic",
        flow,
        part,
        {"form": (kind, topic.fields)},
    )


def _link(
    draft: Draft,
    citizen: Citizen,
    key: str,
    name: str,
    told: Any,
    kind: Any,
    flow: Any,
    part: str,
    forms: Mapping[str, tuple[Any, Any]],
) -> None:
    from esair.buses.ros import Link, form_of

    fixed: dict[str, Any] = dict(getattr(told, "fixed", {}))
    for field, path in (("frame", "header.frame_id"), ("child", "child_frame_id")):
        if getattr(told, field, None) is not None:
            fixed[path] = getattr(told, field)
    made = {}
    for each, (of, fields) in forms.items():
        try:
            made[each] = form_of(
                told.type, of, fields, fixed if kind == "topic" else {}
            )
        except ValueError as error:
            draft.source.mistakes.add(key, str(error))
            return
    rate, latched = getattr(told, "rate", None) or 20.0, getattr(told, "latched", False)
    link = Link(name, told.type, kind, flow, part, **made, latched=latched, rate=rate)
    citizen.network.links.append(link)


def _is_there(draft: Draft, key: str, name: str, kind: str) -> bool:
    """Tell whether a table names a part of the file; if not, that is a mistake."""
    known = [each.name for each in draft.parts if each.kind == kind]
    if name not in known:
        draft.source.mistakes.add(key, unknown(kind, name, known))
    return name in known


def _class(draft: Draft, key: str, name: str) -> Any:
    source = draft.source
    return find_class(name, key, source.mistakes, group="", folder=source.folder)


def _add_behavior(draft: Draft, key: str, name: str, made: Any) -> None:
    if name in {each.name for each in draft.parts if each.kind == "behavior"}:
        draft.source.mistakes.add(key, f"there is a behavior {name!r} already")
        return
    draft.source.mistakes.lines.put(f"behavior.{name}", key)
    draft.parts.append(Part("behavior", name, made))
