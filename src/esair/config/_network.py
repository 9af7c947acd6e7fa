"""Peers of a file: ``[network]``, ``[remote.PEER.*]``, ``[share.NAME]``.

Remote sensors and actuators stand for tables of their kinds, on a bus that has the name of
the peer; so does a sensor that tells how the peer is heard. What is shared is one behavior
for each peer, with the peer's name.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import attrs

from esair.actions import Behavior, declared_requests, is_request
from esair.config._classes import find_class
from esair.config._draft import Draft, Part
from esair.config._mistakes import dotted, unknown
from esair.config._source import Source
from esair.config._tables import named_tables
from esair.config._values import INVALID
from esair.plan import inner_of
from esair.resources import Sensor
from esair.values import type_name

TABLES: Final = frozenset({"network", "remote", "share"})

_KINDS: Final = ("sensor", "actuator", "behavior")
_DRIVERS: Final = "esair.drivers.peer"
_ACCESS: Final = {"sensor": "read", "actuator": "write", "behavior": "ask"}


@attrs.frozen
class _Tls:
    """A table ``[network.tls]``."""

    ca: Path
    certificate: Path
    key: Path


@attrs.frozen
class _Network:
    """A table ``[network]``."""

    name: str | None = None
    listen: tuple[str, ...] = ()
    connect: tuple[str, ...] = ()
    tls: _Tls | None = None
    insecure: bool = False
    connect_timeout: float = 0.2


@attrs.frozen
class _Share:
    """A table ``[share.NAME]``."""

    to: tuple[str, ...]
    priority: int = 0
    rate: float = 20.0


@attrs.frozen
class _RemoteBehavior:
    """A table ``[remote.PEER.behavior.NAME]``."""

    requests: tuple[str, ...]
    remote: str | None = None


@attrs.define
class Peers:
    """What a file says of peers, as far as it is sound.

    Attributes:
        me: The name of this robot on the network.
        network: How the network is reached.
        remotes: What is used of each peer: its kind, its local name, its table.
        shares: What is shared, by its name.
    """

    me: str
    network: _Network
    remotes: dict[str, list[tuple[str, str, dict[str, Any]]]]
    shares: dict[str, _Share]

    @property
    def names(self) -> list[str]:
        """The names of the peers."""
        shared = (each for share in self.shares.values() for each in share.to)
        return list(dict.fromkeys([*self.remotes, *shared]))


def read_peers(source: Source) -> Peers | None:
    """Return what a file says of peers, and write the tables that it stands for."""
    if TABLES.isdisjoint(source.data):
        return None
    remotes = dict(_remotes(source))
    shares = {}
    for name, table in named_tables(source, "share"):
        share = source.convert(table, _Share, dotted("share", name))
        if share is not INVALID:
            shares[name] = share
    network = source.convert(source.data.get("network", {}), _Network, "network")
    if network is INVALID:
        return None
    if "network" not in source.data:
        told = "the table [network] is missing: expected listen, connect, or both"
        source.mistakes.add("remote" if remotes else "share", told)
        return None
    robot = source.data.get("robot", {})
    me = network.name or (robot.get("name") if isinstance(robot, dict) else None)
    peers = Peers(str(me or "robot"), network, remotes, shares)
    for peer in peers.names:
        if source.is_name("peer", peer, "share"):
            about = "remote" if peer in remotes else "share"
            add_table(
                source, about, "sensor", peer, {"driver": f"{_DRIVERS}:Peer"}, peer
            )
    for peer, found in remotes.items():
        for kind, name, table in found:
            if kind != "behavior":
                whole = {"driver": f"{_DRIVERS}:Peer{kind.capitalize()}", **table}
                add_table(source, f"remote.{peer}.{kind}", kind, name, whole, peer)
    return peers


def _remotes(
    source: Source,
) -> Iterator[tuple[str, list[tuple[str, str, dict[str, Any]]]]]:
    for peer, table in named_tables(source, "remote"):
        found: list[tuple[str, str, dict[str, Any]]] = []
        for kind, parts in table.items():
            key = dotted("remote", peer, kind)
            if kind not in _KINDS:
                source.mistakes.add(key, unknown("table", kind, _KINDS))
                continue
            for name, part in parts.items() if isinstance(parts, dict) else ():
                if isinstance(part, dict):
                    found.append((kind, name, part))
                    continue
                source.wrong(dotted("remote", peer, kind, name), "a table", part)
            if not isinstance(parts, dict):
                source.wrong(key, "a table with a name for each", parts)
        yield peer, found


def add_table(
    source: Source, where: str, kind: str, name: str, table: dict[str, Any], peer: str
) -> None:
    """Write a table of a part on the bus to a peer, as if it were in the file."""
    holder = source.data.setdefault(kind, {})
    if name in holder:
        told = (
            f"there is a {kind} {name!r} already: take another name, and remote = ..."
        )
        source.mistakes.add(f"{where}.{name}", told)
        return
    source.mistakes.lines.put(dotted(kind, name), f"{where}.{name}")
    source.mistakes.lines.put(dotted(kind, name), where)
    holder[name] = {**table, "bus": peer}
    source.implied.add(name)


def add_buses(draft: Draft, peers: Peers | None) -> None:
    """Make the buses to the peers, before what is on them."""
    if peers is None or not peers.names:
        return
    from esair.buses.peer import Network, PeerBus, Tls

    mistakes, told = draft.source.mistakes, attrs.asdict(peers.network)
    del told["name"]
    told["tls"] = told["tls"] and Tls(**told["tls"])
    network: Any = None
    try:
        network = Network(me=peers.me, peers=peers.names, **told)
    except Exception as error:
        mistakes.caught("network", error, "the network")
    for peer in peers.names:
        made = None
        try:
            made = None if network is None else PeerBus(name=peer, network=network)
        except Exception as error:
            mistakes.caught("network", error, "the network")
        add_peer_bus(draft, peer, made)


def add_peer_bus(draft: Draft, peer: str, made: Any) -> None:
    """Add the bus to a peer; in a simulation it is there as the robot is."""
    draft.parts.append(Part("bus", peer, made))
    if draft.simulated:
        draft.source.data.setdefault("bus", {}).setdefault(peer, {"sim": {}})


def add_behaviors(draft: Draft, peers: Peers | None) -> None:
    """Make what stands for behaviors of peers, and what each peer may do here."""
    if peers is None:
        return
    from esair.peers import Share, Sharing, peer_behavior

    for peer, found in peers.remotes.items():
        for kind, name, table in found:
            if kind != "behavior":
                continue
            key = f"remote.{peer}.behavior.{name}"
            told = draft.source.convert(table, _RemoteBehavior, key)
            made = None
            if told is not INVALID and (bus := draft.buses.get(peer)) is not None:
                kinds = _requests(draft.source, key, told.requests)
                if kinds:
                    remote = told.remote or name
                    made = peer_behavior(name, bus, kinds, remote=remote)  # type: ignore[arg-type]
            draft.parts.append(Part("behavior", name, made))
    kinds_of = {
        part.name: part.kind
        for part in draft.parts
        if part.kind in _ACCESS and part.name not in peers.names
    }
    shared: dict[str, list[Share]] = {}
    for name, share in peers.shares.items():
        part_kind = kinds_of.get(name)
        if part_kind is None:
            told = unknown("sensor, actuator or behavior", name, kinds_of)
            draft.source.mistakes.add(f"share.{name}", told)
            continue
        access: Any = _ACCESS[part_kind]
        for peer in share.to:
            one = Share(name, access, priority=share.priority, rate=share.rate)
            shared.setdefault(peer, []).append(one)
    for peer in peers.names:
        way: Any = draft.buses.get(peer)
        if way is None:
            continue
        for part in draft.parts:
            if part.made is not None and part.kind != "bus":
                way.declare(type(inner_of(part.made)))
        if peer in shared:
            sharing = None
            try:
                sharing = Sharing(bus=way, shares=shared[peer])
            except Exception as error:
                key = f"share.{shared[peer][0].name}"
                draft.source.mistakes.caught(key, error, "the share")
            draft.parts.append(Part("behavior", peer, sharing))


def _requests(source: Source, key: str, names: tuple[str, ...]) -> list[Any]:
    found = []
    for name in names:
        where = f"{key}.requests"
        kind = find_class(name, where, source.mistakes, group="", folder=source.folder)
        if kind is not None and not is_request(kind):
            told = f"{name!r} is not derived from esair.Request"
            source.mistakes.add(where, told)
        elif kind is not None:
            found.append(kind)
    if not names:
        source.mistakes.add(f"{key}.requests", "expected at least one, 'module:Class'")
    return found


def open_to_all(peers: Peers | None) -> str:
    """Say so if everybody who reaches the network could drive this robot."""
    if peers is None or not peers.network.insecure or peers.network.tls is not None:
        return ""
    return "everybody who reaches this network can drive this robot: use [network.tls]"


# Two files of a pair.


def pair_mistakes(mine: Draft, other: Draft) -> Iterator[tuple[str, str]]:
    """Yield what one file wants of another one that this does not give: key, and why."""
    here: Peers | None = mine.peers
    there: Peers | None = other.peers
    if here is None or there is None or there.me not in here.remotes:
        return
    file = other.source.path.name
    if here.network.connect and not there.network.listen:
        yield "network.connect", f"{file} listens nowhere: expected listen = [...]"
    if (here.network.tls is None) != (there.network.tls is None):
        yield "network", f"{file} has {'no ' * (there.network.tls is None)}certificates"
    parts = {each.name: each for each in other.parts}
    for kind, name, table in here.remotes[there.me]:
        key, remote = f"remote.{there.me}.{kind}.{name}", table.get("remote", name)
        share, part = there.shares.get(remote), parts.get(remote)
        if share is None or here.me not in share.to:
            told = f"expected [share.{remote}] to = [{here.me!r}] there"
            yield key, f"{file} does not share {remote!r} with {here.me!r}: {told}"
        elif part is not None and part.kind != kind:
            yield key, f"{remote!r} is a {part.kind} in {file}"
        elif part is not None and part.made is not None:
            mine_made = {(each.kind, each.name): each for each in mine.parts}
            local = mine_made.get((kind, name))
            if local is not None and local.made is not None:
                yield from _misfits(key, local.made, part.made, file)


def _misfits(key: str, mine: Any, other: Any, file: str) -> Iterator[tuple[str, str]]:
    if isinstance(other, Behavior):
        takes = {type_name(each.type) for each in _takes(inner_of(other))}
        for each in _takes(mine):
            if takes and type_name(each.type) not in takes:
                told = f"{other.name!r} takes no {type_name(each.type)} in {file}"
                yield f"{key}.requests", told
        return
    wanted, given = mine.value_type, other.value_type
    if Any not in {wanted, given} and type_name(wanted) != type_name(given):
        flow = "gives" if isinstance(other, Sensor) else "takes"
        told = f"{other.name!r} {flow} {type_name(given)} in {file}, not "
        yield f"{key}.type", told + type_name(wanted)


def _takes(behavior: Any) -> list[Any]:
    found: Mapping[str, Any] = declared_requests(type(behavior))
    return [each for each in found.values() if not isinstance(each, str)]
