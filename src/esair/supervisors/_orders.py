"""Orders: what becomes of an `ask`, from its asker to its one outcome."""

from __future__ import annotations

import asyncio
import inspect
import threading
from collections.abc import Callable
from typing import Any, Protocol

from esair.actions import Request, taken
from esair.exceptions import BehaviorFailedError, EsairError, RefusedError, describe
from esair.loop import Deadline, wake
from esair.supervisors._requests import Link, Outcome, Peer

_NOTHING: Any = object()


class Place(Protocol):
    """Where an order waits for a behavior, and is worked on."""

    @property
    def member(self) -> Peer: ...
    def done_with(self, order: Order) -> None: ...
    def forget(self, order: Order) -> None: ...


class Outcomes(Protocol):
    """Who is told how orders end."""

    def late(self) -> bool: ...
    def ended(self, order: Order, outcome: Outcome, value: object) -> None: ...


class Order(Link):
    """One request of one behavior to another: it ends once, whoever ends it.

    Attributes:
        data: What was asked.
        queue: Where it waits, and who works on it.
        cancelled: Whether the outcome came from elsewhere than from who works on it.
    """

    def __init__(
        self,
        asks: Outcomes,
        data: Request[Any],
        sender: str,
        queue: Place,
        by: Peer | None,
    ) -> None:
        super().__init__(sender, queue.member.name)
        self._asks = asks
        self._loop = asyncio.get_running_loop()
        self.data = data
        self.handle = taken(data, self)
        self.queue = queue
        self.by = by
        self._over = False
        self.cancelled = False
        self.deadline: Deadline | None = None
        self._value: Any = None
        self._error: EsairError | None = None
        self._news: Any = _NOTHING
        self._wake: asyncio.Future[None] | None = None
        self._worker: asyncio.Task[Any] | None = None
        self._before = 0
        self._cancels = False
        self._begins: asyncio.Handle | None = None

    @property
    def over(self) -> bool:
        return self._over

    @property
    def sender(self) -> str:
        return self.asker

    # What the asker does.

    async def outcome(self, progress: Callable[[Any], object] | None) -> Any:
        while not self.over:
            self._wake = self._loop.create_future()
            await self._wake
            while self._news is not _NOTHING and progress is not None:
                news, self._news = self._news, _NOTHING
                told = progress(news)
                if inspect.isawaitable(told):
                    await told
        if self._error is not None:
            raise self._error
        return self._value

    # What whoever works on it does, in whatever thread.

    def answer(self, value: Any) -> bool:
        return self._in_loop(self._answer, value)

    def refuse(self, reason: str) -> bool:
        return self._in_loop(self._refuse, reason)

    def progress(self, value: Any) -> bool:
        return self._in_loop(self._progress, value)

    def enter(self) -> None:
        """Somebody begins to work on it, in a block of its own."""
        try:
            task = asyncio.current_task()
        except RuntimeError:
            return  # a thread: nobody can cancel what it does
        assert task is not None
        self._worker = task
        self._before = task.cancelling()
        if self.cancelled:
            self._cancel_worker()

    def leave(self, error: BaseException | None) -> bool:
        """The block is left; tells whether its error ends here."""
        if _is_elsewhere(self._loop):
            return self._in_loop(self._left, error)
        mine = False
        if self._begins is not None:
            self._begins.cancel()
            self._begins = None
        worker, self._worker = self._worker, None
        if self._cancels:
            # Only what the withdrawal did is undone: who is removed meanwhile ends.
            self._cancels = False
            assert worker is not None
            undone = worker.uncancel() <= self._before
            mine = undone and isinstance(error, asyncio.CancelledError)
        self._left(error)
        return mine

    def _left(self, error: BaseException | None) -> bool:
        if error is None:
            self.fail("it left the request without an answer")
        else:
            self.fail(describe(error), error)
        self.queue.done_with(self)
        return False

    def _answer(self, value: Any) -> bool:
        return self._told(Outcome.ANSWERED, value, None)

    def _refuse(self, reason: str) -> bool:
        return self._told(Outcome.REFUSED, None, RefusedError(str(reason), self.peer))

    def _progress(self, value: Any) -> bool:
        if self.over:
            return self._asks.late()
        self._news = value
        self._rouse()
        return True

    def _told(self, outcome: Outcome, value: Any, error: EsairError | None) -> bool:
        return self._end(outcome, value, error) or self._asks.late()

    def fail(self, detail: str, cause: BaseException | None = None) -> None:
        """Whoever worked on it gives it no answer any more."""
        error = BehaviorFailedError(self.peer, detail)
        error.__cause__ = cause
        self._end(Outcome.PEER_FAILED, None, error)

    # What ends it from elsewhere.

    def withdraw(self, outcome: Outcome, error: EsairError | None) -> None:
        """End it from elsewhere; the work on it, if there is any, is cancelled once."""
        if self._end(outcome, None, error):
            self.cancelled = True
            self._cancel_worker()

    def _end(self, outcome: Outcome, value: Any, error: EsairError | None) -> bool:
        if self.over:
            return False
        self._over = True
        self.parent = None  # nobody waits through it any more
        self._value = value
        self._error = error
        self.queue.forget(self)
        self._asks.ended(self, outcome, value if error is None else error)
        self._rouse()
        return True

    def _rouse(self) -> None:
        wake(self._wake)

    def works(self, task: asyncio.Task[Any]) -> None:
        self._worker = task
        task.add_done_callback(self._rests)

    def _rests(self, task: asyncio.Task[Any]) -> None:
        if self._worker is task:
            self._worker = None

    def _cancel_worker(self) -> None:
        self._begins = None
        worker = self._worker
        if worker is None or self._cancels:
            return
        if worker is asyncio.current_task():
            # It did this itself, and must not be hit where it does not wait.
            self._begins = self._loop.call_soon(self._cancel_worker)
            return
        self._cancels = True
        worker.cancel()

    def _in_loop(self, function: Callable[[Any], bool], value: Any) -> bool:
        if not _is_elsewhere(self._loop):
            return function(value)
        outcome = [False]
        ready = threading.Event()

        def call() -> None:
            try:
                outcome[0] = function(value)
            finally:
                ready.set()

        try:
            self._loop.call_soon_threadsafe(call)
        except RuntimeError:  # the loop is closed: nobody waits any more
            return False
        ready.wait()
        return outcome[0]


def _is_elsewhere(loop: asyncio.AbstractEventLoop) -> bool:
    return asyncio._get_running_loop() is not loop  # noqa: SLF001 - it does not raise
