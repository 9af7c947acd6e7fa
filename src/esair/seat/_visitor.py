"""Who operates from outside: its messages, their answers, and what is pushed to it."""

from __future__ import annotations

import asyncio
import contextlib
import json
import socket
import time
from collections.abc import Callable
from typing import Any, Generic, TypeVar

from esair.exceptions import BadValueError, BusyError
from esair.journal import Event, Kind, Listener
from esair.loop import clock_beside
from esair.recording import Seen, plain, seen_as, size_of
from esair.seat._leases import Lease
from esair.seat._operator import Console, Session
from esair.seat._values import short
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

BACKLOG = 1000  # How many lines of the journal wait for a slow client; the newest stay
ROOM = 64 * 1024  # How many bytes may wait for a client before events wait too
PIECE = 2048  # How many bytes of a connection are looked at in a turn
LARGE = 2048  # What has more bytes is shown shortly in a line of the log

VIEWED = 256 * 1024
"""The greatest value that is shown live, in bytes; of a larger one only that it came."""


class Feed:
    """What is pushed to a client until it goes or wants another one."""

    fields: frozenset[str] = frozenset()

    def __init__(self, client: Visitor, message: Message) -> None:
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


class _Watch(Feed):
    """Pictures of the robot, one after the other."""

    fields = frozenset({"every"})

    def __init__(self, client: Visitor, message: Message) -> None:
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


class _Heard(Feed):
    """What the journal tells, as fast as the client reads it."""

    word = "event"
    kinds: list[Kind] | None = None
    _listener: Listener | None = None

    def __init__(self, client: Visitor, message: Message) -> None:
        super().__init__(client, message)
        self._waiting: dict[object, Any] = {}
        self._rests = False

    def start(self) -> None:
        journal = self.client.console.robot.journal
        self._listener = journal.listen(self._hear, kinds=self.kinds)

    def stop(self) -> None:
        if self._listener is not None:
            self._listener.stop()

    def _hear(self, event: Event) -> None:
        raise NotImplementedError

    def _shown(self, found: Any) -> dict[str, Any]:
        raise NotImplementedError

    def _keep(self, key: object, found: Any) -> None:
        self._waiting[key] = found
        if not self._rests:
            self._flush()

    def _flush(self) -> None:
        """Send what there is room for; the rest waits."""
        client = self.client
        self._rests = False
        while self._waiting and not client.gone:
            if client.unread > ROOM:
                self._rests = True
                asyncio.get_running_loop().call_later(0.05, self._flush)
                return
            found = self._shown(self._waiting.pop(next(iter(self._waiting))))
            client.send({"v": VERSION, "id": self.name, self.word: found})


class _Log(_Heard):
    """Events of the journal, as they come; of too many the newest."""

    fields = frozenset({"components", "kinds"})

    def __init__(self, client: Visitor, message: Message) -> None:
        super().__init__(client, message)
        self._components = _names(message, "components")
        kinds = _names(message, "kinds")
        known = {each.value for each in Kind}
        if kinds - known:
            told = f"expected some of {', '.join(sorted(known))}"
            raise BadValueError("log", "kinds", told)
        self.kinds = [Kind(each) for each in kinds] or None
        self._missed = 0

    def _hear(self, event: Event) -> None:
        wanted = self._components
        if wanted and not wanted & {event.component, event.peer}:
            return
        if len(self._waiting) == BACKLOG:
            del self._waiting[next(iter(self._waiting))]
            self._missed += 1
            self.client.dropped += 1
        self._keep(event.number, event)

    def _shown(self, event: Event) -> dict[str, Any]:
        return {
            **event._asdict(),
            "kind": event.kind.value,
            "value": _small(event.value),
            "text": event.text[:4096],
            "missed": self._missed,
        }


class _View(_Heard):
    """Every event as a message for viewers; of a slow client's topics the newest."""

    word = "message"

    def start(self) -> None:
        self._offset = time.time() - clock_beside(asyncio.get_running_loop())()
        super().start()

    def _hear(self, event: Event) -> None:
        found = seen_as(event, self._offset, _viewed)
        if self._waiting.pop(found.topic, None) is not None:
            self.client.dropped += 1
        self._keep(found.topic, found)

    def _shown(self, seen: Seen) -> dict[str, Any]:
        return seen._asdict()


def _viewed(value: Any) -> Any:
    return None if size_of(value) > VIEWED else plain(value)


def _small(value: Any) -> Any:
    """Return a value for a line of the log; one that is long is shown shortly."""
    if size_of(value) > LARGE:
        return short(value, 200)
    found = plain(value)
    if isinstance(found, dict | list | str) and len(json.dumps(found)) > 2048:
        return f"{str(found)[:200]}..."
    return found


def _names(message: Message, field: str) -> frozenset[str]:
    found = message.fields.get(field, [])
    if not isinstance(found, list) or not all(isinstance(each, str) for each in found):
        raise BadValueError(message.act, field, f"expected names, not {found!r:.80}")
    return frozenset(found)


FEEDS: dict[str, type[Feed]] = {"watch": _Watch, "log": _Log, "view": _View}


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
    """

    def __init__(
        self,
        bound: socket.socket,
        backlog: int,
        make: Callable[[], asyncio.BaseProtocol],
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


class Piecewise(asyncio.BufferedProtocol):
    """Hears a piece in each turn: however much has come, the loop is not held for it."""

    piece = PIECE  # How many bytes it has
    data_received: Callable[[bytes], None]

    def get_buffer(self, sizehint: int) -> memoryview:
        self._heard = memoryview(bytearray(self.piece))
        return self._heard

    def buffer_updated(self, nbytes: int) -> None:
        self.data_received(bytes(self._heard[:nbytes]))


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
        self.owed: int = 0  # How many of its acts have no answer yet
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
            self.owed += 1
            self.console.take(message, self.session).add_done_callback(
                lambda done: self.answer(message.id, done)
            )

    def refuse(self, name: str | None, error: Exception) -> None:
        """Answer what is no message."""
        self.garbage += 1
        self.send(failure(name, error))

    def answer(self, name: str, done: asyncio.Future[Any]) -> None:
        """Tell it the outcome of an act."""
        self.owed -= 1
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
