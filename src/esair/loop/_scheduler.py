"""The scheduler: one timer and one task that call every step when it is due.

A step is a plain function, called as ``step(now)``. So a thousand steps cost a
thousand calls, not a thousand wake-ups of tasks. A step that has to wait returns
the rest of its work as an awaitable; the task that turned the scheduler then stays with
that rest, and a new task goes on turning (the *leader and followers* pattern), so
that whatever the step began stays in the task that began it.
"""

from __future__ import annotations

import asyncio
import heapq
import itertools
import logging
import math
from collections.abc import Awaitable, Callable, Iterator

from esair.loop._of_loop import of_loop
from esair.loop._ownership import spawn
from esair.loop._suspend import SuspendWatch
from esair.loop._timer import Timer, clock_of, timer_for

Step = Callable[[float], Awaitable[object] | None]

_log = logging.getLogger("esair")

SPREAD = 0.0025
"""Steps of the same period are spread over phases at least this far apart, in s."""

CROWD = 32
"""How many steps share a phase before the next phase is used."""

_EARLY = 1e-6  # timers may fire a hair early; such a step is on time


def _idle(_now: float) -> None:
    return None


class OneShot:
    """One call at one moment."""

    __slots__ = ("due", "function", "number")

    def __init__(self, due: float, number: int, function: Step) -> None:
        self.due = due
        self.number = number
        self.function = function

    def __lt__(self, other: OneShot | RateGroup) -> bool:
        return (self.due, self.number) < (other.due, other.number)

    def turn(self, _now: float) -> tuple[Job | OneShot, ...]:
        return (self,)


class Job:
    """A step that the scheduler calls again and again."""

    __slots__ = ("_skipped_before", "function", "group", "queued", "scheduler")

    def __init__(
        self, scheduler: Scheduler, function: Step, group: RateGroup | None
    ) -> None:
        self.scheduler = scheduler
        self.function = function
        self.group = group
        self.queued = False
        self._skipped_before = group.skipped if group is not None else 0

    @property
    def skipped(self) -> int:
        """How many steps were left out because they came too late."""
        return (
            self.group.skipped - self._skipped_before if self.group is not None else 0
        )

    @property
    def lateness(self) -> float:
        """How late the steps have been on average, in seconds."""
        group = self.group
        return group.late / group.turns if group is not None and group.turns else 0.0

    def soon(self) -> None:
        """Have the step called in the next turn, once."""
        if not self.queued:
            self.queued = True
            self.scheduler.queue(self)

    def stop(self) -> None:
        """Never call the step again."""
        self.function = _idle
        group = self.group
        if group is not None and self in group.jobs:
            group.jobs = tuple(job for job in group.jobs if job is not self)
            if not group.jobs:
                self.scheduler.drop(group)


class RateGroup:
    """The steps that share a period and a phase. It never drifts."""

    __slots__ = (
        "_begin",
        "_count",
        "due",
        "jobs",
        "late",
        "number",
        "period",
        "skipped",
        "turns",
    )

    def __init__(self, period: float, begin: float, number: int) -> None:
        self.period = period
        self.due = begin
        self.number = number
        self.jobs: tuple[Job, ...] = ()
        self.skipped = 0
        self.late = 0.0
        self.turns = 0
        self._begin = begin
        self._count = 0

    def __lt__(self, other: OneShot | RateGroup) -> bool:
        return (self.due, self.number) < (other.due, other.number)

    def turn(self, now: float) -> tuple[Job | OneShot, ...]:
        """Move on to the next moment that has not passed; return whom to call."""
        behind = now - self.due
        self.late += behind if behind > 0 else 0.0
        self.turns += 1
        missed = int((behind + _EARLY) / self.period)
        if missed > 0:
            self.skipped += missed
            self._count += missed
        self._count += 1
        self.due = self._begin + self._count * self.period
        return self.jobs


class Scheduler:
    """Calls steps when they are due, all from one timer. One for each event loop."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._time = clock_of(loop)
        self.suspends = SuspendWatch(loop)
        """Looked at each time the scheduler begins to turn after a sleep."""
        self._numbers = itertools.count()
        self._heap: list[OneShot | RateGroup] = []
        self._groups: dict[float, list[RateGroup]] = {}
        self._queue: list[Job] = []
        self._calls: Iterator[Job | OneShot] = iter(())
        self._now = 0.0
        self._began = 0.0
        """When this turn began; what falls due later waits for the next one."""
        self._grid = 0.0
        self._timer: Timer | None = None
        self._timer_due = 0.0
        self._turning = False
        self._leader: asyncio.Task[None] | None = None
        self._sleep: asyncio.Future[None] | None = None

    @classmethod
    def of(cls, loop: asyncio.AbstractEventLoop) -> Scheduler:
        """Return the scheduler of a loop."""
        return of_loop(loop, cls)

    def every(self, period: float, function: Step) -> Job:
        """Call a step each period (seconds), the first time within one period."""
        group = self._group(period)
        job = Job(self, function, group)
        group.jobs = (*group.jobs, job)
        return job

    def on_demand(self, function: Step) -> Job:
        """Return a step that is called only when its ``soon`` is."""
        return Job(self, function, None)

    def at(self, due: float, function: Step) -> OneShot:
        """Call a function once, at a moment of the loop's clock."""
        one_shot = OneShot(due, next(self._numbers), function)
        self._push(one_shot)
        return one_shot

    def cancel(self, one_shot: OneShot) -> None:
        """Never call the function of a one-shot."""
        one_shot.function = _idle
        self.drop(one_shot)

    def queue(self, job: Job) -> None:
        """Call the step of a job in the next turn."""
        self._queue.append(job)
        self._wake()

    def drop(self, entry: OneShot | RateGroup) -> None:
        """Take an entry out; the scheduler stands still when it was the last one."""
        if entry in self._heap:
            self._heap.remove(entry)
            heapq.heapify(self._heap)
        if isinstance(entry, RateGroup):
            self._groups[entry.period].remove(entry)
            if not self._groups[entry.period]:
                del self._groups[entry.period]
        if not self._heap:
            self._wake()

    def _group(self, period: float) -> RateGroup:
        groups = self._groups.setdefault(period, [])
        phases = max(1, int(period / SPREAD))
        emptiest = min(groups, key=lambda group: len(group.jobs), default=None)
        if emptiest is not None and (
            len(emptiest.jobs) < CROWD or len(groups) >= phases
        ):
            return emptiest
        begin = self._time()
        if not any(self._groups.values()):
            self._grid = begin
        # All groups begin on one grid, so that one wake-up serves many of them.
        begin = self._grid + math.ceil((begin - self._grid) / SPREAD - _EARLY) * SPREAD
        begin += len(groups) * SPREAD % period
        group = RateGroup(period, begin, next(self._numbers))
        groups.append(group)
        self._push(group)
        return group

    def _push(self, entry: OneShot | RateGroup) -> None:
        heapq.heappush(self._heap, entry)
        if not self._turning:
            self._wake()
        elif (
            self._heap[0] is entry
            and self._timer is not None
            and self._sleep is not None
        ):
            self._timer_due = entry.due
            self._timer.set(entry.due)

    def _wake(self) -> None:
        if not self._turning:
            self.suspends.look()
            self._lead_on()
        elif self._sleep is not None and not self._sleep.done():
            self._sleep.set_result(None)

    def _lead_on(self) -> None:
        self._turning = True
        self._leader = None  # an eager task sets it before spawn returns
        spawn(self._loop, self._lead(), name="esair scheduler")

    async def _lead(self) -> None:
        me = self._leader = asyncio.current_task()
        self._began = self._time()
        try:
            while True:
                for call in self._calls:
                    try:
                        rest = call.function(self._now)
                    except Exception:
                        _log.exception("a step of the scheduler raised; it goes on")
                        continue
                    if rest is not None:
                        self._lead_on()
                        await rest
                        return
                if not self._collect():
                    if not self._heap:
                        return
                    await self._wait()
        finally:
            if self._leader is me:
                self._leader = None
                self._turning = False
                if self._timer is not None:
                    self._timer.close()
                    self._timer = None

    def _collect(self) -> bool:
        now = self._now = self._time()
        heap = self._heap
        if self._queue:
            queue, self._queue = self._queue, []
            for job in queue:
                job.queued = False
            self._calls = iter(queue)
            return True
        if not heap or heap[0].due > self._began + _EARLY:
            return False
        entry = heap[0]
        self._calls = iter(entry.turn(now))
        if isinstance(entry, RateGroup):
            heapq.heapreplace(heap, entry)
        else:
            heapq.heappop(heap)
        return True

    async def _wait(self) -> None:
        if self._heap[0].due <= self._time() + _EARLY:
            # Steps that take longer than their period must not starve everybody else.
            await asyncio.sleep(0)
            self._began = self._time()
            return
        if self._timer is None:
            self._timer = timer_for(self._loop, self._wake)
            self._timer_due = 0.0
        due = self._heap[0].due
        if due != self._timer_due:
            self._timer_due = due
            self._timer.set(due)
        self._sleep = self._loop.create_future()
        try:
            await self._sleep
        finally:
            self._sleep = None
            self._timer_due = 0.0
        self._began = self._time()
        self.suspends.look()


def scheduler() -> Scheduler:
    """Return the scheduler of the running loop."""
    return Scheduler.of(asyncio.get_running_loop())
