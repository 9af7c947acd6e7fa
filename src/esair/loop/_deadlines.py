"""All deadlines of a loop, behind one timer; they take effect at the end of a turn.

Who had no chance to run has not timed out: a deadline that passed while the loop was held
up, or the whole computer, is put off once, so that what has come meanwhile, or is just
about to, is still in time.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from operator import attrgetter
from typing import Any

from esair.loop._futures import wake
from esair.loop._of_loop import OfLoop
from esair.loop._rate_group import REACHED, Order, contained
from esair.loop._scheduler import Scheduler
from esair.loop._timer import clock_of

HELD_UP = 0.1
"""How much too late the loop comes to a deadline if it was held up, in seconds."""

CHANCE = 0.1  # by how much a deadline is put off that has passed meanwhile, in seconds


class Deadline:
    """A function that is called at a moment, unless it is cancelled before."""

    __slots__ = ("_arguments", "_deadlines", "_function", "put_off", "when")

    def __init__(
        self,
        deadlines: Deadlines,
        when: float,
        function: Callable[..., object],
        arguments: tuple[Any, ...],
    ) -> None:
        self.when: float = when
        self.put_off: bool = False
        self._deadlines = deadlines
        self._function = function
        self._arguments = arguments

    def start(self, when: float) -> None:
        """Call it at a moment of the loop's clock, whether or not it was called before."""
        self.when = when
        self.put_off = False
        deadlines = self._deadlines
        deadlines._waiting[self] = None  # noqa: SLF001 - two halves of one
        if when < deadlines._looks_at:  # noqa: SLF001
            deadlines._look_at(when)  # noqa: SLF001

    def start_by(self, when: float) -> None:
        """Call it at a moment, unless it is called before that anyway.

        One that is put off stays so: whose time was over before gets its chance.
        """
        if when < self.when and not self.put_off:
            self.start(when)

    def cancel(self) -> None:
        """Do not call it, until it is started again. Also fine when it has been called."""
        self.when = math.inf
        self.put_off = False
        self._deadlines._waiting.pop(self, None)  # noqa: SLF001 - two halves of one

    def _call(self) -> None:
        self._function(*self._arguments)


class Deadlines(OfLoop):
    """Calls functions at their moments, most of which never come.

    Nearly every wait is over long before its deadline, and a timer of the loop for
    each would cost more than many a wait. Here it is an entry in a dictionary: the
    one timer of the loop is moved when an earlier moment comes, and else left alone.
    When it fires for an entry that has gone, it looks for the next. The timer only
    rings: the functions are called by the scheduler, when all that is due at the same
    moment has been done, so it does not matter who set what first.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._time = clock_of(loop)
        self._scheduler = self._scheduler_of(loop)
        self._waiting: dict[Deadline, None] = {}
        self._looks_at = math.inf
        self._timer: asyncio.TimerHandle | None = None

    _scheduler_of = Scheduler.of

    @classmethod
    def beside(cls, loop: asyncio.AbstractEventLoop) -> Deadlines:
        """Return those of what is outside of the robot; see `Scheduler.beside`."""
        if getattr(loop, "wakes_scheduler", False):
            return _DeadlinesBeside.of(loop)
        return cls.of(loop)

    def after(
        self, seconds: float, function: Callable[..., object], *arguments: Any
    ) -> Deadline:
        """Call a function in some seconds, in the loop."""
        when = self._time() + seconds
        deadline = Deadline(self, when, function, arguments)
        self._waiting[deadline] = None
        if when < self._looks_at:
            self._look_at(when)
        return deadline

    def idle(self, function: Callable[..., object], *arguments: Any) -> Deadline:
        """Return a deadline for one wait after the other, which has to be started."""
        return Deadline(self, math.inf, function, arguments)

    async def wait(self, future: asyncio.Future[Any], seconds: float) -> None:
        """Wait until a future is done, or for some seconds; it goes on either way."""
        over: asyncio.Future[None] = self._loop.create_future()
        deadline = self.after(max(0.0, seconds), wake, over)
        try:
            await asyncio.wait({future, over}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            deadline.cancel()

    def _look_at(self, when: float) -> None:
        if self._timer is not None:
            self._timer.cancel()
        self._looks_at = when
        self._timer = self._loop.call_at(when, self._ring, when)

    def _ring(self, when: float) -> None:
        self._timer = None
        if self._waiting:
            self._scheduler.at(when, self._look, order=Order.EXPIRY)
        else:
            self._looks_at = math.inf

    def _look(self, _now: float) -> None:
        now = self._time() + REACHED
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        self._looks_at = math.inf
        due = sorted(
            (each for each in self._waiting if each.when <= now), key=attrgetter("when")
        )
        for deadline in due:
            if deadline not in self._waiting or deadline.when > now:
                continue  # one before it has cancelled it, or started it anew
            if now - deadline.when > HELD_UP and not deadline.put_off:
                deadline.put_off, deadline.when = True, now + CHANCE
            else:
                deadline.cancel()
                contained(self._loop, deadline._call)  # noqa: SLF001 - two halves of one
        earliest = min((each.when for each in self._waiting), default=math.inf)
        if earliest < self._looks_at:
            self._look_at(earliest)


class _DeadlinesBeside(Deadlines):
    """The deadlines of what is outside of the robot."""

    _scheduler_of = Scheduler.beside
