"""Orders: what becomes of an `ask`, and who works on it."""

from __future__ import annotations

import asyncio
import logging
import threading
import weakref
from collections.abc import AsyncIterator, Callable
from typing import TYPE_CHECKING, Any

from esair.actions import Request as Asked
from esair.actions import Takes, taken
from esair.exceptions import EsairError, RefusedError, describe
from esair.journal import Kind
from esair.loop import wake, wake_one
from esair.messages import BehaviorState
from esair.supervisors._ledger import Ledger, Outcome
from esair.supervisors._requests import Request, ServedQueue, served, serving

if TYPE_CHECKING:
    from esair.supervisors._mailbox import Mailbox

_log = logging.getLogger("esair")


class Order(Request):
    """A request that is answered, by who has taken it, in whatever thread."""

    queue: OrderQueue

    def __init__(
        self,
        data: Asked[Any],
        asker: str,
        queue: OrderQueue,
        by: Mailbox | None,
        ledger: Ledger,
    ) -> None:
        super().__init__("ask", data, asker, queue, by, ledger)
        self.handed = (taken(data, self),)
        self._before = 0

    @property
    def sender(self) -> str:
        return self.asker

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
        self.worker = task
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
        worker, self.worker = self.worker, None
        if self._cancels:
            # Only what the withdrawal did is undone: who is removed meanwhile ends.
            self._cancels = False
            assert worker is not None
            undone = worker.uncancel() <= self._before
            mine = undone and isinstance(error, asyncio.CancelledError)
        self._left(error)
        return mine

    def _left(self, error: BaseException | None) -> bool:
        told = describe(error) if error else "it left the request without an answer"
        self.fail(told, error)
        self.queue.done_with(self)
        return False

    def _answer(self, value: Any) -> bool:
        return self.end(Outcome.ANSWERED, value) or self._ledger.late()

    def _refuse(self, reason: str) -> bool:
        refused = RefusedError(str(reason), self.peer)
        return self.end(Outcome.REFUSED, error=refused) or self._ledger.late()

    def _progress(self, value: Any) -> bool:
        if self.over:
            return self._ledger.late()
        self._news = value
        wake(self._wake)
        return True

    def served(self, value: Any, error: BaseException | None) -> None:
        if error is None:
            if not self.over or self.cancelled:
                self.answer(value)  # counted, if nobody waits any more
        elif isinstance(error, RefusedError) and not error.behavior:
            self.refuse(error.reason)
        else:
            if self.over and not isinstance(error, asyncio.CancelledError):
                _log.warning(
                    "%s: %s failed when nobody waited any more: %s",
                    self.peer,
                    self.queue.method,
                    describe(error),
                )
            self.fail(describe(error), error)

    def end(
        self, outcome: Outcome, value: Any = None, error: EsairError | None = None
    ) -> bool:
        ended = super().end(outcome, value, error)
        journal = self._ledger.journal
        if ended and journal.heard.answered:
            came = value if error is None else error
            journal.publish(Kind.ANSWERED, self.peer, self.asker, came, outcome.value)
        return ended

    def _in_loop(self, function: Callable[[Any], bool], value: Any) -> bool:
        if not _is_elsewhere(self._loop):
            return function(value)
        outcome: list[bool] = []
        ready = threading.Event()

        def call() -> None:
            try:
                outcome.append(function(value))
            finally:
                ready.set()

        try:
            self._loop.call_soon_threadsafe(call)
        except RuntimeError:  # the loop is closed: nobody waits any more
            return False
        ready.wait()
        return outcome[0]


class OrderQueue(ServedQueue):
    """The orders of one type for one behavior; it is the source of its port.

    Orders that wait outlive a run of the behavior; those that are worked on do not.
    """

    outlives = True

    def __init__(self, member: Mailbox, terms: Takes[Any]) -> None:
        super().__init__(member, terms.method)
        self.limit = terms.queue
        self.bound = f"queue of {terms.type.__name__}"
        self._newest = terms.newest
        self.working: dict[Request, None] = {}
        self._takers: list[asyncio.Future[None]] = []
        self._loops: weakref.WeakSet[Loop] = weakref.WeakSet()

    def busy(self) -> list[Request | None]:
        """Return what each of those who take these requests works on, or None."""
        if self.method is not None:
            return [self.current]
        return [loop.current for loop in self._loops]

    def push(self, request: Request) -> None:
        if self._newest:
            reason, name = f"superseded by {request.asker}", self.member.name
            self.end_all(Outcome.REFUSED, lambda _: RefusedError(reason, name))
        super().push(request)

    def roused(self) -> None:
        if self.count:
            wake_one(self._takers)
        super().roused()

    @property
    def can_serve(self) -> bool:
        return self.member.state is BehaviorState.RUNNING

    def begun(self, request: Request) -> None:
        self.pop()
        self.working[request] = None

    def done_with(self, request: Request) -> None:
        self.working.pop(request, None)

    def run_ended(self, error: BaseException | None) -> None:
        super().run_ended(error)
        self.working.clear()
        self._loops.clear()
        wake(*self._takers)
        self._takers.clear()

    # In a loop of the behavior.

    def loop(self) -> Loop:
        """Begin a loop over the requests (`RequestSource`)."""
        loop = Loop(self)
        self._loops.add(loop)
        return loop

    async def next(self) -> Order:
        """Wait for an order, and take it."""
        while True:
            self.member.check_speaker()
            order = self.first()
            if isinstance(order, Order):
                self.begun(order)
                order.outer = served()
                return order
            taker = asyncio.get_running_loop().create_future()
            self._takers.append(taker)
            try:
                await taker
            except asyncio.CancelledError:
                if self.count and not taker.cancelled():
                    wake_one(self._takers)  # woken in the same tick: wake the next one
                raise
            finally:
                if taker in self._takers:
                    self._takers.remove(taker)


class Loop(AsyncIterator[Any]):
    """One loop of a behavior over the requests that it takes (`RequestLoop`)."""

    # No generator: one that is left is closed late, by the collector.
    def __init__(self, queue: OrderQueue) -> None:
        self._queue = queue
        self.current: Order | None = None

    async def __anext__(self) -> Asked[Any]:
        request = await self.next()
        self.serve()
        return request

    async def next(self) -> Asked[Any]:
        """Wait for the next request."""
        before, self.current = self.current, None
        if before is not None:
            before.fail("it went on to the next request without an answer")
            self._queue.done_with(before)
        self.current = await self._queue.next()
        asked: Asked[Any] = self.current.handed[0]
        return asked

    def serve(self) -> None:
        """What the caller does from now on, it does for this request."""
        serving.set(self.current)


def _is_elsewhere(loop: asyncio.AbstractEventLoop) -> bool:
    return asyncio._get_running_loop() is not loop  # noqa: SLF001 - it does not raise
