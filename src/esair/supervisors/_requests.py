"""Requests between behaviors: each has one outcome, and a bounded place to wait."""

from __future__ import annotations

import asyncio
import collections
import contextvars
import enum
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from esair.loop import Owner, current_task_of
from esair.messages import BehaviorState

REQUESTS_PER_TARGET = 64  # how many requests to one behavior may wait at a time


class Outcome(enum.Enum):
    """How a request ended. Each ends in exactly one way."""

    DELIVERED = "delivered"
    ANSWERED = "answered"
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


class Link:
    """A request that somebody waits for, as a link in the chain of those who wait.

    Attributes:
        asker: Who waits for its outcome.
        peer: Whom for.
        task: The task that waits.
        parent: The request that the asker served when it made this one.
        outer: The request that the peer served already when it took this one.
        over: Whether it has its outcome.
    """

    if TYPE_CHECKING:

        @property
        def over(self) -> bool: ...

    def __init__(self, asker: str, peer: str) -> None:
        self.asker = asker
        self.peer = peer
        self.task = current_task_of(asyncio.get_running_loop())
        self.parent = served()
        self.outer: Link | None = None


serving: contextvars.ContextVar[Link | None] = contextvars.ContextVar(
    "esair_serving", default=None
)
"""The request that the code that runs now was begun for."""


def served() -> Link | None:
    """Return the request that is being served by the code that runs now."""
    link = serving.get()
    while link is not None and link.over:
        link = link.outer
    return link


def chain() -> Iterator[Link]:
    """Yield the requests that wait for the code that runs now, the nearest first."""
    link = served()
    while link is not None and not link.over:
        yield link
        link = link.parent


class Peer(Protocol):
    """A behavior, as requests between behaviors know it."""

    name: str
    action: Any
    owner: Owner
    asked: dict[Any, None]

    @property
    def state(self) -> BehaviorState: ...
    @property
    def serves(self) -> Link | None: ...
    @property
    def can_provide(self) -> bool: ...
    def check_speaker(self) -> None: ...
    def run_tasks(self) -> list[asyncio.Task[Any]]: ...


class Request(Link):
    """A put or a get that waits for the other side."""

    def __init__(
        self,
        kind: str,
        sender: str,
        receiver: str,
        data: Any,
        future: asyncio.Future[Any],
        by: Peer | None = None,
    ) -> None:
        if kind == "put":
            super().__init__(sender, receiver)
        else:
            super().__init__(receiver, sender)
        self.kind = kind
        self.sender = sender
        self.receiver = receiver
        self.data = data
        self.future = future
        self.by = by
        """The behavior that made it, unless the user did."""
        self.provider: asyncio.Task[Any] | None = None
        self.offered = False
        """It was answered with something that is there once only."""

    @property
    def over(self) -> bool:
        """Whether it has its outcome."""
        return self.future.done()


class FairQueue:
    """Waiting requests, one queue for each sender; they take turns."""

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
        requests = [request for queue in self._queues.values() for request in queue]
        self._queues.clear()
        self.count = 0
        return requests
