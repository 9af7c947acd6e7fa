"""The network itself: the one module that knows zenoh, and imports it when it is opened.

Endpoints are explicit: nothing is scouted, and nobody passes on what others say. With
certificates the keys of each robot are open to its certificate alone; zenoh refuses the
rest where it comes in.
"""

from __future__ import annotations

import asyncio
import collections
import contextlib
import json
import logging
import math
import os
import re
import ssl
import threading
import time
from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import attrs

from esair.buses._bus import open_on, shut_on
from esair.buses.peer._line import Line, close_all, pause
from esair.buses.peer._wire import LIMIT, key_of
from esair.exceptions import ConfigError, DeviceLostError, EsairError, describe
from esair.loop import Door, spawn
from esair.values import check_name

if TYPE_CHECKING:
    from esair.buses.peer._bus import PeerBus, Send

_ENDPOINT: Final = re.compile(
    r"(tcp|tls)/(\[[0-9a-f:.]+\]|[\w.-]+):(\d{1,5})", re.ASCII
)
_OF_TLS: Final = {
    "ca": "the certificate of the authority",
    "certificate": "the certificate of this robot",
    "key": "the private key of the certificate",
}
_PLACES: Final = re.compile(r" at \S+\.rs:\d+\.?")
_NO_TLS: Final = "tls needs certificates: [network.tls]"
_HERE: Final = re.compile(r"127(\.\d+){3}|localhost|\[::1\]")

_WAITING: Final = 512
"""How many messages of a peer may wait for the loop; what comes then is dropped."""

_BYTES: Final = 4 * LIMIT
"""How many bytes they may have."""

_SLICE: Final = 0.002
"""How long the loop takes messages of a peer at once, in seconds."""

_PAUSE: Final = 3.0
"""How much longer it goes on with all else then, if more of them wait."""

_OPENING: Final = 1.5  # how long a session may take to open, in seconds

_SILENT: Final = 0.2
"""So long after the last echo, and the way of it, new ways are looked for, in seconds."""

_THREADS: Final = "".join(
    f"{name}: (worker_threads: {count}), "
    for name, count in (("rx", 64), ("tx", 2), ("net", 8), ("acc", 4))
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


class _Session:
    """A session of zenoh: the one that listens, or a way to an endpoint."""

    def __init__(self, network: Network, line: Line | None, **endpoints: Any) -> None:
        import zenoh

        self.line = line
        self.heard = 0.0
        """When something has come by it."""
        config = zenoh.Config()
        for key, value in network.settings(**endpoints).items():
            config.insert_json5(key, json.dumps(value))
        self._session: Any = zenoh.open(config)
        self._drop = zenoh.CongestionControl.DROP
        self._error = zenoh.ZError
        self._key = key_of(network.me, "*", "*")
        self._come = partial(network.come, self)
        self._hearing: Any = None
        self.hear(True)

    def close(self) -> None:
        """End it; one that tries to connect ends when its try is over."""
        self._session.close()

    def say(self, key: str, data: bytes) -> None:
        """Say something; what cannot be sent now is dropped."""
        with contextlib.suppress(self._error):  # it was just closed
            self._session.put(key, data, congestion_control=self._drop, express=True)

    def hear(self, wanted: bool) -> None:
        """Hear what is said to this robot, or no more."""
        if not wanted and self._hearing is not None:
            self._hearing.undeclare()
            self._hearing = None
        elif wanted and self._hearing is None:
            self._hearing = self._session.declare_subscriber(self._key, self._come)


class _Peer:
    """How a peer is reached.

    Attributes:
        by: By which way it was heard first the last time.
        silent: Whether it is not heard.
    """

    def __init__(self, bus: PeerBus) -> None:
        self.bus = bus
        self._loop = asyncio.get_running_loop()
        self._door = Door.of(self._loop)
        self._tag = ("peer", bus.name)
        self._lock = threading.Lock()
        self._waiting: collections.deque[tuple[_Session, str, bytes]] = (
            collections.deque()
        )
        self._bytes = 0
        self._is_told = False  # the loop knows that some wait
        self.by: _Session | None = None
        self.silent = False

    def come(self, way: _Session, what: str, payload: Any) -> None:
        """Bring what has come by a way, on a thread of zenoh; too much is dropped."""
        size = len(payload)
        with self._lock:
            many = len(self._waiting) >= _WAITING or self._bytes + size > _BYTES
            if many or size > LIMIT:
                self.bus.stats.dropped += 1
                return
            self._bytes += size
            self._waiting.append((way, what, payload.to_bytes()))
            if self._is_told:
                return
            self._is_told = True
        self._tell()

    def _tell(self) -> None:
        self._door.tell(self._tag, self._take_some)

    def _take_some(self) -> None:
        """Take what waits, in the loop, and leave that most of its time.

        Whatever a peer sends, and however much: nobody else may wait for it.
        """
        began = time.monotonic()
        while (spent := time.monotonic() - began) < _SLICE:
            with self._lock:
                if not self._waiting:
                    self._is_told = False
                    return
                way, what, data = self._waiting.popleft()
                self._bytes -= len(data)
            try:
                self._take(way, what, data)
            except Exception:  # the next is taken all the same
                _log.exception("what came from peer %s raised", self.bus.name)
        self._loop.call_later(_PAUSE * spent, self._tell)

    def _take(self, way: _Session, what: str, data: bytes) -> None:
        way.heard, line = time.monotonic(), way.line
        is_new = self.bus.came(what, data)
        if line is None:
            self.by = way
            return
        line.peers.add(self.bus.name)
        if is_new and way in line.ways:
            self.by = line.best = way


def _decoded(certificate: Path) -> dict[str, Any]:
    decode: Any = getattr(ssl, "_ssl")._test_decode_cert  # noqa: B009, SLF001
    return decode(certificate)  # type: ignore[no-any-return]


def _paths(endpoints: str | Iterable[str]) -> tuple[str, ...]:
    return tuple(map(str, [endpoints] if isinstance(endpoints, str) else endpoints))


@attrs.define(eq=False, kw_only=True)
class Network:
    """How a robot reaches its peers; the buses to all of them share it.

    The side that connects has two ways to each endpoint, each a session of zenoh, and uses
    one of them. While a peer is silent more are opened, and until half a second after that
    everything is said on all of them: what comes first is taken.

    Attributes:
        me: The name of this robot on the network.
        peers: The names of the robots that it speaks with.
        listen: Where they may connect: ``"tls/0.0.0.0:7447"``, ``"tcp/127.0.0.1:7447"``.
        connect: Where they are: ``"tls/192.168.1.5:7447"``.
        tls: The certificates; without them endpoints have to be on this machine.
        insecure: Endpoints elsewhere without certificates: everybody who gets there can
            read and say everything.
        connect_timeout: How long a first packet and its answer may take, in seconds.
    """

    me: str
    peers: tuple[str, ...] = attrs.field(default=(), converter=_paths)
    listen: tuple[str, ...] = attrs.field(default=(), converter=_paths)
    connect: tuple[str, ...] = attrs.field(default=(), converter=_paths)
    tls: Tls | None = None
    insecure: bool = False
    connect_timeout: float = attrs.field(default=0.2, converter=float)
    _users: dict[str, _Peer] = attrs.field(factory=dict, init=False)
    _session: _Session | None = attrs.field(default=None, init=False)
    _lines: tuple[Line, ...] = attrs.field(default=(), init=False)
    _keeper: threading.Thread | None = attrs.field(default=None, init=False)
    _wake: threading.Event = attrs.field(factory=threading.Event, init=False)
    _opening: asyncio.Task[Any] | None = attrs.field(default=None, init=False)
    _days: tuple[float, float] = attrs.field(default=(-math.inf, math.inf), init=False)

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
                    # Who has named wrong ones does not hear that there are none.
                    about = "tls" if wrong is _NO_TLS else field
                    raise ConfigError("network", about, f"{endpoint!r:.80}: {wrong}")
        if self.tls is not None:
            self._check(self.tls)

    def _check(self, tls: Tls) -> None:
        """Read the certificates: with a wrong one the network is silent, and no more."""
        for field in _OF_TLS:
            if not (file := Path(getattr(tls, field))).is_file():
                told = f"there is no file {str(file)!r}"
                raise ConfigError("network", f"tls.{field}", told)
        context, field = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT), "ca"
        try:
            context.load_verify_locations(tls.ca)
            field = "certificate"
            subject = sum(_decoded(tls.certificate)["subject"], ())
            field = "key"
            context.load_cert_chain(tls.certificate, tls.key, password="")
        except OSError as error:
            told = f"expected {_OF_TLS[field]}, in PEM: {describe(error)}"
            raise ConfigError("network", f"tls.{field}", told) from None
        names = [name for key, name in subject if key == "commonName"]
        if self.me not in names:
            others = " and ".join(map(repr, names)) or "nobody"
            told = f"expected that of {self.me!r}, not of {others}"
            raise ConfigError("network", "tls.certificate", told)

    def _check_days(self, tls: Tls, owner: str) -> None:
        days, seconds = _decoded(tls.certificate), ssl.cert_time_to_seconds
        self._days = seconds(days["notBefore"]), seconds(days["notAfter"])
        if told := self.why():
            raise DeviceLostError(owner, told)

    def why(self) -> str:
        """Return why nobody is heard; a clock may be set right at any time."""
        (first, last), now = self._days, time.time()
        if first <= now <= last:
            return ""
        days = map(time.gmtime, (first, last, now))
        told = (time.strftime("%b %d %H:%M:%S %Y GMT", each) for each in days)
        of = "the certificate of this robot is of {} to {}; by this clock it is {}"
        return of.format(*told)

    def _wrong(self, endpoint: str) -> str | None:
        found = _ENDPOINT.fullmatch(endpoint)
        if found is None or not 0 < int(found[3]) < 65536:
            return "expected 'tcp/HOST:PORT' or 'tls/HOST:PORT'"
        if found[1] == "tls" and self.tls is None:
            return _NO_TLS
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
            ConfigError: zenoh is not installed; there is another bus to this peer.
            DeviceLostError: The network cannot be had: a port is in use.
        """
        loop, other = asyncio.get_running_loop(), self._users.get(bus.name)
        if other is not None and other.bus is not bus:
            told = "the robot has a bus to it already: give that to all its parts"
            raise ConfigError(bus.name, "network", told)
        self._users[bus.name] = peer = _Peer(bus)
        bus.why = self.why
        if self._session is None and self._opening is None:
            if self.insecure and self.tls is None:
                told = "network: insecure: everybody who reaches it can drive %s"
                _log.warning(told, self.me)
            self._opening = spawn(loop, self._open(bus), name="open the network")
        if (opening := self._opening) is not None:
            await asyncio.wait({opening})
            opening.result()

        def send(what: str, data: bytes) -> None:
            if what == "beat":
                trip = min(bus.round_trip, 1.0)
                is_silent = loop.time() - bus.heard_at > _SILENT + trip
                if is_silent is not peer.silent:
                    peer.silent = is_silent
                    self._look()
            key = key_of(bus.name, self.me, what)
            for way in self._ways(peer):
                way.say(key, data)

        return send

    def _ways(self, peer: _Peer) -> Iterable[Any]:
        """Return by which ways it is spoken to."""
        by = peer.by
        if by and not peer.silent and not (by.line and by.line.restless):
            return (by,)
        lines = (each for each in self._lines if each.leads_to(peer.bus.name))
        return (self._session, *(way for line in lines for way in line.ways))

    def _look(self) -> None:
        """Let each line know whether somebody there is silent."""
        silent = [name for name, each in self._users.items() if each.silent]
        for line in self._lines:
            line.silent = any(map(line.leads_to, silent))
        self._wake.set()

    def come(self, way: _Session, sample: Any) -> None:
        """Bring to the loop what has come, on a thread of zenoh."""
        rest, _, what = str(sample.key_expr).rpartition("/")
        peer = self._users.get(rest.rpartition("/")[2])
        # Zenoh ends each way of a certificate that is over, but not one of that second.
        if peer is not None and not self.why():
            peer.come(way, what, sample.payload)

    async def leave(self, bus: PeerBus) -> None:
        """Hear no more of a peer; with the last one the network is closed."""
        self._users.pop(bus.name, None)
        self._look()
        if self._users or (session := self._session) is None:
            return
        self._session = None
        lines, self._lines = self._lines, ()
        keeper = self._keeper

        def shut() -> None:
            if keeper is not None:
                keeper.join()
            ways = (way for line in lines for way in line.end())
            for thread in close_all((session, *ways)):
                thread.join()

        self._wake.set()
        await shut_on(bus.executor, shut, timeout=0.5)
        await bus.executor.join(timeout=0.1)

    def _keep(self) -> None:
        """Look after the lines, on a thread of its own, until there are none."""
        while True:
            self._wake.clear()  # before it is looked: what changes later wakes it
            if not (lines := self._lines):
                return
            goes_on = False
            for line in lines:
                try:
                    goes_on |= line.step(time.monotonic())
                except Exception:  # no more threads, or files
                    goes_on = True
                    _log.debug("network: no new ways", exc_info=True)
            if goes_on:
                pause(lines)
            else:
                self._wake.wait()

    def _line(self, endpoint: str) -> Line:
        found = _ENDPOINT.fullmatch(endpoint)
        assert found is not None
        return Line(
            *(found[2].strip("[]"), int(found[3]), self.connect_timeout),
            lambda line: _Session(self, line, connect=(endpoint,)),
        )

    async def _open(self, bus: PeerBus) -> None:
        def made() -> _Session:
            if self.tls is not None:
                self._check_days(self.tls, bus.name)
            return _Session(self, None, listen=self.listen)

        try:
            os.environ.setdefault("ZENOH_RUNTIME", f"({_THREADS})")  # it is read once
            self._session = await open_on(
                bus.executor, made, _Session.close, timeout=_OPENING
            )
            self._lines = tuple(map(self._line, self.connect))
            if self._lines:
                self._keeper = threading.Thread(
                    target=self._keep, name=f"{self.me}'s ways", daemon=True
                )
                self._keeper.start()
        except ImportError as error:
            told = "zenoh is not installed: pip install 'esair[net]'"
            raise ConfigError(bus.name, "network", told) from error
        except EsairError:
            raise
        except Exception as error:  # zenoh has one class of errors for everything
            told = _PLACES.sub("", describe(error))  # which are those of its author
            if "in use" in told:
                told += ": another program has the port, or another start of this robot"
            raise DeviceLostError(bus.name, told) from error
        finally:
            self._opening = None

    def settings(
        self, *, listen: Iterable[str] = (), connect: Iterable[str] = ()
    ) -> dict[str, Any]:
        """Return what zenoh is told for a session, by the names of its configuration."""
        told: dict[str, Any] = {
            "mode": "peer",
            "scouting/multicast/enabled": False,
            "scouting/gossip/enabled": False,
            "listen/endpoints": listen,
            "connect/endpoints": connect,
            "scouting/delay": 0,
            "connect/timeout_ms": -1,  # for ever, in the background
            "connect/exit_on_failure": False,
            # A way is tried again where its peer has ended it; else new ones are opened.
            "connect/retry": {"period_init_ms": 1000, "period_max_ms": 8000},
            "transport/shared_memory/enabled": False,
            "transport/link/protocols": ["tcp" if self.tls is None else "tls"],
            "transport/unicast/open_timeout": round(5000 * self.connect_timeout),
            "transport/link/rx/max_message_size": 2 * LIMIT,  # not the usual gigabyte
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
        mine, its = key_of(self.me, "*", "*"), key_of(peer, "*", "*")
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
                ("ingress", "declare_subscriber", its),
                ("egress", "put", heard),
                ("egress", "declare_subscriber", mine),
            )
        ]
