"""The virtual clock: an event loop whose time jumps instead of passing.

Of threads it looks which compute, which wait, and which are stuck.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import os
import random
import sys
import threading
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

import esair.loop
from esair.loop import NEVER, SECOND, Door, TurnLoop, run_in_thread

LOOK = 0.02
"""How often threads are looked at while the loop waits for them, in real seconds."""

ASLEEP = 0.05  # After how long a sleep a thread waits for the outside, in real seconds

BLOCKED = 10.0
"""After how long a sleep a thread that time waits for is stuck, in real seconds."""

ENDLESS = 60.0
"""After how long a thread that computes is stuck, if nothing else happens meanwhile."""

_ITS_WAY = (threading.__file__, os.path.join(os.path.dirname(esair.loop.__file__), ""))
"""Where the code lies through which each function comes into a thread."""


class BlockedError(RuntimeError):
    """Time stands still: a thread sleeps in a call, or computes without end."""


class Threads:
    """Tells what the threads do that a loop on the virtual clock has given work to."""

    def __init__(self) -> None:
        self._slept: dict[threading.Thread, tuple[float, float]] = {}
        """How much each has computed, and since when it has not, in real seconds."""
        self._turn = -1  # the last one in which the loop has only waited
        self._since = 0.0  # when it began to, in real time

    def wake(self, door: Door) -> None:
        """Let time wait again for those that have heard from the outside."""
        for thread, outside, holds in door.at_hand():
            if outside and not holds and self._asleep_for(thread) == 0.0:
                door.go_on(thread)

    def outside(self, door: Door) -> bool:
        """Tell whether some wait for the outside, which may have something to say."""
        return any(outside for _, outside, _ in door.at_hand())

    def look(self, door: Door, turn: int) -> None:
        """Let time pass by those that wait for the outside; the loop does nothing else."""
        now = time.monotonic()
        if turn != self._turn + 1:  # it has done something since
            self._since = now
        self._turn = turn
        endless = now - self._since >= ENDLESS
        stuck = []
        at_hand = door.at_hand()
        for thread, outside, holds in at_hand:
            slept = self._asleep_for(thread)
            if outside and holds and slept >= ASLEEP:
                door.rest(thread)
            elif (slept >= BLOCKED and (holds or outside)) or (endless and holds):
                stuck.append(thread)
        known = {thread for thread, _, _ in at_hand}
        self._slept = {key: it for key, it in self._slept.items() if key in known}
        if not stuck:
            return
        told = "\n".join(f"  thread {each.name!r}: {_where(each)}" for each in stuck)
        for thread in stuck:  # told once: the end of the test does not wait for it
            self._slept.pop(thread, None)
            door.rest(thread)
        raise BlockedError(
            f"time stands still, for {ENDLESS if endless else BLOCKED:g} s of real time "
            f"by now:\n{told}\n"
            "let it take its time by loop.wait_in_thread(seconds), write it as "
            "async def, or mark the test real_clock"
        )

    def _asleep_for(self, thread: threading.Thread) -> float:
        """Return for how long a thread has not computed, in real seconds."""
        now, computed = time.monotonic(), _computed(thread)
        before, since = self._slept.get(thread, (-1.0, now))
        if computed != before or _runs(thread):
            since = now
        self._slept[thread] = computed, since
        return now - since


def _computed(thread: threading.Thread) -> float:
    """Return how long a thread has computed, in seconds."""
    with contextlib.suppress(OSError, TypeError, AttributeError):
        return time.clock_gettime(time.pthread_getcpuclockid(thread.ident))  # type: ignore[arg-type]
    return 0.0


def _runs(thread: threading.Thread) -> bool:
    """Tell whether a thread computes, or would if a processor were free."""
    with contextlib.suppress(OSError, IndexError):
        stat = Path(f"/proc/self/task/{thread.native_id}/stat").read_text()
        return stat.rpartition(")")[2].split()[0] == "R"
    return False


def _where(thread: threading.Thread) -> str:
    """Say in which line of which function a thread is: of somebody's own, if it is."""
    frame = sys._current_frames().get(thread.ident or 0)
    if frame is None:
        return "it has ended"
    stack = traceback.extract_stack(frame)
    own = [each for each in stack if not each.filename.startswith(_ITS_WAY)]
    line = (own or stack)[-1]
    return f"{line.filename}:{line.lineno} in {line.name}: {line.line}"


STEP_BUDGET = 200_000  # How many passes of the loop may go by without any time passing

TOGETHER = 1e-6
"""What comes so soon after the next moment comes with it, in seconds."""


class DeadlockError(RuntimeError):
    """Every task waits, and nothing can ever wake one."""


class LivelockError(RuntimeError):
    """Tasks keep each other busy and time never passes."""


class VirtualLoop(TurnLoop):
    """The event loop of `esair.run`, but that it jumps when there is nothing to do.

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

    def __init__(self, *, seed: int | None = None, start: float = 0.0) -> None:
        self.suspended: float = 0.0
        self._random = random.Random(seed) if seed else None
        self._passes = 0
        self._held = False
        self._aside: list[Any] = []
        """What is ready, and waits for the threads that began while it was held up."""
        self._threads = Threads()
        self._now = start
        super().__init__()
        self._door = self._turn.door

    def clock(self) -> float:
        """Return the virtual time, in seconds."""
        return self._now

    def slept(self) -> float:
        """Return for how long the computer has slept in all, in seconds."""
        return self.suspended

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
        return self._door.at_work

    @threads_in_flight.setter
    def threads_in_flight(self, count: int) -> None:
        self._door.at_work = count

    def wait_in_thread(self, seconds: float) -> None:
        """Let virtual time pass in a thread that works for a robot, and wait for that.

        A blocking driver of a fake takes its time so; `time.sleep` takes real time.
        """
        door, thread = self._door, threading.current_thread()
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
        return run_in_thread(self, executor, func, *args)

    async def shutdown_default_executor(self, *args: Any, **options: Any) -> None:
        """End the threads of `run_in_executor`."""
        self.threads_in_flight += 1
        try:
            await super().shutdown_default_executor(*args, **options)
        finally:
            self.threads_in_flight -= 1

    def _pass(self, timeout: float | None = None) -> Any:
        events = self._wait(timeout)
        door, turn = self._door, self._turn
        if self._clock_resolution < 0.0 or door.at_work > 0:
            # No turn: threads come first. What they have told takes effect all the same.
            door.take()
            return events
        turn.number += 1
        turn.border(self._now)
        return events

    def _wait(self, _timeout: float | None) -> Any:
        """Let go on what is ready, else threads, else what is due, else time."""
        ready, door = self._ready, self._door  # type: ignore[attr-defined]
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
        if ready and self._random is not None:
            self._shuffle(ready)
        self._count()
        while not (ready or self._stopping or door.has_news):  # type: ignore[attr-defined]
            door.let_go()
            self._threads.wake(door)
            is_quiet = door.at_work == 0  # once: a thread may end at any moment
            if door.ripen(works=is_quiet):
                break
            if is_quiet:
                if self._clock_resolution < 0.0:
                    self._put_back(ready)
                    break
                if self._turn.is_due(self._now) or self._jumped():
                    break
                if not self._threads.outside(door):
                    if self._watches_nothing():
                        raise DeadlockError(f"every task waits:\n{self._tasks()}")
                    return self._others(self._select(None))
            # In real time, until something comes in, or a thread has fallen asleep.
            events = self._select(LOOK)
            door.look()
            if not events:
                self._threads.look(door, self._passes)
            elif events := self._others(events):
                return events
            self._count()
        if self._stopping:  # type: ignore[attr-defined]
            self._put_back(ready)
        events = self._select(0.0)
        return self._others(events) if events else events

    def _count(self) -> None:
        self._passes += 1
        if self._passes > STEP_BUDGET:
            self._passes = 0
            raise LivelockError(f"time does not pass:\n{self._tasks()}")

    def _jumped(self) -> bool:
        """Let time jump to what comes next, if there is anything."""
        both = (self.first_timer(), self._turn.due / SECOND)
        first = min(both)
        if first == NEVER:
            return False
        moment = max(each for each in both if each <= first + TOGETHER)
        if moment > self._now:
            self._now = moment
            self._clock_resolution = self._resolution()
            self._passes = 0
        return True

    def _put_back(self, ready: Any) -> None:
        ready.extend(self._aside)
        self._aside.clear()
        self._clock_resolution = self._resolution()

    def _resolution(self) -> float:
        """Return how far ahead a timer is due: late in a long life the clock is coarse."""
        return max(1e-9, 2 * math.ulp(self._now))

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
