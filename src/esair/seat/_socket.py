"""The control socket of one robot: who may come in, and how much each may cost."""

from __future__ import annotations

import asyncio
import collections
import json
import logging
import os
import socket
import struct
from typing import Any

from esair.exceptions import BadValueError, BusyError
from esair.journal import Event, Kind, Listener
from esair.recording import plain
from esair.seat._leases import BEAT, Lease
from esair.seat._operator import Console, Session
from esair.seat._place import Place
from esair.seat._wire import (
    LIMIT,
    VERSION,
    Message,
    decode,
    encode,
    failure,
    id_of,
    message_of,
    outcome,
)

CLIENTS = 16
"""How many clients may be there at a time."""

STOP_LANES = 4
"""How many more may come in who can only stop the robot."""

WAITING = 256 * 1024
"""How many bytes may wait for a client that does not read; one more and it goes."""

HALF_LINE = 5.0
"""How long a client may take for one line, in seconds."""

STOP_LANE = 5.0
"""How long a client may stay that can only stop the robot, in seconds."""

LINGER = 0.5
"""How long a client that is turned away may take to hear why, in seconds."""

LINES = 2000
"""How many lines a client may send in a second; the rest waits in its own pipe."""

LONGEST = 1 << 20
"""How long an answer may be, in bytes."""

BACKLOG = 1000
"""How many lines of the journal wait for a slow client; the newest stay."""

_CREDENTIALS = struct.Struct("3i")

_log = logging.getLogger("esair")


class Socket:
    """The control socket of a robot, in its own event loop.

    Args:
        console: Does what clients want.
        place: Where the socket is.
    """

    def __init__(self, console: Console, place: Place) -> None:
        self.console = console
        self.place = place
        self.clients: set[_Client] = set()
        self.turned_away = 0
        """How many came who may not, or were too many."""
        self.garbage = 0
        """How many lines were no messages."""
        self.dropped = 0
        """How many pushed lines slow clients have missed."""
        self.cut_off = 0
        """How many clients were cut off because they did not read."""
        self._server: asyncio.Server | None = None
        console.robot.journal.count("socket", lambda: [("socket", self.counts())])

    def counts(self) -> dict[str, int]:
        """Return the counters, by name."""
        return {
            "clients": len(self.clients),
            "turned_away": self.turned_away,
            "garbage": self.garbage,
            "dropped": self.dropped,
            "cut_off": self.cut_off,
        }

    async def start(self) -> None:
        """Let clients come."""
        loop = asyncio.get_running_loop()
        bound = self.place.bind()
        # A bound socket without a path: asyncio would look after the file otherwise.
        self._server = await loop.create_unix_server(
            lambda: _Client(self), sock=bound, backlog=CLIENTS
        )
        _log.info("control socket: %s", self.place.path)

    async def close(self) -> None:
        """Let nobody in any more; those who are in are told that it ends."""
        if self._server is not None:
            self._server.close()
        for client in tuple(self.clients):
            client.end()
        await asyncio.sleep(0)  # what they are told leaves
        self.place.close()

    def admits(self, client: _Client) -> bool:
        """Decide whether a client may come in; one too many can still stop."""
        link: socket.socket = client.transport.get_extra_info("socket")
        raw = link.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
        process, user, _ = _CREDENTIALS.unpack(raw)
        if user not in {os.getuid(), 0}:
            self.turned_away += 1
            _log.warning("control socket: user %d was turned away", user)
            client.send(_not_you(user))
            return False
        client.session.who = f"user {user}"
        client.process = process
        client.narrow = len(self.clients) >= CLIENTS
        if len(self.clients) >= CLIENTS + STOP_LANES:
            self.turned_away += 1
            client.send(failure(None, BusyError("control socket", "clients", CLIENTS)))
            return False
        self.clients.add(client)
        return True


def _not_you(user: int) -> dict[str, Any]:
    told = f"user {user} may not operate this robot: only its own user and root may"
    error = {"type": "AccessDeniedError", "text": told}
    return {"v": VERSION, "id": None, "ok": False, "error": error}


class _Client(asyncio.Protocol):
    """One connection: its lines, its answers, what it watches."""

    transport: asyncio.Transport

    def __init__(self, server: Socket) -> None:
        self.server = server
        self.console = server.console
        self.session = Session("", self._lapsed)
        self.process = 0
        self.narrow = False
        self._is_out = False
        self._loop = asyncio.get_running_loop()
        self._line = bytearray()
        self._skips = False
        self._budget = float(LINES)
        self._filled = self._loop.time()
        self._patience: asyncio.TimerHandle | None = None
        self._feeds: dict[str, _Feed] = {}
        self._beats: asyncio.TimerHandle | None = None
        self._waiting: collections.deque[Message] = collections.deque()

    # The connection.

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self.transport = transport
        # Above this nothing is pushed any more; answers go on until WAITING.
        transport.set_write_buffer_limits(high=WAITING // 4)
        if not self.server.admits(self):
            # What it has sent is read, else it would not hear why it is refused.
            self._is_out = True
            transport.write_eof()
            self._patience = self._loop.call_later(LINGER, transport.abort)
        elif self.narrow:
            self._patience = self._loop.call_later(STOP_LANE, self._too_slow)

    def connection_lost(self, exc: Exception | None) -> None:
        self.server.clients.discard(self)
        for feed in self._feeds.values():
            feed.stop()
        if self._patience is not None:
            self._patience.cancel()
        if self._beats is not None:
            self._beats.cancel()
        self.console.leases.end_all(self.session)

    def end(self) -> None:
        """Say that the robot has ended, and close."""
        self.send({"v": VERSION, "id": None, "ended": True})
        self.transport.close()

    def send(self, found: dict[str, Any]) -> None:
        """Send a line; a client that does not read is cut off."""
        line = encode(found)
        if len(line) > LONGEST:
            told = f"the answer has {len(line)} bytes, more than {LONGEST}"
            line = encode(failure(found.get("id"), BadValueError("answer", "", told)))
        if self.transport.get_write_buffer_size() + len(line) > WAITING + LONGEST:
            self.server.cut_off += 1
            self.transport.abort()
            return
        self.transport.write(line)
        if self.transport.get_write_buffer_size() > WAITING:
            self.server.cut_off += 1
            _log.warning("control socket: a client does not read and is cut off")
            self.transport.abort()

    def push(self, found: dict[str, Any]) -> bool:
        """Send what is only worth something while it is new, if there is room."""
        if self.transport.is_closing() or self.transport.get_write_buffer_size():
            self.server.dropped += 1
            return False
        self.send(found)
        return True

    # Lines.

    def data_received(self, data: bytes) -> None:
        if self._is_out:
            return
        pieces = data.split(b"\n")
        for index, piece in enumerate(pieces):
            self._take(piece, whole=index < len(pieces) - 1)
            if self.transport.is_closing():
                return
        self._spend(len(pieces) - 1 + len(data) / LIMIT)
        if self.narrow:
            return
        if self._line or self._skips:
            if self._patience is None:
                self._patience = self._loop.call_later(HALF_LINE, self._too_slow)
        elif self._patience is not None:
            self._patience.cancel()
            self._patience = None

    def _take(self, piece: bytes, *, whole: bool) -> None:
        if not self._skips:
            self._line += piece
            if len(self._line) >= LIMIT:
                self._line.clear()
                self._skips = True
                self._refuse_line(
                    None,
                    BadValueError("message", "", f"expected at most {LIMIT} bytes"),
                )
        if not whole:
            return
        line, self._line = bytes(self._line), bytearray()
        if self._skips:
            self._skips = False
        elif line.strip():
            self._do(line)

    def _do(self, line: bytes) -> None:
        name = None
        try:
            found = decode(line)
            name = id_of(found)
            message = message_of(found)
        except Exception as error:
            self._refuse_line(name, error)
            return
        if self.narrow and message.act != "stop":
            told = BusyError(
                "control socket", "clients; this one can only stop", CLIENTS
            )
            self.send(failure(name, told))
        elif message.act in _FEEDS:
            self._follow(message)
        else:
            self.console.take(message, self.session).add_done_callback(
                lambda done: self._answer(message.id, done)
            )

    def _answer(self, name: str, done: asyncio.Future[Any]) -> None:
        if self.transport.is_closing():
            return
        if done.cancelled():
            stopped = BusyError("robot", "acts: it has stopped", 0)
            self.send(failure(name, stopped))
        elif (error := done.exception()) is not None:
            self.send(failure(name, error))
        else:
            result = done.result()
            self.send(outcome(name, result))
            if isinstance(result, dict) and "lease" in result and self._beats is None:
                self._beat()

    def _refuse_line(self, name: str | None, error: Exception) -> None:
        self.server.garbage += 1
        self.send(failure(name, error))

    def _too_slow(self) -> None:
        told = f"expected a whole line within {HALF_LINE:g} s"
        self.send(failure(None, BadValueError("message", "", told)))
        self.transport.close()

    def _spend(self, lines: float) -> None:
        """Count what a client sends; who sends too much is read later."""
        now = self._loop.time()
        self._budget = min(LINES, self._budget + (now - self._filled) * LINES) - lines
        self._filled = now
        if self._budget < 0:
            self.transport.pause_reading()
            self._loop.call_later(-self._budget / LINES, self._go_on)

    def _go_on(self) -> None:
        if not self.transport.is_closing():
            self.transport.resume_reading()

    # What is pushed.

    def _follow(self, message: Message) -> None:
        try:
            feed = _FEEDS[message.act](self, message)
        except Exception as error:
            self.send(failure(message.id, error))
            return
        known = self._feeds.pop(message.act, None)
        if known is not None:
            known.stop()
        self._feeds[message.act] = feed
        self.send(outcome(message.id, "begins"))
        feed.start()

    def _beat(self) -> None:
        if not any(each.owner is self.session for each in self.console.leases):
            self._beats = None
            return
        self.push({"v": VERSION, "beat": self.console.leases.beats.next()})
        self._beats = self._loop.call_later(BEAT, self._beat)

    def _lapsed(self, lease: Lease) -> None:
        if not self.transport.is_closing():
            self.send({"v": VERSION, "lapsed": lease.number})


class _Feed:
    """What is pushed to a client until it goes or wants another one."""

    fields: frozenset[str] = frozenset()

    def __init__(self, client: _Client, message: Message) -> None:
        self.client = client
        self.name = message.id
        unknown = message.fields.keys() - self.fields
        if unknown:
            told = f"there is no such field; there are {', '.join(sorted(self.fields))}"
            raise BadValueError(message.act, min(unknown), told)

    def start(self) -> None:
        """Begin to push."""
        raise NotImplementedError

    def stop(self) -> None:
        """Push no more."""
        raise NotImplementedError


class _Watch(_Feed):
    """Pictures of the robot, one after the other."""

    fields = frozenset({"every"})

    def __init__(self, client: _Client, message: Message) -> None:
        super().__init__(client, message)
        every = message.fields.get("every", 0.25)
        if type(every) not in {int, float} or not 0.1 <= every <= 60.0:
            raise BadValueError("watch", "every", "expected 0.1 to 60 seconds")
        self._every = float(every)
        self._next: asyncio.TimerHandle | None = None

    def start(self) -> None:
        picture = self.client.console.status.picture()
        self.client.push({"v": VERSION, "id": self.name, "status": picture})
        loop = asyncio.get_running_loop()
        self._next = loop.call_later(self._every, self.start)

    def stop(self) -> None:
        if self._next is not None:
            self._next.cancel()


class _Log(_Feed):
    """Events of the journal, as they come."""

    fields = frozenset({"components", "kinds"})

    def __init__(self, client: _Client, message: Message) -> None:
        super().__init__(client, message)
        self._components = _names(message, "components")
        kinds = _names(message, "kinds")
        known = {each.value for each in Kind}
        if kinds - known:
            told = f"expected some of {', '.join(sorted(known))}"
            raise BadValueError("log", "kinds", told)
        self._kinds = [Kind(each) for each in kinds] or None
        self._listener: Listener | None = None
        self._missed = 0
        self._events: collections.deque[Event] = collections.deque(maxlen=BACKLOG)

    def start(self) -> None:
        journal = self.client.console.robot.journal
        self._listener = journal.listen(self._hear, kinds=self._kinds)

    def stop(self) -> None:
        if self._listener is not None:
            self._listener.stop()

    def _hear(self, event: Event) -> None:
        wanted = self._components
        if wanted and not wanted & {event.component, event.peer}:
            return
        if len(self._events) == BACKLOG:
            self._missed += 1
            self.client.server.dropped += 1
        self._events.append(event)
        if len(self._events) == 1:
            self._flush()

    def _flush(self) -> None:
        """Send what there is room for; the newest of the rest waits."""
        client = self.client
        while self._events and not client.transport.is_closing():
            if client.transport.get_write_buffer_size() > WAITING // 4:
                asyncio.get_running_loop().call_later(0.1, self._flush)
                return
            event = self._events.popleft()
            found = {
                "number": event.number,
                "time": event.time,
                "kind": event.kind.value,
                "component": event.component,
                "peer": event.peer,
                "value": _small(event.value),
                "text": event.text[:4096],
                "missed": self._missed,
            }
            client.send({"v": VERSION, "id": self.name, "event": found})


def _small(value: Any) -> Any:
    """Return a value for a line of the log; one that is long is shown shortly."""
    found = plain(value)
    if isinstance(found, dict | list | str) and len(json.dumps(found)) > 2048:
        return f"{str(found)[:200]}..."
    return found


def _names(message: Message, field: str) -> frozenset[str]:
    found = message.fields.get(field, [])
    if not isinstance(found, list) or not all(isinstance(each, str) for each in found):
        raise BadValueError(message.act, field, f"expected names, not {found!r:.80}")
    return frozenset(found)


_FEEDS: dict[str, type[_Feed]] = {"watch": _Watch, "log": _Log}
