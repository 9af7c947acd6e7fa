"""The scheduler: one timer and one task that call every step when it is due.

A step is a plain function, called as ``step(now)``. So a thousand steps cost a
thousand calls, not a thousand wake-ups of tasks. A step that has to wait returns
the rest of its work as an awaitable; the task that turned the scheduler then stays with
that rest, and a new task goes on turning (the *leader and followers* pattern), so
that whatever the step began stays in the task that began it.

All rates share one grid of whole nanoseconds that begins where the clock does, so
the steps of harmonic rates meet: the second step at 10 Hz and the fourth at 20 Hz
are due at the same nanosecond, also after a month.

In a turn everything that is due is called in one order (`Order`): sensors are asked,
what is derived of them is computed, steps decide, what was decided leaves, those go on
who waited for the moment, and then what has not come until now is over: a call, a
reading that was good until now, an actuator that nobody has written.

The task is woken at the border of a turn and nowhere else, by what was asked for before
it: so what is called in a turn depends on nobody who happens to keep it awake.
"""

from __future__ import annotations

import asyncio
import bisect
import enum
import heapq
import itertools
import logging
import math
from collections.abc import Awaitable, Callable, Iterable, Iterator
from operator import attrgetter
from typing import TYPE_CHECKING, Any, Protocol

from esair.loop._of_loop import OfTurn, turn_of
from esair.loop._ownership import spawn

if TYPE_CHECKING:
    from fractions import Fraction

    from esair.loop._turn import Turn


Step = Callable[[float], Awaitable[object] | None]

SECOND = 1_000_000_000  # in nanoseconds

NEVER = math.inf
"""The moment of what is not to come."""

NOW = -math.inf
"""The moment of what is to come as soon as possible."""

EARLY = 1_000
"""Timers may fire a hair early; what is due so soon is due, in nanoseconds."""

REACHED = (EARLY + 2) / SECOND
"""How early a call comes at most, in seconds: moments are rounded to nanoseconds."""


FAR = 9e9
"""What is due later than that many seconds is due then: timers end there."""


def on_grid(when: float) -> float:
    """Return a moment in nanoseconds: whole ones, as far as timers count."""
    return round(when * SECOND) if when < FAR else when * SECOND


class Order(enum.IntEnum):
    """In which order the things of one instant are called."""

    POLL = 0  # ask a sensor
    STEP = 1  # decide; what was decided leaves when all have
    WAKE = 2  # go on with what waited for this moment
    EXPIRY = 3  # end a call or a wait that was not over until this moment
    STALE = 4  # see that a reading has become too old, or that a hold has ended
    DARK = 5  # the same for a guard: what moves by that reading is safe before
    DEAD = 6  # make an actuator safe that nobody has written until this moment


class Callee(Protocol):
    """Something with a function that the scheduler calls."""

    @property
    def function(self) -> Step:
        """What to call, with the time of the turn."""


def contained(
    loop: asyncio.AbstractEventLoop, function: Callable[..., object], *arguments: Any
) -> None:
    """Call a function; what it raises is told to the loop, as of any timer."""
    try:
        function(*arguments)
    except Exception as error:
        message = f"{function!r:.200} raised at its moment"
        loop.call_exception_handler({"message": message, "exception": error})


def idle(_now: float) -> None:
    """Do nothing: the step of what was stopped."""


def _never(_now: float) -> bool:
    """Wait for no sample."""
    return False


class OneShot:
    """One call at one moment."""

    __slots__ = ("due", "function")

    order = Order.WAKE

    def __init__(self, due: int, function: Step) -> None:
        self.due: int = due  # in nanoseconds of the loop's clock
        self.function: Step = function


class Job:
    """A step that the scheduler calls again and again."""

    __slots__ = (
        "_number",
        "_skipped_before",
        "function",
        "group",
        "name",
        "near",
        "order",
        "queued",
        "scheduler",
        "waits",
    )

    def __init__(
        self,
        scheduler: Scheduler,
        function: Step,
        group: RateGroup | None,
        *,
        order: Order,
        name: str,
        number: int,
    ) -> None:
        self.waits: Callable[[float], bool] = _never
        """Says whether it waits for a sensor that was asked in this turn; if it does it
        is called by somebody else, when there is an answer."""
        self.near: tuple[object, ...] = ()
        """What the step looks at, as long as the job is not stopped."""
        self.scheduler: Scheduler = scheduler
        self.function: Step = function
        self.group: RateGroup | None = group
        self.order: Order = order
        self.name: str = name
        self.queued: bool = False
        self._number = number
        self._skipped_before = group.skipped if group is not None else 0

    @property
    def skipped(self) -> int:
        """How many steps were left out because they came too late."""
        group = self.group
        return 0 if group is None else group.skipped - self._skipped_before

    @property
    def moment(self) -> float:
        """At which moment the step that runs was due, in seconds of the loop's clock."""
        return self.group.moment / SECOND if self.group is not None else 0.0

    @property
    def rank(self) -> tuple[int, str, int]:
        """Its place among the jobs of one instant: no matter when each was made."""
        return (self.order, self.name, self._number)

    def soon(self) -> None:
        """Have the step called in the next turn, once."""
        if not self.queued:
            self.queued = True
            self.scheduler.queue(self)

    def stop(self) -> None:
        """Never call the step again."""
        self.function, self.near = idle, ()
        group = self.group
        if group is not None and self in group.jobs:
            group.take(job for job in group.jobs if job is not self)
            if not group.jobs:
                self.scheduler.drop(group)


class DerivedJob(Job):
    """A step that computes something of new readings, before others decide on it.

    Attributes:
        depth: How many of its kind are computed before it, one of the other.
    """

    queued: bool

    __slots__ = ("depth",)

    def __init__(
        self, scheduler: Scheduler, function: Step, name: str, depth: int
    ) -> None:
        super().__init__(
            scheduler, function, None, order=Order.STEP, name=name, number=0
        )
        self.depth: int = depth

    def soon(self) -> None:
        """Have it called before any step of the turn decides, once."""
        if not self.queued:
            self.queued = True
            self.scheduler.derive(self)

    def taken(self) -> bool:
        """Take it out of the queue; tells whether it is still to be called."""
        queued, self.queued = self.queued, False
        return queued


class RateGroup:
    """The jobs that share an order, a period and a phase. It never drifts."""

    def __init__(self, order: Order, period: Fraction, phase: int, after: int) -> None:
        self.key: tuple[Order, Fraction, int] = (order, period, phase)
        self.order = order
        self.rank: tuple[float, int] = (float(period), phase)
        self.jobs: tuple[Job, ...] = ()
        self._near: list[object] = []
        self.skipped: int = 0
        self._numerator = period.numerator
        self._denominator = period.denominator
        self._phase = phase
        self.moment: int = 0  # when those that are called now were due
        self._count = (after - phase) * self._denominator // self._numerator
        self.due: int = self._at_count()
        if self.due < after:
            self._count += 1
            self.due = self._at_count()

    def _at_count(self) -> int:
        return self._phase + self._count * self._numerator // self._denominator

    def add(self, job: Job) -> None:
        jobs = list(self.jobs)
        bisect.insort(jobs, job, key=attrgetter("rank"))
        self.take(jobs)

    def take(self, jobs: Iterable[Job]) -> None:
        """Have these jobs from now on."""
        self.jobs = tuple(jobs)
        self._near = []

    def turn(self, now: int) -> tuple[Job, ...]:
        """Move on to the next moment that has not passed; return whom to call."""
        self.moment = self.due
        behind = now - self.due
        missed = (behind + EARLY) * self._denominator // self._numerator
        if missed > 0:
            self.skipped += missed
            self._count += missed
        self._count += 1
        self.due = self._at_count()
        if not self._near:
            parts = ((job, job.function, *job.near) for job in self.jobs)
            self._near = [each for part in parts for each in part]
        # A copy counts one reference more to each, so the processor fetches side by
        # side what the steps would wait for one by one: a tenth of their time and more.
        self._near.copy()
        return self.jobs


def whole_period(seconds: float) -> Fraction:
    """Return a period in nanoseconds: that of the simple rate in Hz which it means."""
    from fractions import Fraction  # it loads a lot that a robot without rates lacks

    rate = 1.0 / seconds
    simple = Fraction(rate).limit_denominator(1_000_000)
    if simple > 0 and abs(float(simple) - rate) <= 1e-12 * rate:
        return SECOND / simple
    return Fraction(max(1, round(seconds * SECOND)))


_log = logging.getLogger("esair")

SPREAD = 2_500_000  # phases of the same period are at least this far apart, in ns
CROWD = 32  # how many components share a phase before another phase is used


class Asked:
    """What was asked for, and is called in one turn."""

    __slots__ = ("decided", "derived", "jobs", "last", "polls")

    def __init__(self) -> None:
        self.polls: list[Job] = []
        self.jobs: list[Job] = []
        self.derived: list[DerivedJob] = []
        self.decided: list[Callee] = []
        """What is called when all steps of the turn have decided."""
        self.last: list[Callee] = []
        """What is called when everything else was."""

    def __bool__(self) -> bool:
        return bool(
            self.jobs or self.polls or self.derived or self.decided or self.last
        )

    def take(self, left: Asked) -> None:
        """Take over what was asked for of another turn."""
        for name in Asked.__slots__:
            asked = getattr(left, name)
            getattr(self, name).extend(asked)
            asked.clear()


class Scheduler(OfTurn):
    """Calls steps when they are due. Each event loop has two: see `beside`."""

    def __init__(self, turn: Turn) -> None:
        self.due: float = NEVER
        """When it has to look next, in ns; never amid a turn: it says so when it sleeps."""
        self._loops_turn = turn
        self._loop = turn.loop
        self._time = turn.time
        self.in_turn: bool = False
        """Somebody's step runs now; what it asks for is for this turn."""
        self._now_asked = Asked()
        self._next_asked = Asked()
        """What is asked for when the turn has begun: for the next one."""
        self._rests = True
        """Nobody turns it, or who does sleeps."""
        self.turns: int = 0  # how many turns have begun: the number of this one
        self.polled_in = 0
        """The last turn in which a sensor was asked that did not answer at once."""
        self._numbers = itertools.count()
        self._heap: list[tuple[int, int, Any, RateGroup | OneShot]] = []
        self._cancelled = 0  # how many one-shots in the heap nobody wants any more
        self._groups: dict[tuple[Order, Fraction, int], RateGroup] = {}
        self._phases = 1
        self._turn: Iterator[Iterable[Callee]] | None = None
        self._calls: Iterator[Callee] = iter(())
        self._now = 0.0
        self._turning = False
        self._leader: asyncio.Task[None] | None = None
        self._sleep: asyncio.Future[None] | None = None

    @classmethod
    def beside(cls, loop: asyncio.AbstractEventLoop) -> Scheduler:
        """Return the one for what is outside of the robot: drivers, a simulation.

        A replay has none of that, and nobody else may share the robot's own turns.
        """
        return turn_of(loop).outside

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
            group = RateGroup(*key, after=round(self._time() * SECOND))
            self._groups[key] = group
        job = self._job(function, group, order, name)
        group.add(job)
        if len(group.jobs) == 1:
            self._push(group.due, group)
        return job

    def jobs(self) -> Iterator[Job]:
        """Return those that have a period."""
        for group in tuple(self._groups.values()):
            yield from group.jobs

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

    def at(self, due: float, function: Step) -> OneShot:
        """Call a function once, at a moment of the loop's clock.

        What sees that something has not come until then is a deadline.
        """
        one_shot = OneShot(round(min(due, FAR) * SECOND), function)
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
        if self._now_asked or self._next_asked:
            return 0.0
        due = self._heap[0][0] / SECOND if self._heap else math.inf
        return due - self._time()

    def queue(self, job: Job) -> None:
        """Call the step of a job in the next turn."""
        asked = self._now_asked if self.in_turn else self._asked()
        (asked.jobs if job.order else asked.polls).append(job)

    def derive(self, job: DerivedJob) -> None:
        """Call a job when the sensors of the turn are asked, before any step decides."""
        (self._now_asked if self.in_turn else self._asked()).derived.append(job)

    def decide(self, decision: Callee) -> None:
        """Call something when all steps of the turn have decided."""
        (self._now_asked if self.in_turn else self._asked()).decided.append(decision)

    def last(self, callee: Callee) -> None:
        """Call something when all else of the next turn was called."""
        self._next_asked.last.append(callee)
        self._want(NOW)

    def _asked(self) -> Asked:
        """Return what is asked for outside of a turn: it is for the next one."""
        self._want(NOW)
        return self._next_asked

    def _want(self, due: float) -> None:
        if self._rests and due < self.due:
            self.due = due
            self._loops_turn.want(due)

    def look(self, _reached: float) -> None:
        """Begin to turn: something is due; called at the border."""
        self._rests, self.due = False, NEVER
        asked = self._next_asked
        if asked:
            self._now_asked, self._next_asked = asked, self._now_asked
        if not self._turning:
            self._lead_on()
        elif self._sleep is not None and not self._sleep.done():
            self._sleep.set_result(None)

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
            if each[-1] is not gone and getattr(each[-1], "function", None) is not idle
        ]
        heapq.heapify(self._heap)
        if self._turning and not self._heap:
            self._want(NOW)

    def _push(self, due: int, entry: RateGroup | OneShot) -> None:
        number = next(self._numbers)
        rank = (*entry.rank, number) if isinstance(entry, RateGroup) else number
        heapq.heappush(self._heap, (due, entry.order, rank, entry))
        if not self._turning:
            self._want(NOW)
        elif self._heap[0][-1] is entry:
            self._want(due)

    def _lead_on(self) -> None:
        self._turning = True
        self._leader = None  # an eager task sets it before spawn returns
        spawn(self._loop, self._lead(), name="esair scheduler")

    async def _lead(self) -> None:
        me, turn = asyncio.current_task(), self._loops_turn
        # What is outside of the robot is not repeated, and virtual time stands still.
        budget = turn.budget if self is turn.robot and not turn.virtual else None
        self._leader = me
        try:
            while True:
                now = self._now
                for call in self._calls:
                    function = call.function  # hot
                    try:
                        rest = function(now)
                    except Exception:
                        _log.exception("a step of the scheduler raised; it goes on")
                        continue
                    if rest is not None:
                        self._lead_on()
                        await rest
                        return
                if self._turn is None:
                    if budget and budget.clock() > budget.late:
                        await budget.give_way(0, 1)  # it was held: what is known is old
                        self._now_asked.take(self._next_asked)
                    self._turn = self._batches()
                self.in_turn = True
                calls = next(self._turn, None)
                if calls is None:
                    self.in_turn, self._turn = False, None
                    if self._cancelled >= len(self._heap) > 0:
                        self._forget(None)
                    if not (self._heap or self._now_asked or self._next_asked):
                        return
                    try:
                        await self._fall_asleep()
                    finally:
                        self._sleep = None
                else:
                    self._calls = iter(calls)
        finally:
            if self._leader is me:
                self._leader = self._turn = None
                self._turning = self.in_turn = False
                self._rests, self.due = True, NEVER

    def _batches(self) -> Iterator[Iterable[Callee]]:
        """Go through one turn; what falls due in it waits for the next one."""
        self.turns += 1
        self._now = self._time()
        now = round(self._now * SECOND)
        due = now + EARLY
        asked = self._now_asked
        steps: list[tuple[Job, ...]] = []
        one_shots: list[OneShot] = []
        if asked.polls:
            polls, asked.polls = asked.polls, []
            yield _taken(polls)
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
        while asked.derived:
            yield self._shallowest()
        if asked.jobs or asked.polls:
            queued = asked.polls + asked.jobs
            asked.polls, asked.jobs = [], []
            yield _taken(queued)
        if self.polled_in == self.turns:
            steps = [tuple(j for j in jobs if not j.waits(self._now)) for jobs in steps]
        yield from steps
        while asked.decided:
            decided, asked.decided = asked.decided, []
            yield decided
        if one_shots:
            one_shots.sort(key=attrgetter("due"))
            yield from (self._fired(each) for each in one_shots)
        if asked.last:
            last, asked.last = asked.last, []
            yield last

    def _shallowest(self) -> Iterable[Callee]:
        """Take those that wait for none of the others: each is called once a turn."""
        asked = self._now_asked
        depth = min(job.depth for job in asked.derived)
        first = [job for job in asked.derived if job.depth == depth]
        asked.derived = [job for job in asked.derived if job.depth > depth]
        first.sort(key=attrgetter("name"))
        return [job for job in first if job.taken()]

    def _fired(self, one_shot: OneShot) -> Iterable[Callee]:
        if one_shot.function is idle:
            return ()
        fired = OneShot(one_shot.due, one_shot.function)
        one_shot.function = idle
        return (fired,)

    def _fall_asleep(self) -> asyncio.Future[None]:
        if self._now_asked:  # by the end of the turn: it is for the next one
            self._next_asked.take(self._now_asked)
        self._sleep = sleep = self._loop.create_future()
        self._rests = True
        if self._next_asked:
            self._want(NOW)
        elif self._heap:
            self._want(self._heap[0][0])
        return sleep


def _taken(jobs: list[Job]) -> list[Job]:
    """Return jobs in their order, no more queued."""
    if len(jobs) > 1:
        jobs.sort(key=attrgetter("rank"))
    for job in jobs:
        job.queued = False
    return jobs
