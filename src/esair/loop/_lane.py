"""A lane: one worker thread that makes the blocking calls of one bus, in order."""

from __future__ import annotations

import asyncio
import collections
import math
import threading
from collections.abc import Callable
from typing import Any, TypeVar

from esair.exceptions import BusyError, DriverStuckError

T = TypeVar("T")


class CallRefused(Exception):  # noqa: N818 - an answer of the guard, not a fault
    """The guard of a call said no; the function was not called."""


class Job:
    """One call on a lane."""

    __slots__ = ("args", "function", "future", "guard")

    def __init__(
        self,
        function: Callable[..., Any],
        args: tuple[Any, ...],
        guard: Callable[[], bool] | None,
        future: asyncio.Future[Any],
    ) -> None:
        self.function = function
        self.args = args
        self.guard = guard
        self.future = future


class Lane:
    """One daemon thread; its calls run one after the other, in the order given.

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
        self._jobs: collections.deque[Job | None] = collections.deque()
        self._ready = threading.Semaphore(0)
        self._thread: threading.Thread | None = None
        self._running = 0

    @property
    def waiting(self) -> int:
        """How many calls wait for the one that runs."""
        return len(self._jobs)

    async def call(
        self,
        function: Callable[..., T],
        *args: Any,
        timeout: float,
        guard: Callable[[], bool] | None = None,
    ) -> T:
        """Call a blocking function in the thread and wait for its result.

        Args:
            function: What to call.
            *args: Its arguments.
            timeout: How long to wait for it, the queue included, in seconds;
                infinite only for a lane that serves nothing else.
            guard: Asked in the thread, immediately before the call; if it says
                no, the function is not called.

        Raises:
            BusyError: Too many calls wait.
            DriverStuckError: It did not return in time.
            CallRefused: The guard said no.
        """
        if len(self._jobs) >= self.limit:
            raise BusyError(f"lane {self.name}", "number of waiting calls", self.limit)
        loop = asyncio.get_running_loop()
        future: asyncio.Future[T] = loop.create_future()
        self._start(loop)
        self._jobs.append(Job(function, args, guard, future))
        in_flight(loop, +1)
        self._ready.release()
        if timeout == math.inf:
            return await future
        timer = loop.call_later(timeout, self._expire, future, function, timeout)
        try:
            return await future
        finally:
            timer.cancel()

    def close(self) -> None:
        """End the thread once the calls that it has are done."""
        if self._thread is not None:
            self._jobs.append(None)
            self._ready.release()
            self._thread = None

    async def join(self, timeout: float) -> bool:
        """Wait until the calls that it has are done, and end the thread.

        Returns:
            Whether they were done in time.
        """
        if self._thread is None:
            return True
        try:
            await self.call(_nothing, timeout=timeout)
        except (DriverStuckError, BusyError):
            return False
        else:
            return True
        finally:
            self.close()

    def _start(self, loop: asyncio.AbstractEventLoop) -> None:
        if self._thread is None:
            # A thread that was told to end may still work off its own queue.
            self._jobs = collections.deque()
            self._ready = threading.Semaphore(0)
            self._thread = threading.Thread(
                target=self._work,
                args=(loop, self._jobs, self._ready),
                name=f"esair-{self.name}",
                daemon=True,
            )
            self._thread.start()

    def _work(
        self,
        loop: asyncio.AbstractEventLoop,
        jobs: collections.deque[Job | None],
        ready: threading.Semaphore,
    ) -> None:
        while True:
            ready.acquire()
            job = jobs.popleft()
            if job is None:
                return
            result: Any = None
            error: BaseException | None = None
            try:
                if job.guard is not None and (job.future.done() or not job.guard()):
                    error = CallRefused()
                else:
                    result = job.function(*job.args)
            except BaseException as raised:  # a driver may raise anything
                error = raised
            try:
                loop.call_soon_threadsafe(
                    self._deliver, loop, job.future, result, error
                )
            except RuntimeError:
                continue  # the loop is closed: what is queued (a safe command) still goes

    def _deliver(
        self,
        loop: asyncio.AbstractEventLoop,
        future: asyncio.Future[Any],
        result: Any,
        error: BaseException | None,
    ) -> None:
        in_flight(loop, -1)
        self.stuck_since = None
        if future.done():  # it came too late, or its caller has gone
            return
        if isinstance(error, StopIteration | KeyboardInterrupt | SystemExit):
            wrapped = RuntimeError(f"the driver raised {type(error).__name__}")
            wrapped.__cause__ = error
            future.set_exception(wrapped)
        elif error is not None:
            future.set_exception(error)
        else:
            future.set_result(result)

    def _expire(
        self,
        future: asyncio.Future[Any],
        function: Callable[..., Any],
        timeout: float,
    ) -> None:
        if not future.done():
            if self.stuck_since is None:
                self.stuck_since = asyncio.get_running_loop().time()
            call = getattr(function, "__qualname__", repr(function))
            future.set_exception(DriverStuckError(self.name, call, timeout))


def _nothing() -> None:
    """Come after all calls that were made before."""


def in_flight(loop: asyncio.AbstractEventLoop, change: int) -> None:
    """Count the threads that work for a loop, for a clock that must wait for them.

    A virtual clock must not jump while a thread computes; it keeps the count in
    its attribute ``threads_in_flight``. On a real clock there is nothing to do.
    """
    count = getattr(loop, "threads_in_flight", None)
    if count is not None:
        loop.threads_in_flight = count + change  # type: ignore[attr-defined]
