"""What a scheduler calls: jobs in groups of one rate and phase, and one-shots.

All rates share one grid of whole nanoseconds that begins where the clock does, so
the steps of harmonic rates meet: the second step at 10 Hz and the fourth at 20 Hz
are due at the same nanosecond, also after a month.
"""

from __future__ import annotations

import asyncio
import bisect
import enum
import math
from collections.abc import Awaitable, Callable, Iterable
from operator import attrgetter
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from fractions import Fraction

    from esair.loop._deadlines import Deadline

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
    DEAD = 5  # make an actuator safe that nobody has written until this moment


class Callee(Protocol):
    """Something with a function that the scheduler calls."""

    @property
    def function(self) -> Step:
        """What to call, with the time of the turn."""


class Queue(Protocol):
    """Takes jobs that are to be called in the next turn."""

    def queue(self, job: Job) -> None:
        """Call the step of a job in the next turn."""

    def derive(self, job: DerivedJob) -> None:
        """Call a job before the steps of a turn."""

    def drop(self, group: RateGroup) -> None:
        """Call nothing of a group any more."""


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

    __slots__ = ("deadline", "due", "function", "order")

    def __init__(self, due: int, order: Order, function: Step) -> None:
        self.due = due  # in nanoseconds of the loop's clock
        self.order = order
        self.function = function
        self.deadline: Deadline | None = None
        """What calls it, if it sees that something has not come."""


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
        scheduler: Queue,
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
        self.scheduler = scheduler
        self.function = function
        self.group = group
        self.order = order
        self.name = name
        self.queued = False
        self._number = number
        self._skipped_before = group.skipped if group is not None else 0

    @property
    def skipped(self) -> int:
        """How many steps were left out because they came too late."""
        return (
            self.group.skipped - self._skipped_before if self.group is not None else 0
        )

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

    __slots__ = ("depth",)

    def __init__(self, scheduler: Queue, function: Step, name: str, depth: int) -> None:
        super().__init__(
            scheduler, function, None, order=Order.STEP, name=name, number=0
        )
        self.depth = depth

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
        self.key = (order, period, phase)
        self.order = order
        self.rank = (float(period), phase)
        self.jobs: tuple[Job, ...] = ()
        self._near: list[object] = []
        self.skipped = 0
        self._numerator = period.numerator
        self._denominator = period.denominator
        self._phase = phase
        self.moment = 0  # when those that are called now were due
        self._count = (after - phase) * self._denominator // self._numerator
        self.due = self._at_count()
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
