"""A request between behaviors, whatever its kind: it ends once, and is cancelled once."""

from __future__ import annotations

import asyncio
import contextvars
import inspect
from collections.abc import Callable, Iterator
from typing import Any, Protocol

from esair.exceptions import (
    BehaviorFailedError,
    BehaviorUnavailableError,
    CircularRequestError,
    EsairError,
    describe,
)
from esair.loop import Deadline, Owner, current_task_of, wake
from esair.messages import BehaviorState
from esair.supervisors._ledger import Ledger, Outcome

_NO_NEWS: Any = object()

_DELIVERED = Outcome.DELIVERED

_WANTED = {"put": "receive", "get": "send", "ask": "answer"}
"""What the other side could not do within the time of a request."""


class Peer(Protocol):
    """A behavior, as requests to it know it."""

    name: str
    action: Any
    owner: Owner

    @property
    def state(self) -> BehaviorState: ...
    @property
    def serves(self) -> Request | None: ...
    @property
    def can_provide(self) -> bool: ...
    def check_speaker(self) -> None: ...
    def run_tasks(self) -> list[asyncio.Task[Any]]: ...


class Place(Protocol):
    """Where a request waits for a behavior."""

    member: Peer

    def push(self, request: Request) -> None: ...
    def forget(self, request: Request) -> None: ...


class Request:
    """A put, a get or an ask of one behavior to another: it ends once, whoever ends it.

    It is also a link in the chain of those who wait for one another.

    Attributes:
        kind: ``"put"``, ``"get"`` or ``"ask"``.
        data: What is put, or asked.
        asker: Who waits for its outcome.
        peer: Whom for.
        queue: Where it waits, or did.
        waits: Whether it is there.
        by: The behavior that made it, unless the user did.
        task: The task that waits.
        parent: The request that the asker served when it made this one.
        outer: The request that the peer served already when it took this one.
        over: Whether it has its outcome.
        how: What that is.
        cancelled: Whether that came from elsewhere than from who works on it.
        offered: It was answered with something that is there once only.
    """

    # Of most requests most of these stay as they are.
    over = cancelled = offered = waits = False
    how: Outcome | None = None
    value: Any = None
    _error: EsairError | None = None
    _wake: asyncio.Future[None] | None = None
    deadline: Deadline | None = None
    outer: Request | None = None
    handed: tuple[Any, ...] = ()  # what a method of the peer gets that serves it
    _news: Any = _NO_NEWS
    worker: asyncio.Task[Any] | None = None  # who is cancelled with it
    _cancels = False
    _begins: asyncio.Handle | None = None

    def __init__(
        self,
        kind: str,
        data: Any,
        asker: str,
        queue: Place,
        by: Peer | None,
        ledger: Ledger,
    ) -> None:
        self.kind = kind
        self.data = data
        self.asker = asker
        self.peer = queue.member.name
        self.queue = queue
        self.by = by
        self._ledger = ledger
        self._loop = asyncio.get_running_loop()
        self.task = current_task_of(self._loop)
        self.parent = served()

    # What the asker does.

    async def outcome(self, progress: Callable[[Any], object] | None = None) -> Any:
        """Wait for the outcome; who is cancelled here withdraws it."""
        try:
            while not self.over:
                self._wake = self._loop.create_future()
                await self._wake
                while progress is not None and self._news is not _NO_NEWS:
                    news, self._news = self._news, _NO_NEWS
                    told = progress(news)
                    if inspect.isawaitable(told):
                        await told
        except BaseException:
            self.withdraw(Outcome.WITHDRAWN)
            raise
        if self._error is not None:
            raise self._error
        return self.value

    # What ends it.

    def end(
        self, outcome: Outcome, value: Any = None, error: EsairError | None = None
    ) -> bool:
        """Give it its outcome; tells whether it had none yet."""
        if self.over:
            return False
        self.over, self.how, self.value, self._error = True, outcome, value, error
        if self.waits:
            self.queue.forget(self)
        if self.deadline is not None:
            self.deadline.cancel()
            self.deadline = None  # it knows this request: a circle for the collector
        ledger = self._ledger
        ledger.pending.end(self)
        if self.kind != "get":
            ledger.record(self.kind, self.asker, self.peer, outcome, value)
        elif outcome is not _DELIVERED:
            # What is got is delivered when it is taken: until then another may get it.
            ledger.record("get", self.peer, self.asker, outcome)
        wake(self._wake)
        return True

    def withdraw(
        self, outcome: Outcome, value: Any = None, error: EsairError | None = None
    ) -> None:
        """End it from elsewhere; the work on it, if there is any, is cancelled once."""
        if self.end(outcome, value, error):
            self.cancelled = True
            self._cancel_worker()

    def expire(self, interval: float) -> None:
        """Its time is over."""
        wanted, state = _WANTED[self.kind], self.queue.member.state.value
        late = BehaviorUnavailableError(self.peer, wanted, interval, state)
        self.withdraw(Outcome.TIMED_OUT, error=late)

    def fail(self, detail: str, cause: BaseException | None = None) -> None:
        """Whoever worked on it gives it no answer any more."""
        error = BehaviorFailedError(self.peer, detail)
        error.__cause__ = cause
        self.end(Outcome.PEER_FAILED, error=error)

    # Who works on it.

    def served(self, value: Any, error: BaseException | None) -> None:
        """A method of the peer has returned, or raised."""
        if self.over:
            self._ledger.late_answers += error is None
        elif error is None:
            self.offered = True
            self.end(Outcome.DELIVERED, value)
        elif type(error) is CircularRequestError and self.asker in error.path:
            # It waits for itself: told as plainly as to the one that closed the circle.
            circle = CircularRequestError(error.path)
            circle.__cause__ = error
            self.end(Outcome.PEER_FAILED, error=circle)
        else:
            self.fail(describe(error), error)

    def _cancel_worker(self) -> None:
        self._begins = None
        worker = self.worker
        if worker is None or self._cancels:
            return
        if worker is asyncio.current_task():
            # It did this itself, and must not be hit where it does not wait.
            self._begins = self._loop.call_soon(self._cancel_worker)
            return
        self._cancels = True
        worker.cancel()


serving: contextvars.ContextVar[Request | None] = contextvars.ContextVar(
    "esair_serving", default=None
)
"""The request that the code that runs now was begun for."""


def served() -> Request | None:
    """Return the request that is being served by the code that runs now."""
    request = serving.get()
    while request is not None and request.over:
        request = request.outer
    return request


def chain() -> Iterator[Request]:
    """Yield the requests that wait for the code that runs now, the nearest first."""
    request = served()
    while request is not None and not request.over:
        yield request
        request = request.parent
