"""Whoever operates from outside: its messages, their answers, and what it watches."""

from __future__ import annotations

import asyncio
from typing import Any

from esair.exceptions import BusyError
from esair.seat._feeds import FEEDS, Feed
from esair.seat._leases import Lease
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


class Visitor:
    """One who operates, by whatever way its lines come and go."""

    def __init__(self, console: Console) -> None:
        self.console = console
        self.session = Session("", hand=self)
        self.dropped = 0  # How many pushed lines it has missed because it was slow
        self.garbage = 0  # How many of its lines were no messages
        # How many clients there are, if it is one too many: it can only stop
        self.narrow = 0
        self._feeds: dict[str, Feed] = {}

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
