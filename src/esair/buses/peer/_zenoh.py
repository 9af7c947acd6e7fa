"""The network itself: the one module that knows zenoh, and imports it when it is opened.

Endpoints are explicit: nothing is scouted, and nobody passes on what others say. With
certificates the keys of each robot are open to its certificate alone; zenoh refuses the
rest where it comes in.
"""

from __future__ import annotations

import asyncio
import json
import logging
import os
import re
import threading
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import attrs

from esair.buses._opening import open_on, shut_on
from esair.buses.peer._wire import LIMIT, key_of
from esair.exceptions import ConfigError, DeviceLostError, EsairError, describe
from esair.loop import Door, spawn
from esair.values import check_name

if TYPE_CHECKING:
    from esair.buses.peer._bus import PeerBus, Send

_ENDPOINT: Final = re.compile(
    r"(tcp|tls)/(\[[0-9a-f:.]+\]|[\w.-]+):(\d{1,5})", re.ASCII
)
_HERE: Final = re.compile(r"127(\.\d+){3}|localhost|\[::1\]")

_WAITING: Final = 512
"""How many messages of a peer may wait for the loop; what comes then is dropped."""

_OPENING: Final = 1.5  # how long a session may take to open, in seconds

_THREADS: Final = "".join(
    f"{name}: (worker_threads: {count}), "
    for name, count in (("rx", 6), ("tx", 2), ("net", 2), ("acc", 2))
)
"""Threads of zenoh. It closes a socket with a wait for what is sent: after a cut, that holds
one of them up for seconds, and those that share it."""


_log = logging.getLogger("esair")


@attrs.frozen
class Tls:
    """Who may be heard: robots with certificates of one authority.

    The common name of a certificate is the name of its robot.

    Attributes:
        ca: The certificate of the authority, a file in PEM.
        certificate: That of this robot.
        key: Its private key.
    """

    ca: Path
    certificate: Path
    key: Path


def _retry(pause: int) -> dict[str, int]:
    return {"period_init_ms": pause, "period_max_ms": pause}


def _close(ways: list[Any]) -> None:
    """Close each at once: one that tries to connect waits until its try is over."""
    closing = [threading.Thread(target=way.close, daemon=True) for way in ways]
    for each in closing:
        each.start()
    for each in closing:
        each.join()


def _paths(endpoints: Any) -> tuple[str, ...]:
    return tuple(map(str, endpoints))


@attrs.define(eq=False, kw_only=True)
class Network:
    """How a robot reaches its peers; the buses to all of them share it.

    The side that connects has two ways, each a session of zenoh, and uses the one that is up:
    where packets are lost a single one takes as long as TCP takes to repeat them.

    Attributes:
        me: The name of this robot on the network.
        peers: The names of the robots that it speaks with.
        listen: Where they may connect: ``"tls/0.0.0.0:7447"``, ``"tcp/127.0.0.1:7447"``.
        connect: Where they are: ``"tls/192.168.1.5:7447"``.
        tls: The certificates; without them endpoints have to be on this machine.
        insecure: Endpoints elsewhere without certificates: everybody who gets there can
            read and say everything.
        connect_timeout: How long one try to connect may take, in seconds: it has to be five
            times the way there and back, and after a cut that is how long it takes.
    """

    me: str
    peers: tuple[str, ...] = attrs.field(default=(), converter=_paths)
    listen: tuple[str, ...] = attrs.field(default=(), converter=_paths)
    connect: tuple[str, ...] = attrs.field(default=(), converter=_paths)
    tls: Tls | None = None
    insecure: bool = False
    connect_timeout: float = attrs.field(default=0.2, converter=float)
    _users: set[str] = attrs.field(factory=set, init=False)
    _ways: list[Any] = attrs.field(factory=list, init=False)
    _opening: asyncio.Task[Any] | None = attrs.field(default=None, init=False)
    _heard: dict[str, list[Any]] = attrs.field(factory=dict, init=False)

    def __attrs_post_init__(self) -> None:
        for name in (self.me, *self.peers):
            check_name("robot", name)
        if not self.listen and not self.connect:
            told = "expected endpoints: listen = [...], connect = [...], or both"
            raise ConfigError("network", "", told)
        if not 0.05 <= self.connect_timeout <= 10.0:
            told = f"expected 0.05 to 10 s, not {self.connect_timeout!r}"
            raise ConfigError("network", "connect_timeout", told)
        for field in ("listen", "connect"):
            for endpoint in getattr(self, field):
                if (wrong := self._wrong(endpoint)) is not None:
                    raise ConfigError("network", field, f"{endpoint!r:.80}: {wrong}")
        for field in ("ca", "certificate", "key") if self.tls is not None else ():
            if not (file := Path(getattr(self.tls, field))).is_file():
                told = f"there is no file {str(file)!r}"
                raise ConfigError("network", f"tls.{field}", told)

    def _wrong(self, endpoint: str) -> str | None:
        found = _ENDPOINT.fullmatch(endpoint)
        if found is None or not 0 < int(found[3]) < 65536:
            return "expected 'tcp/HOST:PORT' or 'tls/HOST:PORT'"
        if found[1] == "tls" and self.tls is None:
            return "tls needs certificates: [network.tls]"
        if found[1] == "tcp" and self.tls is not None:
            return "with certificates every endpoint begins with tls/"
        if found[1] == "tcp" and not self.insecure and not _HERE.fullmatch(found[2]):
            return (
                "beyond this machine expected certificates ([network.tls] and tls/...), "
                "or insecure = true: then everybody there can drive this robot"
            )
        return None

    async def join(self, bus: PeerBus) -> Send:
        """Open the network, unless it is open, and hear what the peer of a bus says.

        Raises:
            ConfigError: zenoh is not installed.
            DeviceLostError: The network cannot be had: a port is in use.
        """
        loop = asyncio.get_running_loop()
        self._users.add(bus.name)
        if not self._ways and self._opening is None:
            if self.insecure and self.tls is None:
                told = "network: insecure: everybody who reaches it can drive %s"
                _log.warning(told, self.me)
            self._opening = spawn(loop, self._open(bus), name="open the network")
        if (opening := self._opening) is not None:
            await asyncio.wait({opening})
            opening.result()
        import zenoh  # it is there: the session is open

        ways, name = list(self._ways), bus.name
        beats, mine = key_of(name, self.me, "beat"), 0  # the way that is used
        publishers = [way.declare_publisher(beats) for way in ways]
        door, tag = Door.of(loop), ("peer", name)
        room = threading.BoundedSemaphore(_WAITING)

        def take(what: str, data: bytes) -> None:
            room.release()
            bus.came(what, data)

        def greet() -> None:
            room.release()
            bus.say("beat")

        def come(sample: Any) -> None:  # on a thread of zenoh
            payload = sample.payload
            if len(payload) > LIMIT or not room.acquire(blocking=False):
                bus.stats.dropped += 1
                return
            what = str(sample.key_expr).rpartition("/")[2]
            door.tell(tag, take, what, payload.to_bytes())

        def hear() -> Any:
            return ways[mine].declare_subscriber(key_of(self.me, name, "*"), come)

        def meets(way: int) -> bool:  # what is told of it comes later than it is so
            return bool(publishers[way].matching_status.matching)

        def send(what: str, data: bytes) -> None:
            nonlocal mine
            if what == "beat" and not meets(mine):
                mine, before = next(filter(meets, range(len(ways))), mine), mine
                if mine != before:
                    heard.pop().undeclare()
                    heard.append(hear())
            drop = zenoh.CongestionControl.DROP
            key = key_of(name, self.me, what)
            ways[mine].put(key, data, congestion_control=drop, express=True)

        def meet(status: Any) -> None:  # on a thread of zenoh
            if status.matching and room.acquire(blocking=False):
                door.tell(tag, greet)  # what is said now gets there

        for each in publishers:
            each.declare_matching_listener(meet)
        self._heard[name] = heard = [*publishers, hear()]
        return send

    async def leave(self, bus: PeerBus) -> None:
        """Hear no more of a peer; with the last one the network is closed."""
        self._users.discard(bus.name)
        declared = self._heard.pop(bus.name, ())
        if self._users:
            for each in declared:
                each.undeclare()
            return
        ways, self._ways = self._ways, []
        if ways:
            await shut_on(bus.executor, partial(_close, ways), timeout=0.5)
            await bus.executor.join(timeout=0.1)

    async def _open(self, bus: PeerBus) -> None:
        try:
            os.environ.setdefault("ZENOH_RUNTIME", f"({_THREADS})")  # it is read once
            import zenoh

            def made() -> list[Any]:
                # The second way tries beside the first one and not after it: a try whose
                # packet is lost holds nothing up.
                told, ways = self.settings(), list[Any]()
                second = told | {"listen/endpoints": [], "connect/retry": _retry(100)}
                try:
                    for each in (told, second) if self.connect else (told,):
                        config = zenoh.Config()
                        for key, value in each.items():
                            config.insert_json5(key, json.dumps(value))
                        ways.append(zenoh.open(config))
                except BaseException:
                    _close(ways)
                    raise
                return ways

            self._ways = await open_on(bus.executor, made, _close, timeout=_OPENING)
        except ImportError as error:
            told = "zenoh is not installed: pip install 'esair[net]'"
            raise ConfigError(bus.name, "network", told) from error
        except EsairError:
            raise
        except Exception as error:  # zenoh has one class of errors for everything
            raise DeviceLostError(bus.name, describe(error)) from error
        finally:
            self._opening = None

    def settings(self) -> dict[str, Any]:
        """Return what zenoh is told, by the names of its configuration."""
        told: dict[str, Any] = {
            "mode": "peer",
            "scouting/multicast/enabled": False,
            "scouting/gossip/enabled": False,
            "listen/endpoints": self.listen,
            "connect/endpoints": self.connect,
            "scouting/delay": 0,
            "connect/timeout_ms": -1,  # for ever, in the background
            "connect/exit_on_failure": False,
            "connect/retry": _retry(20),
            "transport/shared_memory/enabled": False,
            "transport/link/protocols": ["tcp" if self.tls is None else "tls"],
            # A way that a cut has broken is made anew: TCP alone would wait ever longer,
            # and for a connection that it begins in the cut a whole second.
            "transport/link/tx/lease": 300,
            "transport/unicast/open_timeout": round(1000 * self.connect_timeout),
        }
        if self.tls is None:
            return told
        mine = {"certificate": self.tls.certificate, "private_key": self.tls.key}
        told["transport/link/tls"] = {
            "root_ca_certificate": str(self.tls.ca),
            **{f"listen_{name}": str(file) for name, file in mine.items()},
            **{f"connect_{name}": str(file) for name, file in mine.items()},
            "enable_mtls": True,
            # Who it is says the certificate, not the address: see the rules.
            "verify_name_on_connect": False,
            "close_link_on_expiration": True,
        }
        rules = {peer: self._rules(peer) for peer in self.peers}
        names = {peer: [rule["id"] for rule in rules[peer]] for peer in rules}
        told["access_control"] = {
            "enabled": True,
            "default_permission": "deny",
            "rules": [rule for peer in rules for rule in rules[peer]],
            "subjects": [{"id": peer, "cert_common_names": [peer]} for peer in rules],
            "policies": [{"rules": names[peer], "subjects": [peer]} for peer in rules],
        }
        return told

    def _rules(self, peer: str) -> list[dict[str, Any]]:
        """Return which keys are open to the certificate of a peer; all others are shut."""
        said, heard = key_of(self.me, peer, "*"), key_of(peer, self.me, "*")
        return [
            {
                "id": f"{peer} {flow} {kind}",
                "permission": "allow",
                "flows": [flow],
                "messages": [kind],
                "key_exprs": [key],
            }
            for flow, kind, key in (
                ("ingress", "put", said),
                ("ingress", "declare_subscriber", heard),
                ("egress", "put", heard),
                ("egress", "declare_subscriber", said),
            )
        ]
