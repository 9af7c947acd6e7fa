"""What is pushed to a client until it goes: pictures, events, messages for viewers."""

from __future__ import annotations

import asyncio
import json
import time
from typing import Any, Protocol

from esair.exceptions import BadValueError
from esair.journal import Event, Kind, Listener
from esair.loop import clock_of
from esair.recording import Seen, plain, seen_as, size_of
from esair.seat._operator import Console
from esair.seat._short import short
from esair.seat._wire import VERSION, Message

BACKLOG = 1000  # How many lines of the journal wait for a slow client; the newest stay
ROOM = 64 * 1024  # How many bytes may wait for a client before events wait too
LARGE = 2048  # What has more bytes is shown shortly in a line of the log

VIEWED = 256 * 1024
"""The greatest value that is shown live, in bytes; of a larger one only that it came."""


class Fed(Protocol):
    """What a feed needs of its client."""

    console: Console
    dropped: int

    @property
    def gone(self) -> bool: ...
    @property
    def unread(self) -> int: ...
    def send(self, found: dict[str, Any]) -> None: ...
    def push(self, found: dict[str, Any]) -> bool: ...


class Feed:
    """What is pushed to a client until it goes or wants another one."""

    fields: frozenset[str] = frozenset()

    def __init__(self, client: Fed, message: Message) -> None:
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

    def __init__(self, client: Fed, message: Message) -> None:
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

    def __init__(self, client: Fed, message: Message) -> None:
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

    def __init__(self, client: Fed, message: Message) -> None:
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
        self._offset = time.time() - clock_of(asyncio.get_running_loop())()
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
