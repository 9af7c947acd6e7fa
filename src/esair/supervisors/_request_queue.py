"""The requests of one type that wait for a behavior, and who works on them."""

from __future__ import annotations

import asyncio
import collections
import functools
import inspect
import logging
import weakref
from typing import Any

from esair.actions import Answers, Request, Takes
from esair.exceptions import BehaviorFailedError, BusyError, RefusedError, describe
from esair.loop import Portal, spawn, wake, wake_one
from esair.messages import BehaviorState
from esair.supervisors._orders import Order
from esair.supervisors._requests import Link, Outcome, Peer, served, serving

_log = logging.getLogger("esair")


class RequestQueue:
    """Holds the orders of one type for one behavior; it is the source of its port.

    Orders that wait outlive a run of the behavior; those that are worked on do not.
    """

    def __init__(self, member: Peer, terms: Takes[Any] | Answers) -> None:
        self.member = member
        self.type: type[Request[Any]] = terms.type
        self.limit = terms.queue
        self.newest = terms.newest
        self.method = terms.method if isinstance(terms, Answers) else None
        self.waiting: collections.deque[Order] = collections.deque()
        self.working: dict[Order, None] = {}
        self._takers: list[asyncio.Future[None]] = []
        self._loops: weakref.WeakSet[Loop] = weakref.WeakSet()
        self._task: asyncio.Task[Any] | None = None
        self._current: Order | None = None

    def busy(self) -> list[Order | None]:
        """Return what each of those who take these requests works on, or None."""
        if self.method is not None:
            return [self._current]
        return [loop.current for loop in self._loops]

    def push(self, order: Order) -> None:
        """Let an order wait for its turn."""
        if self.newest:
            for other in (*self.working, *self.waiting):
                reason = f"superseded by {order.asker}"
                other.withdraw(Outcome.REFUSED, RefusedError(reason, self.member.name))
        if len(self.waiting) >= self.limit:
            raise BusyError(
                self.member.name, f"queue of {self.type.__name__}", self.limit
            )
        self.waiting.append(order)

    def roused(self) -> None:
        """Begin to work on what waits, if somebody is free."""
        self._wake()
        self._serve()

    def forget(self, order: Order) -> None:
        """An order has its outcome: it waits no more."""
        if order in self.waiting:
            self.waiting.remove(order)

    def done_with(self, order: Order) -> None:
        """Nobody works on an order any more."""
        self.working.pop(order, None)

    def _take(self) -> Order:
        order = self.waiting.popleft()
        order.outer = served()
        self.working[order] = None
        return order

    # In a loop of the behavior.

    def loop(self) -> Loop:
        """Begin a loop over the requests (`RequestSource`)."""
        loop = Loop(self)
        self._loops.add(loop)
        return loop

    async def take(self) -> Order:
        while True:
            self.member.check_speaker()
            if self.waiting:
                return self._take()
            taker = asyncio.get_running_loop().create_future()
            self._takers.append(taker)
            try:
                await taker
            except asyncio.CancelledError:
                if not taker.cancelled():
                    self._wake()  # it was woken in the same tick: wake the next one
                raise
            finally:
                if taker in self._takers:
                    self._takers.remove(taker)

    def _wake(self) -> None:
        if self.waiting:
            wake_one(self._takers)

    # In a method of the behavior.

    def _serve(self) -> None:
        member = self.member
        if (
            self.method is None
            or self._task is not None
            or not self.waiting
            or member.state is not BehaviorState.RUNNING
        ):
            return
        order = self._current = self._take()
        self._task = spawn(
            asyncio.get_running_loop(),
            do_for(order, member, self.method, order.handle),
            name=f"{member.name} {self.method}",
            owner=member.owner,
        )
        order.works(self._task)
        self._task.add_done_callback(functools.partial(self._served, order))

    def _served(self, order: Order, task: asyncio.Task[Done]) -> None:
        if self._task is task:
            self._task = self._current = None
        self.working.pop(order, None)
        value, error = done_by(task)
        if error is None:
            if not order.over or order.cancelled:
                order.answer(value)  # counted, if nobody waits any more
        elif isinstance(error, RefusedError) and not error.behavior:
            order.refuse(error.reason)
        else:
            if order.over and not isinstance(error, asyncio.CancelledError):
                _log.warning(
                    "%s: %s failed when nobody waited any more: %s",
                    self.member.name,
                    self.method,
                    describe(error),
                )
            order.fail(describe(error), error)
        self._serve()

    # What happens to the behavior.

    def run_ended(self, error: BaseException | None) -> None:
        """A run has ended: nobody works on what it had taken."""
        for order in tuple(self.working):
            if error is None:
                order.fail("its run ended without an answer")
            else:
                order.fail(describe(error), error)
        self.working.clear()
        self._loops.clear()
        self._task = self._current = None
        wake(*self._takers)
        self._takers.clear()

    def fail_all(self, detail: str, error: BaseException | None) -> None:
        """It will never take what waits."""
        for order in tuple(self.waiting):
            order.fail(detail, error)

    def refuse_all(self, reason: str) -> None:
        for order in tuple(self.waiting):
            error = RefusedError(reason, self.member.name)
            order.withdraw(Outcome.REFUSED, error)

    def adopt(self, other: RequestQueue) -> None:
        """Take over what waits for a behavior whose place this one takes."""
        while other.waiting:
            order = other.waiting.popleft()
            order.queue = self
            self.waiting.append(order)
        self.roused()

    def end_all(self, outcome: Outcome, error: Any) -> None:
        for order in (*self.waiting, *self.working):
            order.withdraw(outcome, error())

    def failure(self) -> BehaviorFailedError | None:
        """Return why it will never take another request; None if it may."""
        member = self.member
        if member.state is BehaviorState.FINISHED:
            return BehaviorFailedError(member.name, "its run has ended")
        return None


class Loop:
    """One loop of a behavior over the requests that it takes (`RequestLoop`)."""

    def __init__(self, queue: RequestQueue) -> None:
        self._queue = queue
        self.current: Order | None = None

    async def next(self) -> Request[Any]:
        """Wait for the next request."""
        before, self.current = self.current, None
        if before is not None:
            before.fail("it went on to the next request without an answer")
            self._queue.done_with(before)
        self.current = await self._queue.take()
        return self.current.handle

    def serve(self) -> None:
        """What the caller does from now on, it does for this request."""
        serving.set(self.current)


Done = tuple[Any, BaseException | None]


async def do_for(link: Link, member: Peer, method: str, *args: Any) -> Done:
    """Have a behavior do something for a request; what it raises is returned.

    A plain function gets a thread of its own.
    """
    serving.set(link)
    try:
        function = getattr(member.action, method)
        if inspect.iscoroutinefunction(function):
            return await function(*args), None
        result: list[Any] = []
        portal = Portal(f"{member.name}_{method}", member.owner)
        await portal.run(lambda: result.append(function(*args)))
        return result[0], None
    except BaseException as error:  # contained: it is the other's code
        return None, error


def done_by(task: asyncio.Task[Done]) -> Done:
    """Return what has come of it; it may have been cancelled before its first step."""
    return (None, asyncio.CancelledError()) if task.cancelled() else task.result()
