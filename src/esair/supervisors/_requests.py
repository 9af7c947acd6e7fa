"""Requests between behaviors: each has one outcome, and a bounded place to wait."""

from __future__ import annotations

import asyncio
import collections
import enum
from typing import Any, NamedTuple

REQUESTS_PER_SENDER = 16
"""How many requests of one behavior may wait at a time."""

REQUESTS_PER_TARGET = 64
"""How many requests to one behavior may wait at a time."""

REQUESTS = 4096
"""How many requests may wait in a robot at a time."""


class Outcome(enum.Enum):
    """How a request ended. Each ends in exactly one way."""

    DELIVERED = "delivered"
    REFUSED = "refused"
    TIMED_OUT = "timed out"
    PEER_REMOVED = "peer removed"
    PEER_FAILED = "peer failed"
    STOPPING = "stopping"
    WITHDRAWN = "withdrawn"


class Record(NamedTuple):
    """One line of the ledger: who asked what of whom, and how it ended."""

    kind: str
    sender: str
    receiver: str
    outcome: Outcome


class Request:
    """A put or a get that waits for the other side."""

    __slots__ = (
        "asker",
        "data",
        "future",
        "kind",
        "peer",
        "provider",
        "receiver",
        "sender",
    )

    def __init__(
        self,
        kind: str,
        sender: str,
        receiver: str,
        data: Any,
        future: asyncio.Future[Any],
    ) -> None:
        self.kind = kind
        self.sender = sender
        self.receiver = receiver
        self.asker, self.peer = (
            (sender, receiver) if kind == "put" else (receiver, sender)
        )
        """Who waits for the outcome, and whom for."""
        self.data = data
        self.future = future
        self.provider: asyncio.Task[Any] | None = None


class FairQueue:
    """Waiting requests, one queue for each sender; they take turns."""

    __slots__ = ("_queues", "count")

    def __init__(self) -> None:
        self._queues: dict[str, collections.deque[Request]] = {}
        self.count = 0

    def push(self, request: Request) -> None:
        """Put a request at the end of its sender's queue."""
        queue = self._queues.get(request.asker)
        if queue is None:
            queue = self._queues[request.asker] = collections.deque()
        queue.append(request)
        self.count += 1

    def pop(self) -> Request:
        """Take the next request of the sender whose turn it is."""
        asker = next(iter(self._queues))
        queue = self._queues.pop(asker)
        request = queue.popleft()
        self.count -= 1
        if queue:
            self._queues[asker] = queue  # behind all the others
        return request

    def discard(self, request: Request) -> bool:
        """Take a request out, wherever it is; tells whether it was there."""
        queue = self._queues.get(request.asker)
        if queue is None or request not in queue:
            return False
        queue.remove(request)
        self.count -= 1
        if not queue:
            del self._queues[request.asker]
        return True

    def peek(self) -> Request | None:
        """Return the first request that nobody has answered yet, without taking it."""
        for queue in self._queues.values():
            for request in queue:
                if not request.future.done():
                    return request
        return None

    def drain(self) -> list[Request]:
        """Take everything."""
        requests = [request for queue in self._queues.values() for request in queue]
        self._queues.clear()
        self.count = 0
        return requests
