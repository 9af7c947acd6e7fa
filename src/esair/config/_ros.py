"""ROS 2 in a file: ``[ros]``, ``[ros.topics."/NAME"]``, services and actions likewise.

Each stands for a part of the robot: a sensor that hears a topic, a behavior ``ros:/cmd_vel``
that drives an actuator by one, a behavior that stands for a service. What ROS may hear and
ask is one behavior ``ros``, as what is shared with a peer.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from functools import partial
from typing import Any, Final

import attrs

from esair.actions import answer_type
from esair.config._classes import find_class
from esair.config._draft import Draft, Part
from esair.config._mistakes import dotted
from esair.config._network import (
    add_behavior,
    add_remote,
    add_sharing,
    add_table,
    joined,
    part_of,
    requests_of,
    share_of,
)
from esair.config._source import Source
from esair.config._values import INVALID
from esair.exceptions import ConfigError

BUS: Final = "ros"
_NAME: Final = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+")
_TYPE: Final = r"[a-z][a-z0-9_]*/{}/[A-Z][A-Za-z0-9]*"


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
    fixed: dict[str, Any] = attrs.field(factory=dict)
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

    def __attrs_post_init__(self) -> None:
        for field, names in (
            ("node", [self.node or "_"]),
            ("namespace", self.namespace.strip("/").split("/")),
        ):
            if not all(re.fullmatch(r"[A-Za-z_]\w*", n, re.ASCII) for n in names if n):
                told = f"expected letters, digits and '_', not {getattr(self, field)!r:.80}"
                raise ConfigError("ros", field, told)
        if self.domain is not None and not 0 <= self.domain <= 232:
            raise ConfigError("ros", "domain", f"expected 0 to 232, not {self.domain}")


_FORMS: Final = (
    ("topic", "msg", _Topic, ("sensor", "drive", "publish")),
    ("service", "srv", _Service, ("ask", "behavior")),
    ("action", "action", _Service, ("ask", "behavior")),
)
"""What tables there are: of what, the package of its types, and what it can be here."""


@attrs.frozen
class _Entry:
    """A name in ROS: a topic, a service or an action, with its table."""

    kind: Any
    name: str
    told: Any
    key: str

    @property
    def part(self) -> str:
        """The sensor that hears a topic."""
        return self.told.sensor or self.name.strip("/").replace("/", "_").lower()


@attrs.frozen
class Citizen:
    """What a file says of ROS, as far as it is sound."""

    network: Any
    entries: list[_Entry]


def read_ros(draft: Draft) -> Citizen | None:
    """Return what a file says of ROS, and write the tables that it stands for."""
    source = draft.source
    if "ros" not in source.data:
        return None
    table = source.convert(joined(draft, "ros").table, _Ros, "ros")
    if table is INVALID:
        return None
    from esair.buses.ros import Process, Ros

    network = Ros(
        (),
        me=draft.robot["name"],
        begin=Process(table.python, table.setup),
        node=table.node,
        namespace=table.namespace,
        domain=table.domain,
    )
    citizen = Citizen(network, list(_entries(source, table)))
    add_table(source, "ros", "sensor", BUS, "Peer", {}, BUS)
    for entry in citizen.entries:
        topic = entry.told
        if entry.kind == "topic" and topic.publish is None:
            told = {"remote": entry.name, "link_rate": topic.rate or 100.0}
            if topic.drive is None:
                told["type"] = _link(draft, citizen, entry, "in", entry.part)
            add_table(source, entry.key, "sensor", entry.part, "PeerSensor", told, BUS)
    return citizen


def _entries(source: Source, table: _Ros) -> Iterator[_Entry]:
    """Yield the tables that are sound; a name is there once: by it is known what comes."""
    kinds: dict[str, str] = {}
    add = source.mistakes.add
    for kind, package, form, ways in _FORMS:
        for name, raw in getattr(table, f"{kind}s").items():
            key = dotted("ros", f"{kind}s", name)
            told: Any = source.convert(raw, form, key)
            if told is INVALID:
                continue
            if not _NAME.fullmatch(name):
                add(key, f"expected the whole name of a {kind}: '/name'")
            elif not re.fullmatch(_TYPE.format(package), told.type):
                source.wrong(f"{key}.type", f"'package/{package}/Name'", told.type)
            elif sum(getattr(told, way) is not None for way in ways) != 1:
                add(key, f"expected one of {', '.join(ways)}")
            elif (
                kind == "topic" and told.rate is not None and not 0 < told.rate <= 1000
            ):
                source.wrong(
                    f"{key}.rate", "more than 0 and at most 1000 Hz", told.rate
                )
            elif kind == "topic" and told.latched and told.drive is not None:
                add(f"{key}.latched", "a command of before would move it at each start")
            elif (other := kinds.setdefault(name, kind)) != kind:
                add(
                    key,
                    f"there is a {other} {name!r} already: a robot has one of a name",
                )
            else:
                yield _Entry(kind, name, told, key)


def add_citizen(draft: Draft, citizen: Citizen) -> None:
    """Make what ROS may move, hear and ask, and what stands for its services."""
    from esair.peers import Drive

    shares: dict[str, Any] = {}
    for entry in citizen.entries:
        told, key = entry.told, entry.key
        if entry.kind != "topic":
            requests = requests_of(draft, f"{key}.request", [told.request])
            if told.ask is not None:
                part = part_of(draft, f"{key}.ask", told.ask, "behavior")
                shares[told.ask] = share_of(draft, key, part)
                flow, name = "in", told.ask
            else:
                add_remote(draft, key, told.behavior, BUS, requests, entry.name)
                flow, name = "out", told.behavior
            for request in requests:
                _link(draft, citizen, entry, flow, name, request)
        elif told.drive is not None:
            if (part := part_of(draft, f"{key}.drive", told.drive, "actuator")) is None:
                continue
            drive = Drive(
                topic=entry.name,
                sensor=entry.part,
                actuator=told.drive,
                priority=told.priority,
            )
            add_behavior(draft, key, drive.name, drive)
            _link(draft, citizen, entry, "in", entry.part, _type_of(part))
        elif told.publish is not None:
            name = told.publish
            if (part := part_of(draft, f"{key}.publish", name, "sensor")) is None:
                continue
            rate = max(told.rate or 20.0, getattr(shares.get(name), "rate", 0.0))
            shares[name] = share_of(draft, key, part, rate=rate)
            _link(draft, citizen, entry, "out", name, _type_of(part))
    add_sharing(draft, "ros", BUS, shares.values())


def _type_of(part: Part) -> Any:
    kind = getattr(part.made, "value_type", Any)
    return None if kind is Any else kind


def _link(
    draft: Draft,
    citizen: Citizen,
    entry: _Entry,
    flow: Any,
    part: str,
    kind: Any = None,
) -> Any:
    """Add a link, for values of a class or for a request; return their type."""
    from esair.buses.ros import Link, form_of

    source, told, links = draft.source, entry.told, citizen.network.links
    link = partial(Link, entry.name, told.type, entry.kind, flow, part)
    try:
        if not isinstance(told, _Topic):
            form = form_of(told.type, kind, told.fields)
            answer = form_of(told.type, answer_type(kind), told.answer)
            links.append(link(form=form, answer=answer))
            return None
        if told.value is not None:
            where = f"{entry.key}.value"
            kind = find_class(
                *(told.value, where, source.mistakes), group="", folder=source.folder
            )
        frames = {"header.frame_id": told.frame, "child_frame_id": told.child}
        fixed = told.fixed | {path: each for path, each in frames.items() if each}
        form = form_of(told.type, kind, told.fields, fixed)
    except ValueError as error:
        source.mistakes.add(entry.key, str(error))
        return Any
    links.append(link(form=form, latched=told.latched, rate=told.rate or 20.0))
    return form.type
