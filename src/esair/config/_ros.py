"""ROS 2 in a file: ``[ros]``, ``[ros.topics."/NAME"]``, services and actions likewise.

Each stands for a part of the robot: a sensor that hears a topic, a behavior ``ros:/cmd_vel``
that drives an actuator by one, a behavior that stands for a service. What ROS may hear and
ask is one behavior ``ros``, as what is shared with a peer.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any, Final

import attrs

from esair.actions import Request, answer_type
from esair.config._classes import find_class
from esair.config._draft import Draft, Part
from esair.config._mistakes import dotted, unknown
from esair.config._network import add_peer_bus, add_table
from esair.config._source import Source
from esair.config._values import INVALID
from esair.resources import Actuator, Sensor

BUS: Final = "ros"
_NAME: Final = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+")
_TYPE: Final = r"[a-z][a-z0-9_]*/{}/[A-Z][A-Za-z0-9]*"
_SCALARS: Final = {
    "Float": "float",
    "Int": "int",
    "UInt": "int",
    "String": "str",
    "Bool": "bool",
}


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


@attrs.frozen
class _Entry:
    """A name in ROS: a topic, a service or an action, with its table."""

    kind: str
    name: str
    told: Any

    @property
    def key(self) -> str:
        return dotted("ros", f"{self.kind}s", self.name)

    @property
    def part(self) -> str:
        """The sensor that hears a topic."""
        return self.told.sensor or self.name.strip("/").replace("/", "_").lower()


@attrs.define
class Citizen:
    """What a file says of ROS, as far as it is sound."""

    table: _Ros
    entries: list[_Entry]
    network: Any = None


_FORMS: Final = (
    ("topic", "msg", _Topic, ("sensor", "drive", "publish")),
    ("service", "srv", _Service, ("ask", "behavior")),
    ("action", "action", _Service, ("ask", "behavior")),
)
"""What tables there are: of what, the package of its types, and what it can be here."""


def read_ros(source: Source) -> Citizen | None:
    """Return what a file says of ROS, and write the tables that it stands for."""
    if "ros" not in source.data:
        return None
    table = source.convert(source.data["ros"], _Ros, "ros")
    if table is INVALID:
        return None
    citizen = Citizen(table, list(_entries(source, table)))
    add_table(source, "ros", "sensor", BUS, {"driver": "esair.drivers.peer:Peer"}, BUS)
    for entry in citizen.entries:
        topic = entry.told
        if entry.kind == "topic" and topic.publish is None:
            told: dict[str, Any] = {"driver": "esair.drivers.peer:PeerSensor"}
            told |= {"remote": entry.name, "link_rate": topic.rate or 100.0}
            if topic.drive is None and (value := _kind_of(topic)) is not None:
                told["type"] = value
            add_table(source, entry.key, "sensor", entry.part, told, BUS)
    return citizen


def _entries(source: Source, table: _Ros) -> Iterator[_Entry]:
    """Yield the tables that are sound; a name is there once: by it is known what comes."""
    kinds: dict[str, str] = {}
    for kind, package, form, ways in _FORMS:
        for name, raw in getattr(table, f"{kind}s").items():
            key = dotted("ros", f"{kind}s", name)
            told: Any = source.convert(raw, form, key)
            if told is INVALID:
                continue
            if not _NAME.fullmatch(name):
                wrong = f"expected the whole name of a {kind}: '/name'"
            elif not re.fullmatch(_TYPE.format(package), told.type):
                source.wrong(f"{key}.type", f"'package/{package}/Name'", told.type)
                continue
            elif sum(getattr(told, way) is not None for way in ways) != 1:
                wrong = f"expected one of {', '.join(ways)}"
            elif (other := kinds.setdefault(name, kind)) != kind:
                wrong = (
                    f"there is a {other} {name!r} already: a robot has one of a name"
                )
            else:
                yield _Entry(kind, name, told)
                continue
            source.mistakes.add(key, wrong)


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
        return next(
            (_SCALARS[each] for each in _SCALARS if name.startswith(each)), None
        )
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
    add_peer_bus(draft, BUS, made)


def add_citizen(draft: Draft, citizen: Citizen | None) -> None:
    """Make what ROS may move, hear and ask, and what stands for its services."""
    bus: Any = draft.buses.get(BUS)
    if citizen is None or bus is None:
        return
    from esair.peers import Share, Sharing, peer_behavior

    shares: dict[str, Share] = {}
    for entry in citizen.entries:
        told = entry.told
        if entry.kind == "topic":
            _add_topic(draft, citizen, entry, shares)
            continue
        request = _class(draft, f"{entry.key}.request", told.request)
        if request is None:
            continue
        if not issubclass(request, Request):
            wrong = f"{told.request!r} is not derived from esair.Request"
            draft.source.mistakes.add(f"{entry.key}.request", wrong)
            continue
        form, answer = (request, told.fields), (answer_type(request), told.answer)
        if told.ask is not None:
            shares[told.ask] = Share(told.ask, "ask")
            _is_there(draft, entry, "ask", "behavior")
            _link(draft, citizen, entry, "in", told.ask, form, answer)
        else:
            made = peer_behavior(told.behavior, bus, [request], remote=entry.name)
            _add_behavior(draft, entry.key, told.behavior, made)
            _link(draft, citizen, entry, "out", told.behavior, form, answer)
    if shares:
        _add_behavior(draft, "ros", BUS, Sharing(bus=bus, shares=shares.values()))


def _add_topic(
    draft: Draft, citizen: Citizen, entry: _Entry, shares: dict[str, Any]
) -> None:
    from esair.peers import Drive, Share

    told, flow = entry.told, "in"
    kind = told.value and _class(draft, f"{entry.key}.value", told.value)
    part, found = entry.part, None
    if told.drive is not None:
        if not _is_there(draft, entry, "drive", "actuator"):
            return
        found = draft.made(Actuator).get(told.drive)
        drive = Drive(
            topic=entry.name, sensor=part, actuator=told.drive, priority=told.priority
        )
        _add_behavior(draft, entry.key, drive.name, drive)
    elif told.publish is not None:
        flow, part = "out", told.publish
        if not _is_there(draft, entry, "publish", "sensor"):
            return
        found = draft.made(Sensor).get(part)
        rate = max(told.rate or 20.0, shares[part].rate if part in shares else 0.0)
        try:
            shares[part] = Share(part, "read", rate=rate)
        except Exception as error:
            draft.source.mistakes.caught(entry.key, error, "the topic")
    kind = kind or getattr(found, "value_type", None)
    _link(
        draft, citizen, entry, flow, part, (None if kind is Any else kind, told.fields)
    )


def _link(
    draft: Draft,
    citizen: Citizen,
    entry: _Entry,
    flow: Any,
    part: str,
    form: tuple[Any, Any],
    answer: tuple[Any, Any] | None = None,
) -> None:
    """Add a link: its form is of a class, and has the paths of its fields."""
    from esair.buses.ros import Link, form_of

    told, kind = entry.told, entry.kind
    more: dict[str, Any] = {}
    try:
        if isinstance(told, _Topic):
            fixed = dict(told.fixed)
            if told.frame is not None:
                fixed["header.frame_id"] = told.frame
            if told.child is not None:
                fixed["child_frame_id"] = told.child
            more = {"latched": told.latched, "rate": told.rate or 20.0}
            more["form"] = form_of(told.type, *form, fixed)
        else:
            more["form"] = form_of(told.type, *form)
            more["answer"] = form_of(told.type, *(answer or ()))
    except ValueError as error:
        draft.source.mistakes.add(entry.key, str(error))
        return
    link: Any = Link
    citizen.network.links.append(link(entry.name, told.type, kind, flow, part, **more))


def _is_there(draft: Draft, entry: _Entry, way: str, kind: str) -> bool:
    """Tell whether a table names a part of the file; if not, that is a mistake."""
    name = getattr(entry.told, way)
    known = [each.name for each in draft.parts if each.kind == kind]
    if name not in known:
        draft.source.mistakes.add(f"{entry.key}.{way}", unknown(kind, name, known))
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
