"""The virtual clock: an event loop whose time jumps instead of passing."""

from __future__ import annotations

import asyncio
import concurrent.futures
import heapq
import math
import random
import threading
from collections.abc import Callable
from typing import Any

from esair.loop import Door, works_for
from esair.testing._threads import LOOK, Threads

STEP_BUDGET = 200_000  # How many turns of the loop may pass without any time passing


class DeadlockError(RuntimeError):
    """Every task waits, and nothing can ever wake one."""


class LivelockError(RuntimeError):
    """Tasks keep each other busy and time never passes."""


class VirtualLoop(asyncio.SelectorEventLoop):
    """An event loop that jumps to the next timer when there is nothing to do.

    An hour of a robot's life takes seconds, and the same seed gives the same order
    of tasks. It waits in real time while a worker thread of esair computes, because
    time must not jump ahead of a thread. Waiting is not computing: while the thread
    of a plain ``stream`` sleeps, time passes.

    Args:
        seed: Shuffles the order of tasks that are ready at the same time; None or 0
            keeps the order in which they became ready.
        start: What the clock shows at first, in seconds.

    Raises:
        BlockedError: A thread has slept in a call for ten seconds of real time, or has
            computed in it for a minute.
        DeadlockError: Every task waits and nothing can wake one.
        LivelockError: Time does not pass for very many turns.
    """

    virtual = True
    takes_entries = True
    holds_work = True

    def __init__(self, *, seed: int | None = None, start: float = 0.0) -> None:
        self.suspended = 0.0
        self._now = start
        self._random = random.Random(seed) if seed else None
        self._turns = 0
        self._held = False
        self._aside: list[Any] = []
        """What is ready, and waits for the threads that began while it was held up."""
        self._threads = Threads()
        super().__init__()

    def time(self) -> float:
        """Return the virtual time, in seconds."""
        return self._now

    def advance(self, seconds: float) -> None:
        """Let time pass at once, as if the computer had been busy for so long."""
        self._now += seconds
        self._held = True

    def suspend(self, seconds: float) -> None:
        """Sleep as a computer does whose lid is closed: the clock stands still."""
        self.suspended += seconds

    @property
    def threads_in_flight(self) -> int:
        """How many threads work for the loop; time stands still meanwhile."""
        return Door.of(self).at_work

    @threads_in_flight.setter
    def threads_in_flight(self, count: int) -> None:
        Door.of(self).at_work = count

    def wait_in_thread(self, seconds: float) -> None:
        """Let virtual time pass in a thread that works for a robot, and wait for that.

        A blocking driver of a fake takes its time so; `time.sleep` takes real time.
        """
        door, thread = Door.of(self), threading.current_thread()
        woken = threading.Event()

        def wake() -> None:
            door.go_on(thread)
            woken.set()

        def begin() -> None:  # in one step: else time could pass in between
            door.rest(thread)
            self.call_later(seconds, wake)

        self.call_soon_threadsafe(begin)
        woken.wait()

    def call_soon_threadsafe(  # type: ignore[override]
        self, callback: Callable[..., object], *args: Any, context: Any = None
    ) -> asyncio.Handle:
        """Call a function soon; from another thread it comes in as what threads do."""
        if threading.get_ident() != self._thread_id:  # type: ignore[attr-defined]
            callback = _OfThread(callback)
        return super().call_soon_threadsafe(callback, *args, context=context)

    def run_in_executor(  # type: ignore[override]
        self, executor: Any, func: Callable[..., Any], *args: Any
    ) -> asyncio.Future[Any]:
        """Run a function in a thread; time stands still meanwhile."""
        if executor is None:
            executor = self._default_executor  # type: ignore[has-type]
            if executor is None:
                executor = concurrent.futures.ThreadPoolExecutor(
                    thread_name_prefix="asyncio"
                )
                self._default_executor = executor

        door = Door.of(self)
        future: asyncio.Future[Any] = self.create_future()

        def work_for_loop(work: int, *args: Any) -> Any:
            works_for(self)
            door.begun(work)
            return func(*args)

        def begin(work: int) -> None:
            inner = executor.submit(work_for_loop, work, *args)
            inner.add_done_callback(
                lambda _: door.post(work, ("run_in_executor",), _settle, future, inner)
            )

        door.give_out(begin)
        return future

    async def shutdown_default_executor(self, *args: Any, **options: Any) -> None:
        """End the threads of `run_in_executor`."""
        self.threads_in_flight += 1
        try:
            await super().shutdown_default_executor(*args, **options)
        finally:
            self.threads_in_flight -= 1

    def _run_once(self) -> None:
        ready, scheduled = self._ready, self._scheduled  # type: ignore[attr-defined]
        self._turns += 1
        if self._held:
            # Threads do not wait for a loop that is busy: they come first now, then
            # what was ready, and the timers of the time that has passed at last.
            self._held = False
            for handle in tuple(ready):
                ready.popleft()
                # Its thread may wait for what a thread has called.
                calls = isinstance(handle._callback, _OfThread)
                (ready if calls else self._aside).append(handle)
            self._clock_resolution = -math.inf
        if ready:
            if self._random is not None and len(ready) > 1:
                self._shuffle(ready)
        elif self._stopping:  # type: ignore[attr-defined]
            self._put_back(ready)
        elif not self._door_is_quiet():
            if not ready:
                self._wait_for_threads()
                return
        elif self._clock_resolution < 0.0:
            self._put_back(ready)
        else:
            while scheduled and scheduled[0]._cancelled:
                heapq.heappop(scheduled)._scheduled = False
                self._timer_cancelled_count = max(0, self._timer_cancelled_count - 1)  # type: ignore[has-type]
            if scheduled:
                if scheduled[0]._when > self._now:
                    self._now = scheduled[0]._when
                    self._clock_resolution = self._resolution()
                    self._turns = 0
            elif self._threads.outside(Door.of(self)):
                self._wait_for_threads()
                return
            elif self._watches_nothing():
                raise DeadlockError(f"every task waits:\n{self._tasks()}")
        if self._turns > STEP_BUDGET:
            self._turns = 0
            raise LivelockError(f"time does not pass:\n{self._tasks()}")
        del ready, scheduled  # asyncio makes new lists; the old ones keep tasks alive
        super()._run_once()  # type: ignore[misc]

    def _put_back(self, ready: Any) -> None:
        ready.extend(self._aside)
        self._aside.clear()
        self._clock_resolution = self._resolution()

    def _resolution(self) -> float:
        """Return how far ahead a timer is due: late in a long life the clock is coarse."""
        return max(1e-9, 2 * math.ulp(self._now))

    def _door_is_quiet(self) -> bool:
        """Let threads begin, and what they have done come in when all have ended."""
        door = Door.of(self)
        while True:
            door.let_go()
            self._threads.wake(door)
            if door.at_work > 0:
                return False
            if not door.waiting:
                return True
            door.take(by_work=True)
            if self._ready:  # type: ignore[attr-defined]
                return False

    def _wait_for_threads(self) -> None:
        """Wait in real time until something comes in, or a thread has fallen asleep."""
        events = self._selector.select(LOOK)  # type: ignore[attr-defined]
        if events:
            self._process_events(events)  # type: ignore[attr-defined]
        else:
            self._threads.look(Door.of(self), self._turns)

    def _watches_nothing(self) -> bool:
        own = self._ssock.fileno()  # type: ignore[attr-defined]
        return all(key.fd == own for key in self._selector.get_map().values())  # type: ignore[attr-defined]

    def _shuffle(self, ready: Any) -> None:
        """Shuffle the steps of tasks among their places; callbacks keep theirs."""
        assert self._random is not None
        places = [
            place
            for place, handle in enumerate(tuple(ready))  # threads add to it
            if isinstance(getattr(handle._callback, "__self__", None), asyncio.Task)
        ]
        if len(places) < 2:
            return
        handles = [ready[place] for place in places]
        self._random.shuffle(handles)
        for place, handle in zip(places, handles, strict=True):
            ready[place] = handle

    def _tasks(self) -> str:
        tasks = sorted(asyncio.all_tasks(self), key=lambda task: task.get_name())
        return "\n".join(f"  {task!r}" for task in tasks) or "  (no tasks)"


class _OfThread:
    """A function that a thread has called into the loop."""

    __slots__ = ("_function",)

    def __init__(self, function: Callable[..., object]) -> None:
        self._function = function

    def __call__(self, *args: Any) -> None:
        self._function(*args)


def _settle(future: asyncio.Future[Any], inner: concurrent.futures.Future[Any]) -> None:
    if future.cancelled():
        return
    if inner.cancelled():
        future.cancel()
    elif (error := inner.exception()) is not None:
        future.set_exception(error)
    else:
        future.set_result(inner.result())
