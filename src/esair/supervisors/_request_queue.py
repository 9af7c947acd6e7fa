"""Where requests wait for a behavior, and who answers them."""

from __future__ import annotations

import asyncio
import collections
import functools
import inspect
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from esair.exceptions import BusyError, EsairError, describe
from esair.loop import Portal, spawn
from esair.supervisors._ledger import Outcome
from esair.supervisors._requests import Peer, Request, serving

REQUESTS_PER_TARGET = 64  # how many puts, or gets, to one behavior may wait at a time


class RequestQueue:
    """Requests of one kind that wait for a behavior; those who ask take turns."""

    # Slots: each behavior and reaction has some of these.
    __slots__ = ("_waiting", "count", "member")

    limit = REQUESTS_PER_TARGET
    bound = "number of requests to it"  # what the limit is of
    outlives = False  # whether what waits outlives a run of the behavior that fails
    working: Mapping[Request, None] = {}  # what was taken, and has no outcome

    def __init__(self, member: Peer) -> None:
        self.member = member
        self._waiting: dict[str, collections.deque[Request]] = {}
        self.count = 0

    def __iter__(self) -> Iterator[Request]:
        return iter([each for queue in self._waiting.values() for each in queue])

    def push(self, request: Request) -> None:
        """Let a request wait for its turn, behind those of the same asker."""
        if self.count >= self.limit:
            raise BusyError(self.member.name, self.bound, self.limit)
        self._add(request)

    def _add(self, request: Request) -> None:
        queue = self._waiting.get(request.asker)
        if queue is None:
            queue = self._waiting[request.asker] = collections.deque()
        queue.append(request)
        request.waits = True
        self.count += 1

    def first(self) -> Request | None:
        """Return whose turn it is, without taking it."""
        return next((queue[0] for queue in self._waiting.values()), None)

    def pop(self) -> Request:
        """Take the one whose turn it is; its asker comes after all the others."""
        asker = next(iter(self._waiting))
        queue = self._waiting.pop(asker)
        request = queue.popleft()
        request.waits = False
        self.count -= 1
        if queue:
            self._waiting[asker] = queue
        return request

    def forget(self, request: Request) -> None:
        """Take out one that waits: it has its outcome."""
        queue = self._waiting[request.asker]
        queue.remove(request)
        request.waits = False
        self.count -= 1
        if not queue:
            del self._waiting[request.asker]

    def adopt(self, other: RequestQueue) -> None:
        """Take over what waits for a behavior whose place this one takes."""
        while other.count:
            request = other.pop()
            request.queue = self
            self._add(request)

    def end_all(self, outcome: Outcome, error: Callable[[Request], EsairError]) -> None:
        """End what waits and what is worked on."""
        for request in (*self.working, *self):
            request.withdraw(outcome, error=error(request))


class ServedQueue(RequestQueue):
    """Requests that a method of the behavior serves, one at a time, in tasks of their own."""

    __slots__ = ("current", "method", "task")

    def __init__(self, member: Peer, method: str | None) -> None:
        super().__init__(member)
        self.method = method
        self.task: asyncio.Task[Done] | None = None
        self.current: Request | None = None  # what the task is for

    @property
    def can_serve(self) -> bool:
        """Whether the behavior makes an answer on demand, now."""
        return self.member.can_provide

    def roused(self) -> None:
        """Begin to work on what waits, if somebody is free."""
        member, request = self.member, self.first()
        if (
            self.method is None
            or self.task is not None
            or request is None
            or not self.can_serve
        ):
            return
        self.current = request
        self.begun(request)
        self.task = spawn(
            asyncio.get_running_loop(),
            do_for(request, member, self.method),
            name=f"{member.name} {self.method}",
            owner=member.owner,
        )
        request.worker = self.task
        # Not in the task itself: one that is cancelled before its first step does
        # nothing at all.
        self.task.add_done_callback(functools.partial(self._served, request))

    def _served(self, request: Request, task: asyncio.Task[Done]) -> None:
        is_mine = self.task is task
        if is_mine:
            self.task = self.current = None
        self.done_with(request)
        value, error = (
            (None, asyncio.CancelledError()) if task.cancelled() else task.result()
        )
        if is_mine or request.over:
            request.served(value, error)
        self.roused()

    def begun(self, request: Request) -> None:
        """Somebody works on a request; it waits on, as an offer may answer it, too."""

    def done_with(self, request: Request) -> None:
        """Nobody works on a request any more."""

    def adopt(self, other: RequestQueue) -> None:
        super().adopt(other)
        assert isinstance(other, ServedQueue)
        other.task = other.current = None

    def run_ended(self, error: BaseException | None) -> None:
        """A run has ended: nobody works on what it had taken."""
        told = describe(error) if error else "its run ended without an answer"
        for request in (*self.working, self.current):
            if request is not None:
                request.fail(told, error)
        self.task = self.current = None


Done = tuple[Any, BaseException | None]


async def do_for(request: Request, member: Peer, method: str) -> Done:
    """Have a behavior do something for a request; what it raises is returned.

    A plain function gets a thread of its own.
    """
    serving.set(request)
    try:
        function = getattr(member.action, method)
        if inspect.iscoroutinefunction(function):
            return await function(*request.handed), None
        result: list[Any] = []
        portal = Portal(f"{member.name}_{method}", member.owner)
        await portal.run(lambda: result.append(function(*request.handed)))
        return result[0], None
    except BaseException as error:  # contained: it is the other's code
        return None, error
