"""Whoever operates from outside: its messages, their answers, and what it watches."""

from __future__ import annotations

import asyncio
import collections
import json
from typing import Any

from esair.exceptions import BadValueError, BusyError
from esair.journal import Event, Kind, Listener
from esair.recording import plain
from esair.seat._leases import BEAT, Lease
from esair.seat._operator import Console, Session
from esair.seat._wire import (
    VERSION,
    Message,
    decode,
    failure,
    id_of,
    message_of,
    outcome,
)

BACKLOG = 1000
"""How many lines of the journal wait for a slow client; the newest stay."""

ROOM = 64 * 1024
"""How many bytes may wait for a client before events wait too."""


class Visitor:
    """One who operates, by whatever way its lines come and go.

    Args:
        console: Does what it wants.

    Attributes:
        dropped: How many pushed lines it has missed because it was slow.
        garbage: How many of its lines were no messages.
        narrow: How many clients there are, if it is one too many: it can only stop.
    """

    def __init__(self, console: Console) -> None:
        self.console = console
        self.session = Session("", self._lapsed)
        self.dropped = 0
        self.garbage = 0
        self.narrow = 0
        self._feeds: dict[str, _Feed] = {}
        self._beats: asyncio.TimerHandle | None = None

    # What a way in provides.

    def send(self, found: dict[str, Any]) -> None:
        """Send a line."""
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

    def leave(self) -> None:
        """It is gone: what it drives is released, what it watches ends."""
        for feed in self._feeds.values():
            feed.stop()
        if self._beats is not None:
            self._beats.cancel()
        self.console.leases.end_all(self.session)

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
        elif message.act in _FEEDS:
            self._follow(message)
        else:
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
            result = done.result()
            self.send(outcome(name, result))
            if isinstance(result, dict) and "lease" in result and self._beats is None:
                self._beat()

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
        self._beats = asyncio.get_running_loop().call_later(BEAT, self._beat)

    def _lapsed(self, lease: Lease) -> None:
        if not self.gone:
            self.send({"v": VERSION, "lapsed": lease.number})


class _Feed:
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


class _Watch(_Feed):
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


class _Log(_Feed):
    """Events of the journal, as they come."""

    fields = frozenset({"components", "kinds"})

    def __init__(self, client: Visitor, message: Message) -> None:
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
            self.client.dropped += 1
        self._events.append(event)
        if len(self._events) == 1:
            self._flush()

    def _flush(self) -> None:
        """Send what there is room for; the newest of the rest waits."""
        client = self.client
        while self._events and not client.gone:
            if client.unread > ROOM:
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
