"""The scheduler: one timer and one task that call every step when it is due.

A step is a plain function, called as ``step(now)``. So a thousand steps cost a
thousand calls, not a thousand wake-ups of tasks. A step that has to wait returns
the rest of its work as an awaitable; the task that turned the scheduler then stays with
that rest, and a new task goes on turning (the *leader and followers* pattern), so
that whatever the step began stays in the task that began it.

In a turn everything that is due is called in one order (`Order`): sensors are asked,
what is derived of them is computed, steps decide, what was decided leaves, those go on
who waited for the moment, and then what has not come until now is over: a call, a
reading that was good until now, an actuator that nobody has written.

Where turns have a border the task is woken there and nowhere else, by what was asked for
before it: so what is called in a turn depends on nobody who happens to keep it awake.
"""

from __future__ import annotations

import asyncio
import heapq
import itertools
import logging
import math
from collections.abc import Iterable, Iterator
from operator import attrgetter
from typing import TYPE_CHECKING, Any

from esair.loop._futures import ignore
from esair.loop._of_loop import OfLoop
from esair.loop._ownership import spawn
from esair.loop._rate_group import (
    EARLY,
    SECOND,
    Callee,
    DerivedJob,
    Job,
    OneShot,
    Order,
    RateGroup,
    Step,
    idle,
    whole_period,
)
from esair.loop._suspend import SuspendWatch
from esair.loop._timer import Timer, clock_of, timer_for

if TYPE_CHECKING:
    from fractions import Fraction

_log = logging.getLogger("esair")

SPREAD = 2_500_000  # phases of the same period are at least this far apart, in ns
FAR = 9e9  # what is due later than that many seconds is due then: timers end there
CROWD = 32  # how many components share a phase before another phase is used


class Scheduler(OfLoop):
    """Calls steps when they are due, all from one timer. One for each event loop."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._has_border: bool = getattr(loop, "wakes_scheduler", False)
        """The loop calls `look` at the beginning of each turn."""
        self._needs_no_timer = getattr(loop, "player", None) is not None
        self.in_turn = False
        """Somebody's step runs now; what it asks for is for this turn."""
        self._later: list[Job] = []
        """What is asked for when the turn has begun: for the next one."""
        self._decided_later: list[Callee] = []
        self._derived_later: list[DerivedJob] = []
        self._time = clock_of(loop)
        self.suspends = SuspendWatch.of(loop)
        """Looked at each time the scheduler begins to turn after a sleep."""
        self.turns = 0  # how many turns have begun: the number of this one
        self.polled_in = 0
        """The last turn in which a sensor was asked that did not answer at once."""
        self._numbers = itertools.count()
        self._heap: list[tuple[int, int, Any, RateGroup | OneShot]] = []
        self._cancelled = 0  # how many one-shots in the heap nobody wants any more
        self._groups: dict[tuple[Order, Fraction, int], RateGroup] = {}
        self._phases = 1
        self._queue: list[Job] = []
        self._derived: list[DerivedJob] = []
        self.decided: list[Callee] = []
        """What is called when all steps of this turn have decided."""
        self._turn: Iterator[Iterable[Callee]] = iter(())
        self._calls: Iterator[Callee] = iter(())
        self._now = 0.0
        self._timer: Timer | None = None
        self._timer_due = -1
        self._turning = False
        self._leader: asyncio.Task[None] | None = None
        self._sleep: asyncio.Future[None] | None = None

    @classmethod
    def beside(cls, loop: asyncio.AbstractEventLoop) -> Scheduler:
        """Return the one for what is outside of the robot: drivers, a simulation.

        A replay has none of that, and where the robot's own turns can be repeated
        nobody else may share them. On any other loop it is that of the robot.
        """
        if getattr(loop, "wakes_scheduler", False):
            return _SchedulerBeside.of(loop)
        return cls.of(loop)

    def expect(self, components: int) -> None:
        """Prepare for a number of components: a crowd is spread over phases.

        The phase of each follows from its name, so it is the same in each run and
        whatever was added first.
        """
        self._phases = max(self._phases, math.ceil(components / CROWD))

    def phase(self, name: str) -> int:
        """Return by how much the moments of a component are shifted, in ns."""
        if self._phases == 1:
            return 0
        import zlib  # only a crowd needs it

        return zlib.crc32(name.encode()) % self._phases * SPREAD

    def every(
        self,
        period: float,
        function: Step,
        *,
        order: Order = Order.STEP,
        name: str = "",
        phase: int = 0,
    ) -> Job:
        """Call a step each period (seconds), the first time within one period."""
        whole = whole_period(period)
        key = (order, whole, int(phase % whole))
        group = self._groups.get(key)
        if group is None:
            group = self._groups[key] = RateGroup(*key, after=self._nanoseconds())
        job = self._job(function, group, order, name)
        group.add(job)
        if len(group.jobs) == 1:
            self._push(group.due, group)
        return job

    def on_demand(self, function: Step, *, name: str = "") -> Job:
        """Return a step that is called only when its ``soon`` is."""
        return self._job(function, None, Order.STEP, name)

    def derived(self, function: Step, *, name: str, depth: int) -> DerivedJob:
        """Return a step that computes something of new readings before others decide."""
        return DerivedJob(self, function, name, depth)

    def _job(
        self, function: Step, group: RateGroup | None, order: Order, name: str
    ) -> Job:
        number = next(self._numbers)
        return Job(self, function, group, order=order, name=name, number=number)

    def at(self, due: float, function: Step, *, order: Order = Order.WAKE) -> OneShot:
        """Call a function once, at a moment of the loop's clock."""
        one_shot = OneShot(round(min(due, FAR) * SECOND), order, function)
        self._push(one_shot.due, one_shot)
        return one_shot

    def cancel(self, one_shot: OneShot) -> None:
        """Never call the function of a one-shot. Also fine when it was called."""
        if one_shot.function is idle:
            return
        one_shot.function = idle
        self._cancelled += 1
        if 2 * self._cancelled > len(self._heap) or self._heap[0][-1] is one_shot:
            self._forget(one_shot)

    def gap(self) -> float:
        """Tell for how long nothing is due, in seconds."""
        if self._queue or self._derived or self.decided or self._has_later:
            return 0.0
        due = self._heap[0][0] / SECOND if self._heap else math.inf
        return due - self._time()

    def queue(self, job: Job) -> None:
        """Call the step of a job in the next turn."""
        if self._has_border and not self.in_turn:
            self._later.append(job)
            return
        self._queue.append(job)
        self._wake()

    def derive(self, job: DerivedJob) -> None:
        """Call a job when the sensors of the turn are asked, before any step decides."""
        if self._has_border and not self.in_turn:
            self._derived_later.append(job)
            return
        self._derived.append(job)
        self._wake()

    def decide(self, decision: Callee) -> None:
        """Call something when all steps of the turn have decided."""
        if self._has_border and not self.in_turn:
            self._decided_later.append(decision)
            return
        self.decided.append(decision)
        if not self.in_turn:
            self._wake()

    def is_due(self, now: float) -> bool:
        if self._has_later:
            return True
        if not self._turning:
            return bool(self._heap)
        if self._sleep is None:
            return False
        return not self._heap or self._heap[0][0] <= round(now * SECOND) + EARLY

    @property
    def _has_later(self) -> bool:
        return bool(self._later or self._decided_later or self._derived_later)

    def look(self, now: float) -> None:
        """Begin to turn if something is due: called by a loop whose turns have a border."""
        if not self.is_due(now):
            return
        self.suspends.look()
        self._queue += self._later
        self.decided += self._decided_later
        self._derived += self._derived_later
        self._later, self._decided_later, self._derived_later = [], [], []
        self._begin()

    def drop(self, group: RateGroup) -> None:
        del self._groups[group.key]
        self._forget(group)

    def _forget(self, gone: RateGroup | OneShot | None) -> None:
        """Take an entry out, and all that were cancelled.

        The scheduler stands still when it was the last one.
        """
        self._cancelled = 0
        self._heap = [
            each
            for each in self._heap
            if each[-1] is not gone and not _is_cancelled(each[-1])
        ]
        heapq.heapify(self._heap)
        if self._turning and not self._heap:
            self._wake()

    def _nanoseconds(self) -> int:
        return round(self._time() * SECOND)

    def _push(self, due: int, entry: RateGroup | OneShot) -> None:
        number = next(self._numbers)
        rank = (*entry.rank, number) if isinstance(entry, RateGroup) else number
        heapq.heappush(self._heap, (due, entry.order, rank, entry))
        if not self._turning:
            self._wake()
        elif self._sleep is not None and self._heap[0][-1] is entry:
            self._set_timer(due)

    def _wake(self) -> None:
        if not self._has_border:
            self._begin()

    def _begin(self) -> None:
        if not self._turning:
            self._turn = self._batches()
            self._lead_on()
        elif self._sleep is not None and not self._sleep.done():
            self._sleep.set_result(None)

    def _lead_on(self) -> None:
        self._turning = True
        self._leader = None  # an eager task sets it before spawn returns
        spawn(self._loop, self._lead(), name="esair scheduler")

    async def _lead(self) -> None:
        me = self._leader = asyncio.current_task()
        try:
            while True:
                now = self._now
                for call in self._calls:
                    # By itself: what lies in a slot and is called in place is sought
                    # as a method first, which takes five times as long.
                    function = call.function
                    try:
                        rest = function(now)
                    except Exception:
                        _log.exception("a step of the scheduler raised; it goes on")
                        continue
                    if rest is not None:
                        self._lead_on()
                        await rest
                        return
                self.in_turn = True
                calls = next(self._turn, None)
                if calls is None:
                    self.in_turn = False
                    if self._cancelled >= len(self._heap) > 0:
                        self._forget(None)
                    if not (self._heap or self._queue or self._derived or self.decided):
                        return
                    await self._wait()
                    self._turn = self._batches()
                else:
                    self._calls = iter(calls)
        finally:
            if self._leader is me:
                self._leader = None
                self._turning = self.in_turn = False
                if self._timer is not None:
                    self._timer.close()
                    self._timer = None

    def _batches(self) -> Iterator[Iterable[Callee]]:
        """Go through one turn; what falls due in it waits for the next one."""
        if not self._has_border:
            # Not where it is woken: that may be within the check of a command.
            self.suspends.look()
        self.turns += 1
        self._now = self._time()
        now = round(self._now * SECOND)
        due = now + EARLY
        steps: list[tuple[Job, ...]] = []
        one_shots: list[OneShot] = []
        if self._queue:
            yield from self._queued(Order.POLL)
        while self._heap and self._heap[0][0] <= due:
            entry = self._heap[0][-1]
            if isinstance(entry, OneShot):
                heapq.heappop(self._heap)
                if entry.function is idle:
                    self._cancelled -= 1
                else:
                    one_shots.append(entry)
                continue
            jobs = entry.turn(now)
            _, order, rank, _ = self._heap[0]
            heapq.heapreplace(self._heap, (entry.due, order, rank, entry))
            if order == Order.POLL:
                yield jobs
            else:
                steps.append(jobs)
        while self._derived:
            yield self._shallowest()
        if self._queue:
            yield from self._queued(Order.STEP)
        if self.polled_in == self.turns:
            steps = [tuple(j for j in jobs if not j.waits(self._now)) for jobs in steps]
        yield from steps
        while self.decided:
            decided, self.decided = self.decided, []
            yield decided
        if one_shots:
            one_shots.sort(key=_moment)
            yield from (self._fired(each) for each in one_shots)

    def _queued(self, order: Order) -> Iterator[Iterable[Callee]]:
        queue = [job for job in self._queue if job.order <= order]
        self._queue = [job for job in self._queue if job.order > order]
        queue.sort(key=attrgetter("rank"))
        for job in queue:
            job.queued = False
        yield queue

    def _shallowest(self) -> Iterable[Callee]:
        """Take those that wait for none of the others: each is called once a turn."""
        depth = min(job.depth for job in self._derived)
        first = [job for job in self._derived if job.depth == depth]
        self._derived = [job for job in self._derived if job.depth > depth]
        first.sort(key=attrgetter("name"))
        return [job for job in first if job.taken()]

    def _fired(self, one_shot: OneShot) -> Iterable[Callee]:
        if one_shot.function is idle:
            return ()
        fired = OneShot(one_shot.due, one_shot.order, one_shot.function)
        one_shot.function = idle
        return (fired,)

    async def _wait(self) -> None:
        if self._has_border:
            # What the end of the turn has asked for is for the next one.
            self._later += self._queue
            self._decided_later += self.decided
            self._derived_later += self._derived
            self._queue, self.decided, self._derived = [], [], []
        elif (
            self._queue
            or self._derived
            or self.decided
            or self._heap[0][0] <= self._nanoseconds() + EARLY
        ):
            # Steps that take longer than their period must not starve everybody else.
            await asyncio.sleep(0)
            return
        if self._heap:
            self._set_timer(self._heap[0][0])
        self._sleep = self._loop.create_future()
        try:
            await self._sleep
        finally:
            self._sleep = None
            self._timer_due = -1

    def _set_timer(self, due: int) -> None:
        if self._needs_no_timer:
            return
        if self._timer is None:
            # A loop with a border looks by itself; its timer only wakes the selector.
            self._timer = timer_for(
                self._loop, ignore if self._has_border else self._wake
            )
        if due != self._timer_due:
            self._timer_due = due
            self._timer.set(due)


class _SchedulerBeside(Scheduler):
    """The scheduler of what is outside of the robot."""


def _is_cancelled(entry: RateGroup | OneShot) -> bool:
    return isinstance(entry, OneShot) and entry.function is idle


def _moment(one_shot: OneShot) -> tuple[Order, int]:
    return one_shot.order, one_shot.due
