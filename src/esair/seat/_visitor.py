"""Whoever operates from outside: its messages, their answers, and what it watches."""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import Callable
from typing import Any, Generic, TypeVar

from esair.exceptions import BadValueError, BusyError
from esair.seat._feeds import FEEDS, Feed
from esair.seat._leases import Lease
from esair.seat._operator import Console, Session
from esair.seat._wire import (
    VERSION,
    Message,
    decode,
    encode,
    failure,
    id_of,
    message_of,
    outcome,
)

LONGEST = 1 << 20  # How long an answer may be, in bytes
STOP_LANES = 4  # How many more may come in by each way who can only stop the robot

NEWCOMERS = 64
"""How many may come in by each way in a second, and as many at once."""

V = TypeVar("V", bound="Visitor")


class Way(Generic[V]):
    """One way in: who is there, and what they have counted."""

    def __init__(self, console: Console, name: str, room: int) -> None:
        self.console = console
        self.there: dict[V, None] = {}  # In the order in which they came
        self.turned_away: int = 0  # How many came who may not, or were too many
        self.cut_off = 0  # How many were cut off because they did not read
        self.entry: Entry | None = None
        self._room = room
        self._past = [0, 0]
        console.robot.journal.count(name, lambda: [(name, self.counts())])

    def counts(self) -> dict[str, int]:
        """Return the counters, by name."""
        return {
            "clients": len(self.there),
            "newcomers": 0 if self.entry is None else self.entry.newcomers,
            "turned_away": self.turned_away,
            "garbage": self._past[0] + sum(each.garbage for each in self.there),
            "dropped": self._past[1] + sum(each.dropped for each in self.there),
            "cut_off": self.cut_off,
        }

    def has_room(self, visitor: V) -> bool:
        """Let somebody in if there is room; one too many can still stop the robot.

        Who only sits where one can stop gives way to the next.
        """
        if len(self.there) >= self._room + STOP_LANES:
            self.turned_away += 1
            idle = [each for each in self.there if each.narrow and not each.stops]
            if not idle:
                return False
            idle[0].send(failure(None, BusyError("operators", "clients", self._room)))
            self.forget(idle[0])
            idle[0].close()
        visitor.narrow = self._room if len(self.there) >= self._room else 0
        self.there[visitor] = None
        return True

    def forget(self, visitor: V) -> None:
        """Somebody has gone; what it has counted stays."""
        if visitor in self.there:
            del self.there[visitor]
            self._past[0] += visitor.garbage
            self._past[1] += visitor.dropped


class Entry:
    """Takes newcomers from a listening socket: one in a turn, and so many in a second.

    Whoever floods it waits in the kernel, with all other newcomers, and not in the
    robot's loop; who is in already does not notice.

    Args:
        bound: The socket, bound and not blocking.
        backlog: How many newcomers the kernel lets wait.
        make: Makes the protocol of a newcomer.
    """

    def __init__(
        self, bound: socket.socket, backlog: int, make: Callable[[], asyncio.Protocol]
    ) -> None:
        self.newcomers: int = 0  # How many have come in
        self._loop = asyncio.get_running_loop()
        self._bound = bound
        self._make = make
        self._budget = Budget(NEWCOMERS)
        self._pause: asyncio.TimerHandle | None = None
        bound.listen(backlog)
        self._open()

    def close(self) -> None:
        """Let nobody in any more."""
        if self._pause is not None:
            self._pause.cancel()
        self._loop.remove_reader(self._bound)
        self._bound.close()

    def _open(self) -> None:
        self._loop.add_reader(self._bound, self._take)

    def _take(self) -> None:
        pause = 0.0
        try:
            link, _ = self._bound.accept()
        except (BlockingIOError, InterruptedError, ConnectionAbortedError):
            return  # it has gone again
        except OSError:  # no descriptor is left for it
            pause = 1.0
        else:
            self.newcomers += 1
            link.setblocking(False)
            self._loop.create_task(self._let_in(link), name="esair newcomer")
            pause = self._budget.spend(1)
        if pause:
            self._loop.remove_reader(self._bound)
            self._pause = self._loop.call_later(pause, self._open)

    async def _let_in(self, link: socket.socket) -> None:
        with contextlib.suppress(OSError):
            await self._loop.connect_accepted_socket(self._make, link)


class Budget:
    """How many lines may come in a second, and as many at once."""

    def __init__(self, lines: int) -> None:
        self._lines = lines
        self._time = asyncio.get_running_loop().time
        self._filled, self._left = self._time(), float(lines)

    def spend(self, lines: float) -> float:
        """Count lines that came; return for how long no more are read, in seconds."""
        now = self._time()
        filled = self._left + (now - self._filled) * self._lines
        self._filled, self._left = now, min(self._lines, filled) - lines
        return max(-self._left / self._lines, 0.0)


def line_of(found: dict[str, Any]) -> bytes:
    """Return the line of an answer; of one that is too long, only that it is."""
    line = encode(found)
    if len(line) > LONGEST:
        told = f"the answer has {len(line)} bytes, more than {LONGEST}"
        line = encode(failure(found.get("id"), BadValueError("answer", "", told)))
    return line


class Visitor:
    """One who operates, by whatever way its lines come and go."""

    def __init__(self, console: Console) -> None:
        self.console = console
        self.session: Session = Session("", hand=self)
        self.dropped: int = 0  # How many pushed lines it has missed because it was slow
        self.garbage: int = 0  # How many of its lines were no messages
        # How many clients there are, if it is one too many: it can only stop
        self.narrow = 0
        self.stops: bool = False  # Whether it has stopped the robot
        self._feeds: dict[str, Feed] = {}

    # What a way in provides.

    def send(self, found: dict[str, Any]) -> None:
        """Send a line."""
        raise NotImplementedError

    def close(self) -> None:
        """End the connection, after what was sent."""
        raise NotImplementedError

    @property
    def gone(self) -> bool:
        """Whether nothing can be sent any more."""
        raise NotImplementedError

    @property
    def unread(self) -> int:
        """How many bytes wait to be read."""
        raise NotImplementedError

    # What is the same for all.

    def end(self) -> None:
        """Say that the robot has ended."""
        self.send({"v": VERSION, "id": None, "ended": True})

    def leave(self) -> None:
        """It is gone: what it drives is released, what it watches ends."""
        for feed in self._feeds.values():
            feed.stop()
        self.console.leave(self.session)

    def push(self, found: dict[str, Any]) -> bool:
        """Send what is only worth something while it is new, if there is room."""
        if self.gone or self.unread:
            self.dropped += 1
            return False
        self.send(found)
        return True

    def do(self, line: bytes) -> None:
        """Take a line in, whatever it is; it has one answer."""
        name = None
        try:
            found = decode(line)
            name = id_of(found)
            message = message_of(found)
        except Exception as error:
            self.refuse(name, error)
            return
        if self.narrow and message.act != "stop":
            told = "clients; this one can only stop"
            self.send(failure(name, BusyError("operators", told, self.narrow)))
        elif message.act in FEEDS:
            self._follow(message)
        else:
            self.stops |= message.act == "stop"
            self.console.take(message, self.session).add_done_callback(
                lambda done: self._answer(message.id, done)
            )

    def refuse(self, name: str | None, error: Exception) -> None:
        """Answer what is no message."""
        self.garbage += 1
        self.send(failure(name, error))

    def _answer(self, name: str, done: asyncio.Future[Any]) -> None:
        if self.gone:
            return
        if done.cancelled():
            self.send(failure(name, BusyError("robot", "acts: it has stopped", 0)))
        elif (error := done.exception()) is not None:
            self.send(failure(name, error))
        else:
            self.send(outcome(name, done.result()))

    def _follow(self, message: Message) -> None:
        try:
            feed = FEEDS[message.act](self, message)
        except Exception as error:
            self.send(failure(message.id, error))
            return
        known = self._feeds.pop(message.act, None)
        if known is not None:
            known.stop()
        self._feeds[message.act] = feed
        self.send(outcome(message.id, "begins"))
        feed.start()

    def beat(self, number: int) -> None:
        """Tell it a beat, if it drives and reads."""
        self.push({"v": VERSION, "beat": number})

    def lapsed(self, lease: Lease) -> None:
        """Tell it that its lease is over."""
        if not self.gone:
            self.send({"v": VERSION, "lapsed": lease.number})
