"""Peers of a file: ``[network]``, ``[remote.PEER.*]``, ``[share.NAME]``.

Remote sensors and actuators stand for tables of their kinds, on a bus that has the name of
the peer; so does a sensor that tells how the peer is heard. What is shared is one behavior
for each peer, with the peer's name. ROS is one more peer: ``_ros.py``.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Final

import attrs

from esair.actions import Behavior, declared_requests, is_request
from esair.config._classes import find_class
from esair.config._components import construct, named_tables, variant_of
from esair.config._draft import Draft, Part, Variant
from esair.config._mistakes import below, dotted, unknown
from esair.config._source import Source
from esair.config._values import INVALID
from esair.plan import inner_of
from esair.resources import APPLIED, Sensor
from esair.values import is_positive, type_name

TABLES: Final = frozenset({"network", "remote", "share"})

_DRIVERS: Final = "esair.drivers.peer"
_ACCESS: Final = {"sensor": "read", "actuator": "write", "behavior": "ask"}
_JOINS: Final = (
    "the simulation would join the real {}, and move what is real: expected "
    "sim = {{ ... }} with what replaces its keys (sim = {{}} to join it as it is)"
)


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


@attrs.frozen
class Peers:
    """What a file says of peers, as far as it is sound.

    Attributes:
        me: The name of this robot on the network.
        network: How the network is reached; None if that cannot be made.
        remotes: What is used of each peer: its kind, its local name, its table.
        shares: What is shared, by its name.
        names: The names of the peers.
    """

    me: str
    network: Any
    remotes: dict[str, list[tuple[str, str, dict[str, Any]]]]
    shares: dict[str, _Share]
    names: tuple[str, ...]


def read_peers(draft: Draft) -> Peers | None:
    """Return what a file says of peers, and write the tables that it stands for."""
    source = draft.source
    if TABLES.isdisjoint(source.data):
        return None
    remotes = dict(_remotes(source))
    told = {
        name: source.convert(table, _Share, dotted("share", name))
        for name, table in named_tables(source, "share", APPLIED)
    }
    shares = {name: each for name, each in told.items() if each is not INVALID}
    if "network" not in source.data:
        missing = "the table [network] is missing: expected listen, connect, or both"
        source.mistakes.add("remote" if remotes else "share", missing)
        return None
    from esair.buses.peer import Network

    variant = joined(draft, "network")
    name = variant.table.pop("name", draft.robot["name"])
    me = source.convert(name, str, variant.keys.get("name", "network.name"))
    shared = {each: f"{dotted('share', n)}.to" for n in shares for each in shares[n].to}
    names = tuple(dict.fromkeys([*remotes, *shared]))
    given = {"me": me, "peers": names}
    network = construct(source, Network, str(me), "network", variant, given=given)
    for peer in names:
        key = dotted("remote", peer) if peer in remotes else shared[peer]
        if source.is_name("peer", peer, key):
            add_table(source, key, "sensor", peer, "Peer", {}, peer)
    for peer, found in remotes.items():
        for kind, name, table in found:
            if kind != "behavior":
                key, driver = dotted("remote", peer, kind, name), kind.capitalize()
                add_table(source, key, kind, name, f"Peer{driver}", table, peer)
    return Peers(str(me), network, remotes, shares, names)


def joined(draft: Draft, key: str) -> Variant:
    """Return the table of a network, which a simulation joins only if told so."""
    variant = variant_of(draft, key, draft.source.data[key], "driver")
    if draft.simulated and not variant.is_simulated:
        draft.source.mistakes.add(key, _JOINS.format(key))
    return variant


def _remotes(
    source: Source,
) -> Iterator[tuple[str, list[tuple[str, str, dict[str, Any]]]]]:
    for peer, table in named_tables(source, "remote"):
        found: list[tuple[str, str, dict[str, Any]]] = []
        for kind, parts in table.items():
            key = dotted("remote", peer, kind)
            if kind not in _ACCESS:
                source.mistakes.add(key, unknown("table", kind, _ACCESS))
            elif not isinstance(parts, dict):
                source.wrong(key, "a table with a name for each", parts)
            else:
                for name, part in parts.items():
                    if isinstance(part, dict):
                        found.append((kind, name, part))
                    else:
                        source.wrong(below(key, name), "a table", part)
        yield peer, found


def add_table(
    source: Source,
    key: str,
    kind: str,
    name: str,
    driver: str,
    table: dict[str, Any],
    peer: str,
) -> None:
    """Write a table of a part on the bus to a peer, as if it were in the file."""
    holder = source.data.setdefault(kind, {})
    if name in holder:
        told = (
            f"there is a {kind} {name!r} already: take another name, and remote = ..."
        )
        source.mistakes.add(key, told)
        return
    source.mistakes.lines.put(dotted(kind, name), key)
    holder[name] = {"driver": f"{_DRIVERS}:{driver}", **table, "bus": peer}
    source.implied.add(name)


def add_buses(draft: Draft, key: str, names: Iterable[str], network: Any) -> None:
    """Make the buses to peers, before what is on them; None if they cannot be reached.

    In a simulation they are there as the robot is.
    """
    from esair.buses.peer import PeerBus

    for peer in names:
        about = draft.source, PeerBus, peer, key, Variant({}, {})
        reached = network is not None
        made = construct(*about, given={"network": network}, make=reached)
        draft.parts.append(Part("bus", peer, made))
        if draft.simulated:
            draft.source.data.setdefault("bus", {}).setdefault(peer, {"sim": {}})


def add_behaviors(draft: Draft, peers: Peers) -> None:
    """Make what stands for behaviors of peers, and what each peer may do here."""
    for peer, found in peers.remotes.items():
        for kind, name, table in found:
            key = dotted("remote", peer, kind, name)
            if kind != "behavior":
                continue
            requests, told = [], draft.source.convert(table, _RemoteBehavior, key)
            if told is not INVALID:
                requests = requests_of(draft, f"{key}.requests", told.requests)
            add_remote(draft, key, name, peer, requests, table.get("remote", name))
    shared: dict[str, list[Any]] = {peer: [] for peer in peers.names}
    for name, share in peers.shares.items():
        key, limits = dotted("share", name), (share.priority, share.rate)
        part = part_of(draft, key, name, *_ACCESS)
        for field, kind in (("priority", "actuator"), ("rate", "sensor")):
            if part and part.kind != kind and field in draft.source.data["share"][name]:
                told = f"it is for {kind}s, and {name!r} is of the kind {part.kind}"
                draft.source.mistakes.add(f"{key}.{field}", told)
        one = share_of(draft, key, part, *limits)
        for peer in share.to:
            shared[peer].append(one)
    for peer, shares in shared.items():
        way: Any = draft.buses[peer]
        for part in draft.parts if way is not None else ():
            if part.made is not None and part.kind != "bus":
                way.declare(type(inner_of(part.made)))
        add_sharing(draft, "share", peer, shares)


def part_of(draft: Draft, key: str, name: str, *kinds: str) -> Part | None:
    """Return the part that a file names; it is a mistake that there is none.

    What an actuator has applied is a sensor of its own.
    """
    applied = (
        attrs.evolve(each, kind="sensor", name=each.name + APPLIED)
        for each in draft.parts
        if each.kind == "actuator"
    )
    known = {
        each.name: each
        for each in (*draft.parts, *applied)
        if each.kind in kinds and each.bus != each.name  # a peer is not shared
    }
    if name not in known:
        draft.source.mistakes.add(key, unknown(" or ".join(kinds), name, known))
    return known.get(name)


def requests_of(draft: Draft, key: str, names: Iterable[str]) -> list[Any]:
    """Return the requests that a file names."""
    source, found = draft.source, []
    for name in names:
        kind = find_class(name, key, source.mistakes, group="", folder=source.folder)
        if kind is not None and not is_request(kind):
            told = f"{name!r} is not derived from esair.Request"
            source.mistakes.add(key, told)
        elif kind is not None:
            found.append(kind)
    if not names:
        source.mistakes.add(key, "expected at least one, 'module:Class'")
    return found


def share_of(
    draft: Draft, key: str, part: Part | None, priority: int = 0, rate: float = 20.0
) -> Any:
    """Return what a peer may do with a part; None if that is a mistake."""
    from esair.peers import Share

    if part is None:
        return None
    about = draft.source, Share, part.name, key, Variant({}, {})
    given = {"access": _ACCESS[part.kind], "priority": priority, "rate": rate}
    return construct(*about, given=given)


def add_sharing(draft: Draft, key: str, peer: str, shares: Iterable[Any]) -> None:
    """Add what a peer may do here, if it may do something."""
    from esair.peers import Sharing

    way: Any = draft.buses[peer]
    found = [each for each in shares if each is not None]
    if found and way is not None:
        add_behavior(draft, key, peer, Sharing(bus=way, shares=found))


def add_remote(
    draft: Draft, key: str, name: str, peer: str, requests: list[Any], remote: str
) -> None:
    """Add what stands for a behavior of a peer."""
    from esair.peers import peer_behavior

    way: Any = draft.buses[peer]
    is_sound = requests and way is not None
    made = peer_behavior(name, way, requests, remote=remote) if is_sound else None
    add_behavior(draft, key, name, made)


def add_behavior(draft: Draft, key: str, name: str, made: Any) -> None:
    """Add a behavior that a table stands for."""
    if name in {each.name for each in draft.parts if each.kind == "behavior"}:
        draft.source.mistakes.add(key, f"there is a behavior {name!r} already")
        return
    draft.source.mistakes.lines.put(dotted("behavior", name), key)
    draft.parts.append(Part("behavior", name, made))


def open_to_all(peers: Peers | None) -> str:
    """Say so if everybody who reaches the network could drive this robot."""
    network = None if peers is None else peers.network
    if network is None or not network.insecure or network.tls is not None:
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
    if None not in (here.network, there.network):
        if here.network.connect and not there.network.listen:
            yield "network.connect", f"{file} listens nowhere: expected listen = [...]"
        if (has := there.network.tls is not None) != (here.network.tls is not None):
            yield "network", f"{file} has {'' if has else 'no '}certificates"
    parts = {each.name: each for each in other.parts}
    made = {(each.kind, each.name): each.made for each in mine.parts}
    for kind, name, table in here.remotes[there.me]:
        key, remote = f"remote.{there.me}.{kind}.{name}", table.get("remote", name)
        share, part = there.shares.get(remote), parts.get(remote)
        if share is None or here.me not in share.to:
            told = f"expected [share.{remote}] to = [{here.me!r}] there"
            yield key, f"{file} does not share {remote!r} with {here.me!r}: {told}"
        elif part is not None and part.kind != kind:
            yield key, f"{remote!r} is a {part.kind} in {file}"
        elif part is not None and None not in (part.made, made.get((kind, name))):
            yield from _misfits(key, made[kind, name], part.made, file)


def pair_warnings(mine: Draft, other: Draft) -> Iterator[tuple[str, str]]:
    """Yield what may be meant otherwise in one file than in another: key, and why."""
    here, there = mine.peers, other.peers
    if None in (here, there) or there.me not in here.names:
        return
    file = other.source.path.name
    yield from _unmet(here.network, there.network, file)
    parts = {each.name: each.made for each in other.parts}
    made = {(each.kind, each.name): each.made for each in mine.parts}
    for kind, name, table in here.remotes.get(there.me, ()):
        remote = table.get("remote", name)
        about = made.get((kind, name)), parts.get(remote), there.shares.get(remote)
        if None not in about and _ACCESS[kind] != "ask":
            key = f"remote.{there.me}.{kind}.{name}"
            late = _late_there if kind == "actuator" else _late_here
            yield from late(key, *about, file, table, mine)


def strangers(mine: Draft, others: Iterable[Draft]) -> Iterator[tuple[str, str]]:
    """Yield the peers of a file whom none of the others is, if one of these is no peer."""
    here: Peers | None = mine.peers
    if here is None:
        return
    files = {each.peers.me: each.source.path.name for each in others if each.peers}
    if left := [name for name in files if name not in here.names]:
        told = " and ".join(f"{files[name]} is {name!r}" for name in left)
        for peer in (each for each in here.names if each not in files):
            shared = (name for name, each in here.shares.items() if peer in each.to)
            key = f"remote.{peer}" if peer in here.remotes else f"share.{next(shared)}"
            yield key, f"none of the files is of {peer!r}: {told}"


def _unmet(here: Any, there: Any, file: str) -> Iterator[tuple[str, str]]:
    """Say so if one connects to no port where the other one listens."""
    if None in (here, there):
        return
    one, two, three, four = (
        {end.rpartition(":")[2] for end in ends}
        for ends in (here.connect, there.listen, there.connect, here.listen)
    )
    if one and two and not one & two and not three & four:
        ports = " and ".join(sorted(two))
        told = f"{file} listens at port {ports}, unless that is forwarded"
        yield "network.connect", told


def _every(mine: Any, other: Any, share: _Share) -> float:
    """Return after how many seconds the next reading comes, as far as that is known."""
    limit: float = min(mine.link_rate, share.rate)
    is_asked = other.can_be_asked and not other.pushes
    own: float = 1.0 / other.rate if is_asked else other.period or 0.0
    return max(own, 1.0 / limit) * (1.0 + 1e-9)


def _late_here(
    key: str, mine: Any, other: Any, share: _Share, file: str, table: Any, draft: Draft
) -> Iterator[tuple[str, str]]:
    if "link_rate" in table and mine.link_rate > share.rate:
        told = f"{file} sends {other.name!r} at {share.rate:g} Hz at most"
        yield f"{key}.link_rate", f"{told}: raise the rate of its share"
    every = _every(mine, other, share)
    if mine.period is not None and mine.period <= every:
        told = f"readings come from {file} every {every:.3g} s only"
        yield f"{key}.period", f"{told}: it is stale in between"
    for part in draft.parts:
        needs = getattr(inner_of(part.made), "needs", {}) if part.made else {}
        for attribute, need in needs.items():
            age = getattr(need, "max_age", None)
            if need.resource == mine.name and age is not None and age <= every:
                told = f"{attribute}: its readings may be {age:.3g} s old at most, but "
                told += f"come from {file} every {every:.3g} s only"
                yield part.key, told


def _late_there(
    key: str, mine: Any, other: Any, _: _Share, file: str, *_rest: Any
) -> Iterator[tuple[str, str]]:
    longest = other.command_timeout
    if is_positive(longest) and mine.command_timeout > longest:
        told = f"a command is good for {longest:g} s only in {file}"
        yield f"{key}.command_timeout", f"{told}, not for {mine.command_timeout:g} s"


def _misfits(key: str, mine: Any, other: Any, file: str) -> Iterator[tuple[str, str]]:
    if isinstance(other, Behavior):
        declared = declared_requests(type(inner_of(other))).values()
        takes = {_full_name(each.type) for each in _takes(inner_of(other))}
        for each in _takes(mine) if len(takes) == len(declared) else ():
            if (name := _full_name(each.type)) not in takes:
                yield f"{key}.requests", f"{other.name!r} takes no {name} in {file}"
        return
    wanted, given = mine.value_type, other.value_type
    if Any not in {wanted, given} and _full_name(wanted) != _full_name(given):
        flow = "gives" if isinstance(other, Sensor) else "takes"
        told = f"{other.name!r} {flow} {_full_name(given)} in {file}, not "
        yield f"{key}.type", told + _full_name(wanted)


def _full_name(kind: Any) -> str:
    """Return the name under which a class crosses: the same at both, or nothing does."""
    if not isinstance(kind, type) or kind.__module__ == "builtins":
        return type_name(kind)
    return f"{kind.__module__}:{kind.__qualname__}"


def _takes(behavior: Any) -> list[Any]:
    found: Mapping[str, Any] = declared_requests(type(behavior))
    return [each for each in found.values() if not isinstance(each, str)]
