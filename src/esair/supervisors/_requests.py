"""Requests between behaviors: each ends once, and the ledger says how.

A put and a get wait until the other can; an `ask`, an order, is answered by who has taken it.
"""

from __future__ import annotations

import asyncio
import collections
import concurrent.futures
import contextvars
import enum
import functools
import inspect
import logging
import weakref
from collections.abc import AsyncIterator, Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

from esair.actions import Request as Asked
from esair.actions import Takes, answer_type, taken
from esair.exceptions import (
    BadValueError,
    BehaviorFailedError,
    BehaviorRemovedError,
    BehaviorUnavailableError,
    BusyError,
    CircularRequestError,
    EsairError,
    OutcomeUnknownError,
    ProcessDiedError,
    RefusedError,
    describe,
)
from esair.journal import Kind
from esair.loop import (
    Deadline,
    Deadlines,
    Portal,
    current_task_of,
    portal,
    spawn,
    wake,
    wake_one,
)
from esair.messages import BehaviorState
from esair.values import fits, type_name

if TYPE_CHECKING:
    from esair.supervisors._mediator import Mailbox, Mediator

_log = logging.getLogger("esair")


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
    NOT_KNOWN = "not known"


class Record(NamedTuple):
    """One line of the ledger: who asked what of whom, and how it ended."""

    kind: str
    sender: str
    receiver: str
    outcome: Outcome


REQUESTS_PER_TARGET = 64  # how many puts, or gets, to one behavior may wait at a time

_NO_NEWS: Any = object()

_WANTED = {"put": "receive", "get": "send", "ask": "answer"}
"""What the other side could not do within the time of a request."""


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
        loop: Where that runs.
        parent: The request that the asker served when it made this one.
        outer: The request that the peer served already when it took this one.
        how: Its outcome, when it has one.
        cancelled: Whether that came from elsewhere than from who works on it.
    """

    # Of most requests most of these stay as they are.
    cancelled: bool = False
    waits: bool = False
    how: Outcome | None = None
    value: Any = None
    _error: EsairError | None = None
    _wake: asyncio.Future[None] | None = None
    deadline: Deadline | None = None
    outer: Request | None = None
    crossed: int | None = None  # the number under which another robot is asked for it
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
        queue: RequestQueue,
        by: Mailbox | None,
    ) -> None:
        self.kind = kind
        self.data = data
        self.asker = asker
        self.peer: str = queue.member.name
        self.queue = queue
        self.by = by
        self._mediator: Mediator = queue.member.mediator
        self.loop: asyncio.AbstractEventLoop = asyncio.get_running_loop()
        self.task: Any | None = current_task_of(self.loop)
        self.parent: Request | None = served()

    @property
    def over(self) -> bool:
        """Whether it has its outcome."""
        return self.how is not None

    # What the asker does.

    async def outcome(self, progress: Callable[[Any], object] | None = None) -> Any:
        """Wait for the outcome; who is cancelled here withdraws it."""
        try:
            while self.how is None:
                self._wake = self.loop.create_future()
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
        if self.how is not None:
            return False
        self.how, self.value, self._error = outcome, value, error
        if self.waits:
            self.queue.forget(self)
        if self.deadline is not None:
            self.deadline.cancel()
            self.deadline = None  # it knows this request: a circle for the collector
        ledger = self._mediator
        ledger.ended(self)
        if self.kind != "get":
            ledger.record(self.kind, self.asker, self.peer, outcome, value)
        elif outcome is not Outcome.DELIVERED:
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
        wanted, member = _WANTED[self.kind], self.queue.member
        state = member.state.value
        if member.state is BehaviorState.RUNNING:
            state = getattr(member.action, "doing_there", state)
        late = BehaviorUnavailableError(self.peer, wanted, interval, state)
        self.withdraw(Outcome.TIMED_OUT, error=late)

    def fail(self, detail: str, cause: BaseException | None = None) -> None:
        """Whoever worked on it gives it no answer any more."""
        if isinstance(cause, OutcomeUnknownError):
            self.end(Outcome.NOT_KNOWN, error=cause)
            return
        of_peer = (BehaviorFailedError, BehaviorRemovedError)
        if isinstance(cause, of_peer) and cause.behavior == self.peer:
            failed = isinstance(cause, BehaviorFailedError)  # it says so of itself
            self.end(
                Outcome.PEER_FAILED if failed else Outcome.PEER_REMOVED, error=cause
            )
            return
        error = BehaviorFailedError(self.peer, detail)
        error.__cause__ = cause
        self.end(Outcome.PEER_FAILED, error=error)

    # Who works on it.

    def served(self, value: Any, error: BaseException | None) -> None:
        """A method of the peer has returned, or raised."""
        if self.over:
            self._mediator.late_answers += error is None
        elif error is None:
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
            self._begins = self.loop.call_soon(self._cancel_worker)
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


_NOBODY: dict[str, collections.deque[Request]] = {}  # of all where nothing waits


class RequestQueue:
    """Requests of one kind that wait for a behavior; those who ask take turns.

    With a method of the behavior that serves them, it does so one at a time, in tasks of
    their own.
    """

    # Slots: each behavior and reaction has some of these.
    __slots__ = ("_waiting", "count", "current", "member", "method")

    limit = REQUESTS_PER_TARGET
    bound = "number of requests to it"  # what the limit is of
    outlives = False  # whether what waits outlives a run of the behavior that fails
    working: Mapping[Request, None] = {}  # what was taken, and has no outcome

    def __init__(self, member: Mailbox, method: str | None = None) -> None:
        self.member: Mailbox = member
        self.method: str | None = method
        self._waiting: dict[str, collections.deque[Request]] = _NOBODY
        self.count: int = 0
        self.current: Request | None = None  # what its task is for

    def __iter__(self) -> Iterator[Request]:
        return iter([each for queue in self._waiting.values() for each in queue])

    def push(self, request: Request) -> None:
        """Let a request wait for its turn, behind those of the same asker."""
        if self.count >= self.limit:
            self.member.turned_away += 1
            raise BusyError(self.member.name, self.bound, self.limit)
        self._add(request)

    def _add(self, request: Request) -> None:
        if not self._waiting:
            self._waiting = {}
        self._waiting.setdefault(request.asker, collections.deque()).append(request)
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
        other.current = None

    def end_all(self, outcome: Outcome, error: Callable[[Request], EsairError]) -> None:
        """End what waits and what is worked on."""
        waiting = self if self.count else ()
        for request in (*self.working, *waiting):
            request.withdraw(outcome, error=error(request))

    # By a method.

    @property
    def can_serve(self) -> bool:
        """Whether the behavior makes an answer on demand, now."""
        return self.member.can_provide

    def roused(self) -> None:
        """Begin to work on what waits, if somebody is free."""
        member, request = self.member, self.first()
        if (
            self.method is None
            or self.current is not None
            or request is None
            or not self.can_serve
        ):
            return
        self.current = request
        self.begun(request)
        request.worker = task = spawn(
            asyncio.get_running_loop(),
            do_for(request, member, self.method),
            name=f"{member.name} {self.method}",
            owner=member.owner,
        )
        # Not in the task itself: one that is cancelled before its first step does
        # nothing at all.
        task.add_done_callback(functools.partial(self._served, request))

    def _served(self, request: Request, task: asyncio.Task[Done]) -> None:
        is_mine = self.current is request
        if is_mine:
            self.current = None
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

    def run_ended(self, error: BaseException | None) -> None:
        """A run has ended: nobody works on what it had taken."""
        for request in (*self.working, self.current):
            if request is not None:
                told = describe(error) if error else "its run ended without an answer"
                is_there = hasattr(self.member.action, "doing_there")
                unknown = OutcomeUnknownError(self.member.name, told)
                request.fail(told, unknown if is_there else error)
        self.current = None


Done = tuple[Any, BaseException | None]


async def do_for(request: Request, member: Mailbox, method: str) -> Done:
    """Have a behavior do something for a request; what it raises is returned.

    A plain function gets a thread of its own.
    """
    serving.set(request)
    try:
        function = getattr(member.action, method)
        if inspect.iscoroutinefunction(function):
            return await function(*request.handed), None
        portal = Portal(f"{member.name}_{method}", member.owner)
        return await portal.run(function, *request.handed), None
    except BaseException as error:  # contained: it is the other's code
        return None, error


class Order(Request):
    """A request that is answered, by who has taken it, in whatever thread."""

    queue: OrderQueue

    def __init__(
        self, data: Asked[Any], asker: str, queue: OrderQueue, by: Mailbox | None
    ) -> None:
        super().__init__("ask", data, asker, queue, by)
        self.handed = (taken(data, self),)
        self._before = 0

    @property
    def sender(self) -> str:
        return self.asker

    # What whoever works on it does, in whatever thread.

    def answer(self, value: Any) -> bool:
        return self._in_loop(self._answer, value)

    def refuse(self, reason: str) -> bool:
        return self._in_loop(self._refuse, str(reason))

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

    def serve(self) -> None:
        """What is done here from now on is done for it."""
        serving.set(self)

    def leave(self, error: BaseException | None) -> bool:
        """The block is left; tells whether its error ends here."""
        if _is_elsewhere(self.loop):
            return self._in_loop(self._left, error)
        mine = False
        if self._begins is not None:
            self._begins.cancel()
        worker, self.worker = self.worker, None
        if self._cancels:
            # Only what the withdrawal did is undone: who is removed meanwhile ends.
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

    def _check_fits(self, verb: str, value: Any) -> None:
        if self.by is not None and not self.over:
            self.by.check_fits(verb, value)

    def _answer(self, value: Any) -> bool:
        self._check_fits("answer", value)
        wanted = answer_type(type(self.data))
        if not self.over and not fits(value, wanted):
            told = f"expected {type_name(wanted)}, not {value!r:.80}"
            raise BadValueError(self.peer, "answer", told)
        return self.end(Outcome.ANSWERED, value) or self._mediator.late()

    def _refuse(self, reason: str) -> bool:
        refused = RefusedError(reason, self.peer)
        return self.end(Outcome.REFUSED, error=refused) or self._mediator.late()

    def _progress(self, value: Any) -> bool:
        if self.over:
            return self._mediator.late()
        self._check_fits("progress", value)
        self._news = value
        wake(self._wake)
        return True

    def served(self, value: Any, error: BaseException | None) -> None:
        if error is None:
            if not self.over or self.cancelled:
                try:
                    self.answer(value)  # counted, if nobody waits any more
                except BadValueError as unfit:
                    self.fail(describe(unfit), unfit)
        elif isinstance(error, RefusedError) and not error.behavior:
            self.refuse(error.reason)
        else:
            told = asyncio.CancelledError | ProcessDiedError  # by its end, its crash
            if self.over and not isinstance(error, told):
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
        journal = self._mediator.journal
        if ended and journal.heard.answered:
            came = value if error is None else error
            journal.publish(Kind.ANSWERED, self.peer, self.asker, came, outcome.value)
        return ended

    def _in_loop(self, function: Callable[[Any], bool], value: Any) -> bool:
        if not _is_elsewhere(self.loop):
            return function(value)
        way = portal.get(None)
        if way is not None and way.loop is self.loop:
            # By the door: a recording repeats when it was said.
            async def say() -> bool:
                return function(value)

            try:
                return way.call(say)
            except BehaviorRemovedError:
                return False
        told: concurrent.futures.Future[bool] = concurrent.futures.Future()

        def do() -> None:
            try:
                told.set_result(function(value))
            except Exception as error:  # whoever has called it gets it
                told.set_exception(error)

        try:
            self.loop.call_soon_threadsafe(do)
        except RuntimeError:  # the loop is closed: nobody waits any more
            return False
        return told.result()


class OrderQueue(RequestQueue):
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

    def put_back(self, order: Order) -> None:
        """Let one that nobody has seen wait again, before all others."""
        self.done_with(order)
        if not order.over:
            others = self._waiting.pop(order.asker, ())
            queue = collections.deque([order, *others])
            self._waiting = {order.asker: queue, **self._waiting}
            order.waits, order.outer = True, None
            self.count += 1
            self.roused()

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

    # In a loop of the behavior.

    def loop(self) -> Loop:
        """Begin a loop over the requests."""
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
            await wait_among(self._takers)


async def wait_among(
    takers: list[asyncio.Future[None]], deadline: float | None = None
) -> None:
    """Wait, until a moment, with others of whom one is woken for what has come."""
    loop = asyncio.get_running_loop()
    taker = loop.create_future()
    takers.append(taker)
    try:
        if deadline is None:
            await taker
        else:
            await Deadlines.of(loop).pulse(taker, deadline - loop.time())
    except asyncio.CancelledError:
        if not taker.cancelled():
            wake_one(takers)  # it was woken in the same tick: wake the next one
        raise
    finally:
        takers.remove(taker)


class Loop(AsyncIterator[Any]):
    """One loop of a behavior over the requests that it takes."""

    # No generator: one that is left is closed late, by the collector.
    def __init__(self, queue: OrderQueue) -> None:
        self._queue = queue
        self.current: Order | None = None

    async def __anext__(self) -> Asked[Any]:
        """Wait for the next request."""
        before, self.current = self.current, None
        if before is not None:
            before.fail("it went on to the next request without an answer")
            self._queue.done_with(before)
        self.current = order = await self._queue.next()
        order.serve()
        asked: Asked[Any] = order.handed[0]
        return asked

    def put_back(self) -> None:
        """The request that was taken last did not reach who has taken it."""
        order, self.current = self.current, None
        if order is not None:
            serving.set(None)
            self._queue.put_back(order)


def _is_elsewhere(loop: asyncio.AbstractEventLoop) -> bool:
    return asyncio._get_running_loop() is not loop  # noqa: SLF001 - it does not raise
