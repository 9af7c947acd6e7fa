"""The control socket of one robot: who may come in, and how much each may cost."""

from __future__ import annotations

import asyncio
import logging
import os
import socket
import struct
from typing import Any

from esair.exceptions import BadValueError, BusyError
from esair.seat._operator import Console
from esair.seat._place import Place
from esair.seat._visitor import LONGEST, Budget, Entry, Piecewise, Visitor, Way, line_of
from esair.seat._wire import LIMIT, VERSION, failure

CLIENTS = 16
"""How many clients may be there at a time."""

WAITING = 256 * 1024
"""How many bytes may wait for a client that does not read; one more and it goes."""

LAST_WORDS = 5.0  # How long who says no more is kept for answers to come, in seconds
HALF_LINE = 5.0  # How long a client may take for one line, in seconds
STOP_LANE = 5.0  # How long a client may stay that can only stop the robot, in seconds
LINGER = 0.5  # How long a client that is turned away may take to hear why, in seconds

LINES = 2000
"""How many lines a client may send in a second; the rest waits in its own pipe."""

_CREDENTIALS = struct.Struct("3i")

_log = logging.getLogger("esair")


class Socket(Way["_Client"]):
    """The control socket of a robot, in its own event loop."""

    def __init__(self, console: Console, place: Place) -> None:
        super().__init__(console, "socket", CLIENTS)
        self.place = place

    async def start(self) -> None:
        """Let clients come."""
        self.entry = Entry(self.place.bind(), CLIENTS, lambda: _Client(self))
        _log.info("control socket: %s", self.place.path)

    async def close(self) -> None:
        """Let nobody in any more; those who are in are told that it ends."""
        if self.entry is not None:
            self.entry.close()
        for client in tuple(self.there):
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
            told = f"user {user} may not operate this robot: only its own user and root may"
            error = {"type": "AccessDeniedError", "text": told}
            client.send({"v": VERSION, "id": None, "ok": False, "error": error})
            return False
        client.session.who = f"user {user}"
        client.process = process
        if self.has_room(client):
            return True
        client.send(failure(None, BusyError("control socket", "clients", CLIENTS)))
        return False


class _Client(Visitor, Piecewise):
    """One connection: its lines, its answers, what it watches."""

    transport: asyncio.Transport

    def __init__(self, server: Socket) -> None:
        super().__init__(server.console)
        self.server = server
        self.process = 0
        self._is_out = False
        self._only_hears = False
        self._loop = asyncio.get_running_loop()
        self._line = bytearray()
        self._skips = False
        self._budget = Budget(LINES)
        self._patience: asyncio.TimerHandle | None = None

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

    def eof_received(self) -> bool:
        """It says no more, but may read on: what it is owed is told first."""
        self._only_hears = not self._is_out and self.owed > 0
        if self._only_hears:
            self._loop.call_later(LAST_WORDS, self.transport.abort)
        return self._only_hears

    def answer(self, name: str, done: asyncio.Future[Any]) -> None:
        super().answer(name, done)
        if self._only_hears and not self.owed:
            self.close()

    def connection_lost(self, exc: Exception | None) -> None:
        self.server.forget(self)
        if self._patience is not None:
            self._patience.cancel()
        self.leave()

    @property
    def gone(self) -> bool:
        return self.transport.is_closing()

    @property
    def unread(self) -> int:
        return self.transport.get_write_buffer_size()

    def end(self) -> None:
        super().end()
        self.close()

    def close(self) -> None:
        self.transport.close()

    def send(self, found: dict[str, Any]) -> None:
        """Send a line; a client that does not read is cut off."""
        line = line_of(found)
        if self.transport.get_write_buffer_size() + len(line) > WAITING + LONGEST:
            self.server.cut_off += 1
            self.transport.abort()
            return
        self.transport.write(line)
        if self.transport.get_write_buffer_size() > WAITING:
            self.server.cut_off += 1
            _log.warning("control socket: a client does not read and is cut off")
            self.transport.abort()

    # Lines.

    def data_received(self, data: bytes) -> None:
        if self._is_out:
            return
        pieces = data.split(b"\n")
        for index, piece in enumerate(pieces):
            self._take(piece, whole=index < len(pieces) - 1)
            if self.transport.is_closing():
                return
        if pause := self._budget.spend(len(pieces) - 1 + len(data) / LIMIT):
            self.transport.pause_reading()
            self._loop.call_later(pause, self._go_on)
        if self.narrow:
            return
        if self._patience is not None and len(pieces) > 1:
            self._patience.cancel()
            self._patience = None
        if self._patience is None and (self._line or self._skips):
            self._patience = self._loop.call_later(HALF_LINE, self._too_slow)

    def _take(self, piece: bytes, *, whole: bool) -> None:
        if not self._skips:
            self._line += piece
            if len(self._line) >= LIMIT:
                self._line.clear()
                self._skips, self.piece = True, LIMIT  # what is skipped costs nothing
                self.refuse(
                    None,
                    BadValueError("message", "", f"expected at most {LIMIT} bytes"),
                )
        if not whole:
            return
        line, self._line = bytes(self._line), bytearray()
        if self._skips:
            self._skips, self.piece = False, Piecewise.piece
        elif line.strip():
            self.do(line)

    def _too_slow(self) -> None:
        told = f"expected a whole line within {HALF_LINE:g} s"
        self.send(failure(None, BadValueError("message", "", told)))
        self.transport.close()

    def _go_on(self) -> None:
        if not self.transport.is_closing():
            self.transport.resume_reading()
