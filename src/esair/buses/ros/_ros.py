"""ROS 2 as one more peer: a process in ROS's own interpreter that speaks as peers do."""

from __future__ import annotations

import asyncio
import collections
import contextlib
import logging
import os
import re
import socket
import struct
import subprocess
from collections.abc import Awaitable, Callable, Iterable
from functools import partial
from pathlib import Path
from typing import Any, Final, Literal, Protocol

import attrs

from esair.buses._bus import open_on, shut_on
from esair.buses.peer import Head, PeerBus, head_of, packed, parts_of
from esair.buses.ros import _child
from esair.buses.ros._forms import Form
from esair.codec import CodecError
from esair.exceptions import BadValueError, DeviceLostError, describe
from esair.loop import Door, spawn
from esair.values import printable

_log = logging.getLogger("esair")

_BEHIND: Final = 1 << 13  # how many of its bytes are on the way: they are its past
_UNSENT: Final = 1 << 20  # how many bytes may wait for it, until what may be is dropped
_NEWER: Final = frozenset({"beat", "publish", "progress"})  # of these a newer one comes
_PACE, _BURST = 0.0005, 16  # a frame is taken so often, in seconds; so many at once
_SILENT: Final = 2.0  # a process that has spoken is stuck after so many seconds without
_STARTING: Final = 30.0  # how long it may take until it speaks, in seconds
_FIRST, _MOST = 0.2, 5.0  # how long it stays ended, in seconds: ever longer
_GRAVE: Final = re.compile(r"\b(INFO|WARN|ERROR|FATAL|Warning|Error)\]")  # DDS, too


@attrs.frozen
class Link:
    """A name in ROS's graph, and what it is here.

    Attributes:
        name: ``/scan``.
        type: ``sensor_msgs/msg/LaserScan``.
        kind: What it is in ROS.
        flow: ``"in"``: ROS publishes or asks; ``"out"``: this robot does.
        part: The sensor or behavior of this robot.
        form: What its messages, requests or goals are here.
        answer: What its responses or results are here.
        latched: Whether the newest message is kept for who comes later.
    """

    name: str
    type: str
    kind: Literal["topic", "service", "action"]
    flow: Literal["in", "out"]
    part: str
    form: Form = Form()  # noqa: RUF009 - it is frozen
    answer: Form = Form()  # noqa: RUF009
    latched: bool = False
    rate: float = 20.0

    @property
    def roots(self) -> list[str]:
        """The fields of a message that are looked at; none is named if all are."""
        told = self.form.rows or self.form.fields
        paths = [told] if isinstance(told, str) else told.values()
        return sorted({re.split("[.:]", path)[0] for path in paths} - {""})


class Far(Protocol):
    """The other side, while it lives: a process, or a `FakeRos`."""

    def send(self, frame: list[Any]) -> bool:
        """Hand over a frame, without a wait; tells whether there was room."""

    async def take(self) -> list[Any] | None:
        """Return the next frame; None when it has ended."""

    async def end(self) -> str:
        """End it; return how it did, in words."""


def _as_list(links: Iterable[Link]) -> list[Link]:
    return list(links)


Begin = Callable[[PeerBus, dict[str, Any]], Awaitable[Far]]


@attrs.define(eq=False)
class Ros:
    """How a robot is a citizen of ROS 2: its bus is ``PeerBus(name="ros", network=Ros(...))``.

    Attributes:
        links: What it has there.
        me: The name of this robot.
        node: The name of its node; that of the robot unless given.
        namespace: That of the node.
        domain: ROS_DOMAIN_ID; as in the environment unless given.
        begin: What starts the other side: a `Process`, or a `FakeRos`.
    """

    links: list[Link] = attrs.field(converter=_as_list)
    me: str = "robot"
    begin: Begin = attrs.field(kw_only=True)
    node: str | None = attrs.field(default=None, kw_only=True)
    namespace: str = attrs.field(default="", kw_only=True)
    domain: int | None = attrs.field(default=None, kw_only=True)
    _far: Far | None = attrs.field(default=None, init=False)
    _life: asyncio.Task[None] | None = attrs.field(default=None, init=False)
    _named: dict[str, Link] = attrs.field(factory=dict, init=False)
    _asked: dict[int, Link] = attrs.field(factory=dict, init=False)
    _served: dict[int, Link] = attrs.field(factory=dict, init=False)
    _complained: set[str] = attrs.field(factory=set, init=False)

    async def join(self, bus: PeerBus) -> Callable[[str, bytes], None]:
        """Keep the other side alive, and hand to the bus what it says."""
        self._named = {each.name: each for each in self.links}
        for link in self.links:
            bus.declare(link.form.kind)
            bus.declare(link.answer.kind)
        bus.why = partial(str, "its process is starting")
        self._life = spawn(asyncio.get_running_loop(), self._live(bus), name="ros")

        def send(what: str, data: bytes) -> None:
            if self._far is None:
                return
            try:
                for frame in self._told(what, data, bus):
                    bus.stats.dropped += not self._far.send(frame)
            except (CodecError, ValueError, TypeError) as error:  # it is no JSON either
                self._complain(bus, f"{what}: {describe(error)}")
                if what == "ask":
                    raise BadValueError(bus.name, what, str(error)) from None

        return send

    async def leave(self, bus: PeerBus) -> None:
        """End the other side."""
        life, self._life = self._life, None
        if life is not None:
            life.cancel()
            await asyncio.wait({life})
            await bus.executor.join(timeout=0.1)

    @property
    def setup(self) -> dict[str, Any]:
        """What the other side is told first."""
        told = "name", "type", "kind", "flow", "latched", "roots"
        links = [{name: getattr(each, name) for name in told} for each in self.links]
        feeds = {
            each.part: each.rate
            for each in self.links
            if (each.kind, each.flow) == ("topic", "out")
        }
        node = {"node": self.node or self.me, "namespace": self.namespace}
        return {**node, "domain": self.domain, "links": links, "feeds": feeds}

    async def _live(self, bus: PeerBus) -> None:
        """Begin it, hear it to its end, and begin it again."""
        loop = asyncio.get_running_loop()
        pause = _FIRST
        while True:
            begun = loop.time()
            try:
                why = await self._hear(bus)
            except Exception as error:
                why = describe(error)
            if loop.time() - begun > 2.0 * _MOST:
                pause = _FIRST
            told = f"the process of {bus.name} has ended: {why}"
            bus.stats.errors += 1
            bus.stats.last_error, bus.why = told, partial(str, told)
            _log.warning("%s; it is begun again in %.3g s", told, pause)
            await asyncio.sleep(pause)
            pause = min(2.0 * pause, _MOST)

    async def _hear(self, bus: PeerBus) -> str:
        loop = asyncio.get_running_loop()
        door = Door.of(loop)
        self._far = far = await self.begin(bus, self.setup)
        head, patience, due = None, _STARTING, 0.0
        try:
            while True:
                try:
                    async with asyncio.timeout(patience):
                        frame = await far.take()
                except TimeoutError:
                    return f"it said nothing for {patience:g} s; {await far.end()}"
                if frame is None:
                    return await far.end()
                patience = _SILENT
                due = max(due, loop.time() - _BURST * _PACE) + _PACE
                if due > loop.time():  # the robot has other work: ROS waits, or drops
                    await asyncio.sleep(_BURST * _PACE)
                try:
                    said = self._said(frame, bus)
                except Exception as error:  # whatever came
                    bus.stats.bad_frames += 1
                    self._complain(bus, f"from ROS: {describe(error)}")
                    continue
                if said is not None:
                    head, bus.why = frame[1:6], str
                    door.end(("peer", bus.name), bus.came, *said)
        finally:
            self._far = None
            self._asked.clear()
            self._served.clear()
            if head is not None:
                gone = packed(Head(*head), (), bus.kinds)
                door.end(("peer", bus.name), bus.came, "bye", gone)
            await far.end()

    def _complain(self, bus: PeerBus, told: str) -> None:
        if told not in self._complained and len(self._complained) < 256:
            self._complained.add(told)
            _log.warning("%s: %s", bus.name, told)

    def _said(self, frame: list[Any], bus: PeerBus) -> tuple[str, bytes] | None:
        """Return what the other side has said as a message of a peer."""
        what, head, parts = frame[0], Head(*frame[1:6]), frame[6:]
        if what == "warn":
            name, ours, other, who = parts
            by = f" by {who}" if who else ""
            told = f"{name} is {ours} here, and {other}{by} in ROS: they do not meet"
            self._complain(bus, told)
            return None
        if what == "dropped":
            bus.stats.dropped += parts[0]
            return None
        if what == "bad":
            raise ValueError(parts[0])
        if what == "reading":
            parts[2] = self._named[parts[0]].form.value(parts[2])
        elif what == "ask":
            link = self._served[parts[0]] = self._named[parts[1]]
            parts[1:] = link.part, link.form.value(parts[2])
        elif what == "cancel":
            self._served.pop(parts[0], None)
        elif what == "answer":
            asked = self._asked.pop(parts[0], None)
            if parts[1] == "answered" and asked is not None:
                parts[2] = _answered(asked.answer, parts[2])
        return what, packed(head, tuple(parts), bus.kinds)

    def _told(self, what: str, data: bytes, bus: PeerBus) -> Iterable[list[Any]]:
        """Yield what a message for the peer is on the other side."""
        found = head_of(data)
        assert found is not None
        head, parts = found[0], list(parts_of(what, found[1], bus.kinds))
        if what == "reading":
            for link in self.links:
                if (link.part, link.kind, link.flow) == (parts[0], "topic", "out"):
                    message = link.form.message(parts[2])
                    yield ["publish", *head, link.name, parts[1], message]
            return
        if what == "ask":
            link = self._named[parts[1]]
            parts[2] = link.form.message(parts[2])
            self._asked[parts[0]] = link
        elif what == "cancel":
            self._asked.pop(parts[0], None)
        elif what == "answer":
            served = self._served.pop(parts[0], None)
            if served is not None and parts[1] == "answered":
                parts[2] = served.answer.message(parts[2])
        elif what == "progress" and attrs.has(type(parts[1])):
            parts[1] = attrs.asdict(parts[1])
        yield [what, *head, *parts]


def _answered(form: Form, response: Any) -> Any:
    """Return an answer; of one that is no class its only field, or the outcome."""
    if form.kind is None or not isinstance(response, dict) or form.fields != "":
        return form.value(response)
    if form.kind is type(None) or not response:
        return None
    return response.get("success", next(iter(response.values())))


@attrs.frozen
class Process:
    """The other side: a process of ROS's own interpreter.

    Attributes:
        python: The interpreter that has rclpy.
        setup: A script that is sourced before, such as ``/opt/ros/jazzy/setup.bash``.
    """

    python: str = "/usr/bin/python3"
    setup: str | None = None

    async def __call__(self, bus: PeerBus, setup: dict[str, Any]) -> Living:
        """Start it."""
        (popen, said, words) = await open_on(
            bus.executor, self.start, _kill, timeout=_STARTING
        )
        reader, writer = await asyncio.open_connection(sock=said, limit=_BEHIND)
        heard, other = await asyncio.open_connection(sock=words)
        living = Living(bus, popen, reader, writer, other)
        living.hear(heard)
        writer.write(_child.pack(setup))
        return living

    def start(self) -> tuple[subprocess.Popen[bytes], socket.socket, socket.socket]:
        """Start it; its end of the sockets is its standard input, and all it prints."""
        command = [self.python, "-u", str(Path(_child.__file__))]
        if self.setup is not None:
            command = ["bash", "-c", '. "$0" && exec "$@"', self.setup, *command]
        (mine, its), (words, printed) = socket.socketpair(), socket.socketpair()
        its.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _BEHIND)
        with its, printed:
            try:
                popen = subprocess.Popen(
                    command,
                    stdin=its.fileno(),
                    stdout=printed.fileno(),
                    stderr=printed.fileno(),
                    start_new_session=True,
                    env={k: v for k, v in os.environ.items() if k != "PYTHONHOME"},
                )
            except BaseException:
                mine.close()
                words.close()
                raise
        return popen, mine, words


def _kill(
    started: tuple[subprocess.Popen[bytes], socket.socket, socket.socket],
) -> None:
    popen, *sockets = started
    popen.kill()
    popen.wait()
    for each in sockets:
        each.close()


@attrs.define(eq=False)
class Living:
    """The process while it lives."""

    bus: PeerBus
    popen: subprocess.Popen[bytes]
    reader: asyncio.StreamReader
    writer: asyncio.StreamWriter
    printed: asyncio.StreamWriter
    _words: collections.deque[str] = attrs.field(
        factory=lambda: collections.deque(maxlen=3)
    )
    _hearing: asyncio.Task[None] | None = None
    _how: str = ""
    _has_ended: bool = False

    def hear(self, words: asyncio.StreamReader) -> None:
        """Log what it prints, as grave as it says that is, and keep its last words."""
        levels = logging.getLevelNamesMapping()

        async def log() -> None:
            while True:
                try:
                    line = await words.readline()
                except ValueError:  # longer than a stream keeps: it is left out
                    continue
                if not line:
                    return
                self._words.append(printable(line.decode("utf-8", "replace").strip()))
                grave = _GRAVE.search(self._words[-1])
                level = grave[1].upper() if grave else "INFO"
                _log.log(levels[level], "%s: %s", self.bus.name, self._words[-1])

        self._hearing = spawn(asyncio.get_running_loop(), log(), name="what ros prints")

    def send(self, frame: list[Any]) -> bool:
        """Hand over a frame, without a wait; tells whether there was room.

        There is for asks and answers: they come once, and no more than may be under way.
        """
        waits = self.writer.transport.get_write_buffer_size()
        if waits > _UNSENT and frame[0] in _NEWER:
            return False
        self.writer.write(_child.pack(frame))
        return True

    async def take(self) -> list[Any] | None:
        """Return the next frame; None when it has ended."""
        try:
            (size,) = struct.unpack(">I", await self.reader.readexactly(4))
            if size > _child.LARGEST:
                raise ValueError(f"it sent {size} bytes at once")
            frame = _child.unpack(await self.reader.readexactly(size))
        except (asyncio.IncompleteReadError, ConnectionError):
            self._has_ended = True
            return None
        if not isinstance(frame, list) or len(frame) < 6:
            raise ValueError("it sent what is no frame")
        return frame

    async def end(self) -> str:
        """End it; return how it did, in words."""
        if self._how:
            return self._how
        self._how = "it was ended"
        popen, patience = self.popen, 0.3 if self._has_ended else 0.0

        def wait() -> None:
            try:
                popen.wait(patience)  # it has closed its socket: it ends by itself
            except subprocess.TimeoutExpired:
                popen.kill()
                popen.wait()

        await shut_on(self.bus.executor, wait, timeout=1.0)
        if self._hearing is not None:
            await asyncio.wait({self._hearing}, timeout=0.2)
            self._hearing.cancel()
        for each in (self.writer, self.printed):
            each.close()
        code = popen.returncode or 0
        words = "; ".join(self._words) or "it said nothing"
        self._how = f"{'signal' if code < 0 else 'exit code'} {abs(code)}; {words}"
        return self._how


def look_at(
    process: Process, *, seconds: float = 3.0, domain: int | None = None
) -> dict[str, Any]:
    """Return what is in ROS's graph; blocks for as long as it is looked.

    Raises:
        DeviceLostError: ROS cannot be had: the last words of its process.
    """
    started = process.start()
    _, said, words = started
    setup = {"node": "esair_find", "namespace": "", "domain": domain, "find": seconds}
    try:
        # A process that has ended may leave what it was told unread.
        with contextlib.suppress(ConnectionError), said.makefile("rwb") as stream:
            stream.write(_child.pack(setup))
            stream.flush()
            size = stream.read(4)
            if len(size) == 4:
                frame = _child.unpack(stream.read(struct.unpack(">I", size)[0]))
                return dict(frame[1])
        told = words.makefile("r", errors="replace").read().strip().rpartition("\n")[2]
        raise DeviceLostError("ros", printable(told) or "its process has ended")
    finally:
        _kill(started)
