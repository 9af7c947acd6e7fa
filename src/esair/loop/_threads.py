"""Threads that work for a robot: for blocking calls, and for plain behaviors.

An executor is one worker thread that makes the blocking calls of one bus, in order. A
portal stands between the thread of a plain behavior and the loop. Both hand their results
over by the door, and both know the robot's time.
"""

from __future__ import annotations

import asyncio
import concurrent.futures
import contextvars
import inspect
import math
import queue
import threading
import time
from collections.abc import Callable, Coroutine
from typing import Any, Protocol, TypeVar

import attrs

from esair.exceptions import (
    BehaviorRemovedError,
    BusyError,
    ConfigError,
    DriverStuckError,
    NoTurnError,
)
from esair.loop._deadlines import Deadline, Deadlines
from esair.loop._door import Door, arrive
from esair.loop._light_task import (
    LightTask,
    Turns,
    Urgency,
    look_at,
    raisable,
    settle,
    urgency,
)
from esair.loop._of_loop import clock_beside, clock_of
from esair.loop._ownership import Owner, spawn
from esair.loop._scheduler import REACHED

_thread = threading.local()


def works_for(loop: asyncio.AbstractEventLoop) -> None:
    """Say, in a thread, whose work it does from now on."""
    _thread.loop = loop


def run_in_thread(
    loop: asyncio.AbstractEventLoop,
    executor: concurrent.futures.Executor | None,
    function: Callable[..., Any],
    *args: Any,
) -> asyncio.Future[Any]:
    """Run a function in a thread for a loop whose time stands still meanwhile.

    It begins when nothing in the loop is ready any more.
    """
    if executor is None:
        executor = loop._default_executor  # type: ignore[attr-defined]  # noqa: SLF001
        if executor is None:
            executor = concurrent.futures.ThreadPoolExecutor(
                thread_name_prefix="asyncio"
            )
            loop.set_default_executor(executor)
    door = Door.of(loop)
    future: asyncio.Future[Any] = loop.create_future()

    def work_for_loop(work: int) -> Any:
        works_for(loop)
        door.begun(work)
        return function(*args)

    def begin(work: int) -> None:
        inner = executor.submit(work_for_loop, work)
        inner.add_done_callback(
            lambda _: door.post(work, ("run_in_executor",), _settle, future, inner)
        )

    door.give_out(begin)
    return future


def _settle(future: asyncio.Future[Any], inner: concurrent.futures.Future[Any]) -> None:
    if future.cancelled():
        return
    if inner.cancelled():
        future.cancel()
    elif (error := inner.exception()) is not None:
        future.set_exception(error)
    else:
        future.set_result(inner.result())


def now() -> float:
    """Return the robot's monotonic time, in seconds.

    It is the same clock in the event loop, in the thread of a plain behavior or a
    blocking driver, on the virtual clock and in a replay: that of the readings'
    ``time``. In a thread that esair knows nothing of it is `time.monotonic`.
    """
    loop = asyncio._get_running_loop()  # noqa: SLF001 - it does not raise
    if loop is not None:
        return clock_of(loop)()
    own = portal.get(None)
    if own is not None:
        return own.call(_moment)  # by the door: so it is the same in a replay
    loop = getattr(_thread, "loop", None)
    return time.monotonic() if loop is None else clock_beside(loop)()


async def _moment() -> float:
    return clock_of(asyncio.get_running_loop())()


T = TypeVar("T")


class CallRefused(Exception):  # noqa: N818 - an answer of the guard, not a fault
    """The guard of a call said no; the function was not called."""


class InLine(asyncio.Future[T]):
    """What a call waits for on a bus: first for its turn, then for its outcome."""

    begun: float | None = None
    """When its turn came, on the loop's clock; None while it waits for that."""
    ended: float | None = None
    wanted: bool = True


def leave_line(engine: object) -> None:
    """Have what drives a call not begin what it waits for, if that waits for its turn."""
    waits_for = getattr(engine, "_fut_waiter", None)
    if isinstance(waits_for, InLine):
        waits_for.wanted = False


def waits_in_line(engine: object, seconds: float = math.inf) -> bool:
    """Tell whether what drives a call waits for its turn on a bus, or has so long."""
    waits_for = getattr(engine, "_fut_waiter", engine)
    if getattr(waits_for, "begun", 0.0) is None:
        return True
    return getattr(engine, "lined", 0.0) >= seconds


def had_turn(seconds: float) -> None:
    """Take note that the call that runs has waited so long for a turn."""
    task = asyncio.current_task()
    if isinstance(task, LightTask):
        task.lined += seconds


class Outcome(Protocol):
    """Gets what a function has returned or raised, in the loop; a future is one."""

    begun: float | None
    ended: float | None
    """When the function returned, in its thread; None where time waits for threads."""

    def done(self) -> bool:
        """Whether nobody wants it any more."""

    def set_result(self, result: Any, /) -> None:
        """Take what it returned."""

    def set_exception(self, error: BaseException, /) -> None:
        """Take what it raised."""


@attrs.define(eq=False)
class Call:
    """One call on an executor."""

    function: Callable[..., Any]
    args: tuple[Any, ...]
    guard: Callable[[], bool] | None
    future: Outcome
    urgency: Urgency
    work: int = 0


class Line:
    """The calls that wait for a thread: the most urgent is next, whichever came first."""

    def __init__(self) -> None:
        self._calls: list[Call] = []
        self._works: queue.SimpleQueue[int | None] = queue.SimpleQueue()
        self._lock = threading.Lock()
        self._turns = Turns()

    def __len__(self) -> int:
        return len(self._calls)

    def add(self, call: Call) -> None:
        """Let a call wait; it is taken once a work was begun for each that waits."""
        with self._lock:
            self._calls.append(call)

    def begin(self, work: int | None) -> None:
        """Let the thread take a call for a work, or end."""
        self._works.put(work)

    def take(self) -> Call | None:
        """Wait, in the thread, for the next call; None if it is to end."""
        work = self._works.get()
        if work is None:
            return None
        with self._lock:
            call = min(self._calls, key=self._turns.rank)
            self._calls.remove(call)
            self._turns.taken(call)
        call.work = work
        return call


class Executor:
    """One daemon thread; its calls run one after the other, in the order given.

    Those of an actuator that is made safe go first, then of one that is opened; a command
    has the next turn but one.

    A call that does not return in time raises `DriverStuckError` for its caller
    and goes on in the thread, because a thread cannot be stopped; what is queued
    behind it waits. The thread is started by the first call, and never keeps the
    process from ending.

    Args:
        name: Named in errors and in the list of threads.
        limit: How many calls may wait.
    """

    def __init__(self, name: str, *, limit: int = 256) -> None:
        self.name = name
        self.limit = limit
        self.stuck_since: float | None = None
        self._line = Line()
        self._results: Results | None = None
        self._thread: threading.Thread | None = None

    @property
    def waiting(self) -> int:
        """How many calls wait for the one that runs."""
        return len(self._line)

    @property
    def is_current(self) -> bool:
        """Whether the code that asks is running on the executor."""
        return threading.current_thread() is self._thread

    async def call(
        self,
        function: Callable[..., T],
        *args: Any,
        timeout: float,
        guard: Callable[[], bool] | None = None,
        bounded: bool = True,
        turn: float = 0.0,
    ) -> T:
        """Call a blocking function in the thread and wait for its result.

        Args:
            function: What to call.
            *args: Its arguments.
            timeout: How long to wait for it, the queue included, in seconds;
                infinite only for an executor that serves nothing else.
            guard: Asked in the thread, immediately before the call; if it says
                no, the function is not called.
            bounded: Refuse it if too many calls wait; not if it is a close, without
                which something would stay open.
            turn: How long it may wait for its turn, in seconds; its time begins with
                that. If 0, the time counts from now.

        Raises:
            BusyError: Too many calls wait, or there can be no more threads.
            NoTurnError: It was not called in time, or the one before it is stuck.
            DriverStuckError: It did not return in time.
            CallRefused: The guard said no.
        """
        loop = asyncio.get_running_loop()
        future: InLine[T] = InLine(loop=loop)
        outside = timeout == math.inf
        self.submit(
            loop, future, function, *args, guard=guard, bounded=bounded, outside=outside
        )
        if outside:
            return await future
        results = self._results
        assert results is not None
        now = results.time()
        wait = Wait(timeout, function, now + turn if turn else 0.0, now)
        results.waits[future] = wait
        results.deadline.start_by(now + timeout)
        try:
            return await future
        finally:
            if turn and future.begun is not None:
                had_turn(future.begun - now)
            del results.waits[future]
            if not results.waits:
                results.deadline.cancel()

    def submit(
        self,
        loop: asyncio.AbstractEventLoop,
        outcome: Outcome,
        function: Callable[..., Any],
        *args: Any,
        guard: Callable[[], bool] | None = None,
        bounded: bool = True,
        outside: bool = False,
        urgent: Urgency | None = None,
    ) -> None:
        """Have a blocking function called; its outcome comes in the loop, however late."""
        urgent = urgent or urgency.get()
        if bounded and not Turns.has_room(len(self._line), self.limit, urgent):
            raise BusyError(
                f"executor {self.name}", "number of waiting calls", self.limit
            )
        results = self._start(loop)
        results.held += 1
        results.line.add(Call(function, args, guard, outcome, urgent))
        results.door.give_out(results.begin, self._thread, outside=outside)

    def expired(self) -> None:
        """Take note that a call has not returned within its deadline."""
        if self.stuck_since is None:
            self.stuck_since = asyncio.get_running_loop().time()

    def close(self) -> None:
        """End the thread once the calls that it has are done."""
        if self._thread is not None and self._results is not None:
            self._results.is_over = True
            if not self._results.held:
                self._line.begin(None)
            self._thread = None

    async def join(self, timeout: float) -> bool:
        """Wait until the calls that it has are done, and end the thread."""
        if self._thread is None:
            return True
        try:
            await self.call(_nothing, timeout=timeout, bounded=False)
        except DriverStuckError:
            return False
        else:
            return True
        finally:
            self.close()

    def returned(self, results: Results) -> None:
        """Be stuck no more, if it is the newest thread that has returned."""
        if results is self._results:
            self.stuck_since = None

    def _start(self, loop: asyncio.AbstractEventLoop) -> Results:
        if self._results is None or self._thread is None:
            # A thread that was told to end may still work off its own line.
            self._line = Line()
            self._results = Results(self, loop, self._line)
            self.stuck_since = None
            thread = threading.Thread(
                target=_work,
                args=(self._line, self._results),
                name=f"esair-{self.name}",
                daemon=True,
            )
            try:
                thread.start()
            except RuntimeError as error:  # the limit of the process or the user
                raise BusyError(
                    f"executor {self.name}", "the limit of threads", error
                ) from None
            self._thread = thread
        return self._results


@attrs.frozen
class Wait:
    """A call that waits: for how long, until when for its turn (0: any), since when."""

    seconds: float
    function: Callable[..., Any]
    turn: float
    since: float


class Results:
    """What the thread of an executor has done, on its way into the event loop."""

    def __init__(
        self, executor: Executor, loop: asyncio.AbstractEventLoop, line: Line
    ) -> None:
        self._executor = executor
        self.line = line
        self._tag = (executor.name,)
        self.door: Door = Door.of(loop)
        self.loop = loop
        self.time: Callable[[], float] = clock_of(loop)
        self.clock: Callable[[], float | None] = clock_beside(loop)
        if self.door.holds:
            self.clock = lambda: None
        self.waits: dict[InLine[Any], Wait] = {}
        """The calls that wait for their results."""
        self.deadline: Deadline = Deadlines.beside(loop).idle(self._expire)
        """That of the one whose time is over first."""
        self.held: int = 0
        """How many calls it was given that have not come to its thread: see `Door`."""
        self.is_over = False  # whether the thread ends after them

    def begin(self, work: int) -> None:
        """Let a call come to the thread."""
        self.line.begin(work)
        self.held -= 1
        if self.is_over and not self.held:
            self.line.begin(None)

    def add(self, call: Call, result: Any, error: BaseException | None) -> None:
        """Hand over a result, from the thread."""
        try:
            self.door.post(
                call.work, self._tag, self._deliver, call.future, result, error
            )
        except RuntimeError:
            return  # the loop is closed: what is queued (a safe command) still goes

    def _deliver(
        self, future: Outcome, result: Any, error: BaseException | None
    ) -> None:
        self._executor.returned(self)
        if future.done():  # it came too late, or its caller has gone
            return
        if error is None:
            if isinstance(future, asyncio.Future):
                arrive(future, result)
            else:
                future.set_result(result)
        else:  # as it is it could end the task, or the process
            future.set_exception(raisable(error, "the driver"))

    def _expire(self) -> None:
        now = self.time() + REACHED
        for future, wait in self.waits.items():
            if future.done():
                continue
            begun, until = future.begun, wait.since + wait.seconds
            in_line = begun is None and wait.turn > 0.0
            if in_line:
                until = min(wait.turn, now + wait.seconds)
                if wait.turn <= now or self._executor.stuck_since is not None:
                    until = now
            elif begun is not None and wait.turn > 0.0:
                until = begun + wait.seconds
            if until > now:
                self.deadline.start_by(until)
                continue
            # Not repr(): it is the driver's own code, may fail, and is long for a partial.
            call = getattr(wait.function, "__qualname__", type(wait.function).__name__)
            if in_line:
                waited = now - wait.since
                future.set_exception(NoTurnError(self._executor.name, call, waited))
                continue
            self._executor.expired()
            stuck = DriverStuckError(self._executor.name, call, wait.seconds)
            future.set_exception(stuck)


def _work(line: Line, results: Results) -> None:
    works_for(results.loop)
    while (call := line.take()) is not None:
        result: Any = None
        error: BaseException | None = None
        try:
            guard, wanted = call.guard, getattr(call.future, "wanted", True)
            if not wanted or (guard and (call.future.done() or not guard())):
                error = CallRefused()
            else:
                call.future.begun = results.time()
                result = call.function(*call.args)
                call.future.ended = results.clock()
        except BaseException as raised:  # a driver may raise anything
            error = raised
        results.add(call, result, error)
        del call, result, error  # nothing is kept alive while the executor is idle


def _nothing() -> None:
    """Come after all calls that were made before."""


class Portal:
    """Runs a plain function in its own thread, and its calls in the loop.

    The thread calls `call`, which waits there while the coroutine runs in the
    loop. Once the portal is closed every call raises `BehaviorRemovedError`, so a
    function that still runs learns of its end at its next call.
    """

    def __init__(self, name: str, owner: Owner) -> None:
        self.name = name
        self._owner = owner
        self.loop: asyncio.AbstractEventLoop = asyncio.get_running_loop()
        self._door = Door.of(self.loop)
        self._tag = self._door.source(name)
        self.closed: bool = False
        self._calls: set[asyncio.Task[Any]] = set()
        self._home = threading.current_thread()

    async def run(self, function: Callable[..., Any], *args: Any) -> Any:
        """Run a function in a new daemon thread, wait for its end, and return its result.

        If the waiting task is cancelled the portal is closed and the end is
        awaited; cancel again not to wait for it.
        """
        owner = self._owner
        ended: asyncio.Future[Any] = self.loop.create_future()

        def finished(result: Any, error: BaseException | None) -> None:
            owner.threads = tuple(t for t in owner.threads if t is not thread)
            failed = None if error is None else raisable(error, "the behavior")
            settle(ended, result, failed)

        go: concurrent.futures.Future[int] = concurrent.futures.Future()

        def work() -> None:
            result: Any = None
            error: BaseException | None = None
            portal.set(self)
            _given.number = go.result()
            try:
                result = function(*args)
                if inspect.iscoroutine(result):
                    result.close()
                    told = (
                        "its result is a coroutine: make what decorates it async, too"
                    )
                    raise ConfigError(self.name, result.__name__, told)
            except BaseException as raised:  # contained, as in a task
                error = raised
            try:
                self._door.post(_given.number, self._tag, finished, result, error)
            except RuntimeError:  # the loop is closed: nobody waits any more
                return

        context = contextvars.copy_context()
        thread = threading.Thread(
            target=context.run, args=(work,), name=f"esair-{self.name}", daemon=True
        )
        thread.start()
        self._door.give_out(go.set_result, thread)
        owner.threads = (*owner.threads, thread)
        try:
            return await asyncio.shield(ended)
        except asyncio.CancelledError:
            self.close()
            try:
                await asyncio.shield(ended)
            except asyncio.CancelledError:
                ended.add_done_callback(look_at)
                raise
            except BehaviorRemovedError:
                pass
            raise

    def call(
        self,
        function: Callable[..., Coroutine[Any, Any, T]],
        *args: Any,
        **options: Any,
    ) -> T:
        """Run a coroutine function in the loop and wait for it, in the thread."""
        if threading.current_thread() is self._home:
            raise RuntimeError(
                f"{self.name}: a call that waits, in the event loop: its run is a "
                "plain function, so its other methods must be plain functions too"
            )
        mine = portal.get(None)
        outcome: concurrent.futures.Future[T] = concurrent.futures.Future()
        context = contextvars.copy_context()  # what the thread does it for
        counted = getattr(_given, "number", 0)
        thread = threading.current_thread()

        def go_on(settle: Callable[[Any], None], what: Any) -> None:
            def begin(work: int) -> None:
                next_work[0] = work
                settle(what)

            if counted:
                self._door.give_out(begin, thread)
            else:  # a thread that the door knows nothing of
                settle(what)

        next_work = [0]

        def done(task: asyncio.Task[T]) -> None:
            self._calls.discard(task)
            if task.cancelled():
                go_on(outcome.set_exception, BehaviorRemovedError(self.name))
            elif (error := task.exception()) is not None:
                go_on(outcome.set_exception, error)
            else:
                go_on(outcome.set_result, task.result())

        def begin() -> None:
            # Of a thread that outlived its own run, mine is closed.
            if self.closed or (mine is not None and mine.closed):
                go_on(outcome.set_exception, BehaviorRemovedError(self.name))
                return
            try:
                coroutine = function(*args, **options)
            except BaseException as error:  # such as an argument that it does not have
                go_on(outcome.set_exception, error)
                return
            task = spawn(
                self.loop,
                coroutine,
                name=f"{self.name} call",
                owner=self._owner,
                context=context,
            )
            self._calls.add(task)
            task.add_done_callback(done)

        try:
            self._door.post(counted, self._tag, begin)
        except RuntimeError:  # the loop is closed
            raise BehaviorRemovedError(self.name) from None
        try:
            return outcome.result()
        finally:
            if counted:
                _given.number = next_work[0]

    def close(self) -> None:
        """Refuse every further call, and cancel those that run."""
        self.closed = True
        for call in tuple(self._calls):
            call.cancel()


portal: contextvars.ContextVar[Portal] = contextvars.ContextVar("esair_portal")
"""The portal of the thread that runs, if it is the thread of a plain behavior."""

_given = threading.local()
"""Its number is that of the work which the door has given to the thread that runs."""
