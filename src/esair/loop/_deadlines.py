"""What has not come until a moment: deadlines, readings too old, dead men.

All of a loop lie in one heap on the grid of nanoseconds, and most never come: starting one
anew, or cancelling it, leaves its place in the heap alone, and costs next to nothing. At the
moment that was known first it is looked whether it has moved.

They are called last in a turn, in the order of `Order`, and two turns after their moment:
what a driver's own timer of that moment brings takes two turns (the timer, the coroutine,
the door), and is in time. A loop that comes late waits for nothing any more.

Who had no chance to run has not timed out: a deadline that passed while the loop was held
up, or the whole computer, is put off once, so that what has come meanwhile, or is just
about to, is still in time. What stands for the safety of a robot is not put off.
"""

from __future__ import annotations

import asyncio
import heapq
import itertools
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from esair.loop._light_task import ignore, wake
from esair.loop._of_loop import OfTurn, turn_of
from esair.loop._scheduler import (
    NEVER,
    NOW,
    REACHED,
    SECOND,
    Order,
    contained,
    on_grid,
)

if TYPE_CHECKING:
    from esair.loop._scheduler import Scheduler
    from esair.loop._turn import Turn

HELD_UP = 100_000_000
"""How much too late the loop comes to a deadline if it was held up, in ns."""

CHANCE = 0.1  # by how much a deadline is put off that has passed meanwhile, in seconds

LATE = 1_000_000
"""How late a loop is that does not wait for timers of the same moment, in ns."""

FEW = 64  # with fewer places than that nobody looks which are of no use any more


class Deadline:
    """A function that is called at a moment, unless it is cancelled before."""

    __slots__ = (
        "_arguments",
        "_deadlines",
        "_function",
        "_is_for_once",
        "is_patient",
        "order",
        "place",
        "put_off",
        "when",
    )

    def __init__(
        self,
        deadlines: Deadlines,
        function: Callable[..., object],
        arguments: tuple[Any, ...] = (),
        *,
        order: Order = Order.EXPIRY,
        is_patient: bool = True,
        is_for_once: bool = False,
    ) -> None:
        self._is_for_once = is_for_once
        self.when: float = NEVER
        """The moment, in seconds of the loop's clock."""
        self.put_off: bool = False
        self.order: Order = order
        self.is_patient: bool = is_patient
        """Whether it is put off if the loop was held up."""
        self.place: float = NEVER  # when it is looked at, in ns
        self._deadlines = deadlines
        self._function = function
        self._arguments = arguments

    def start(self, when: float) -> None:
        """Call it at a moment of the loop's clock, whether or not it was called before."""
        self.when = when
        self.put_off = False
        self._deadlines.add(self, when)

    def start_by(self, when: float) -> None:
        """Call it at a moment, unless it is called before that anyway.

        One that is put off stays so: whose time was over before gets its chance.
        """
        if when < self.when and not self.put_off:
            self.start(when)

    def cancel(self) -> None:
        """Do not call it, until it is started again. Also fine when it has been called."""
        self.when = NEVER
        self.put_off = False
        if self._is_for_once:  # its place outlives it, and may keep nothing alive
            self._function, self._arguments = ignore, ()

    def moment(self) -> float:
        """Return its moment, in seconds: it may have moved meanwhile."""
        return self.when

    def call(self) -> None:
        """Call the function: the moment has come."""
        function, arguments = self._function, self._arguments
        self.cancel()
        function(*arguments)


class DeadMan(Deadline):
    """Watches one thing that must not stay silent; being heard of costs nothing.

    Who is heard of in a turn is so before anybody is found dead in it.

    Args:
        loop: Where it is watched.
        dies: Tells at which moment it is dead unless it is heard of, in seconds.
        dead: Called when it is dead; it is watched no more.
    """

    __slots__ = ("_dies", "armed")

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        dies: Callable[[], float],
        dead: Callable[[], object],
    ) -> None:
        super().__init__(Deadlines.of(loop), dead, order=Order.DEAD, is_patient=False)
        self._dies = dies
        self.armed: bool = False

    def arm(self) -> None:
        """Tell it that it is dead when its moment comes; that moves as it is heard of."""
        if not self.armed:
            self.armed = True
            self.start(self._dies())

    def hurry(self) -> None:
        """Its moment may be an earlier one from now on."""
        if self.armed:
            self.start(self._dies())

    def disarm(self) -> None:
        """Watch it no more."""
        self.armed = False
        self.cancel()

    def moment(self) -> float:
        """Return when it is dead, as far as is known now."""
        return self._dies() if self.armed else NEVER

    def call(self) -> None:
        """Tell it that it is dead."""
        self.disarm()
        self._function()


class Deadlines(OfTurn):
    """Calls functions at their moments, most of which never come."""

    def __init__(self, turn: Turn, scheduler: Scheduler) -> None:
        self.due: float = NEVER
        """When it has to look next, in ns."""
        self.time: Callable[[], float] = turn.time
        self._turn = turn
        self._scheduler = scheduler
        self._numbers = itertools.count(1)
        self._heap: list[tuple[float, int, Deadline]] = []
        self._crowd = FEW  # with how many places it is looked which are of use
        self._later: list[Deadline] = []  # whose moment has come in this turn,
        self._next: list[Deadline] = []  # in the one before it,
        self._ripe: list[Deadline] = []  # and who are called in this turn

    @classmethod
    def beside(cls, loop: asyncio.AbstractEventLoop) -> Deadlines:
        """Return those of what is outside of the robot; see `Scheduler.beside`."""
        return turn_of(loop).deadlines_outside

    def after(
        self, seconds: float, function: Callable[..., object], *arguments: Any
    ) -> Deadline:
        """Call a function in some seconds, in the loop."""
        deadline = Deadline(self, function, arguments, is_for_once=True)
        deadline.when = when = self.time() + seconds
        self.add(deadline, when)
        return deadline

    def at(
        self, when: float, function: Callable[..., object], *, order: Order
    ) -> Deadline:
        """Call a function at a moment of the loop's clock, also if it was held up."""
        deadline = Deadline(
            self, function, order=order, is_patient=False, is_for_once=True
        )
        deadline.start(when)
        return deadline

    def idle(self, function: Callable[..., object], *arguments: Any) -> Deadline:
        """Return a deadline for one wait after the other, which has to be started."""
        return Deadline(self, function, arguments)

    async def wait(self, future: asyncio.Future[Any], seconds: float) -> None:
        """Wait until a future is done, or for some seconds; it goes on either way."""
        over: asyncio.Future[None] = self._turn.loop.create_future()
        deadline = self.after(max(0.0, seconds), wake, over)
        try:
            await asyncio.wait({future, over}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            deadline.cancel()

    async def pulse(self, pulse: asyncio.Future[None], seconds: float) -> None:
        """Wait until others wake a future of one's own, or for some seconds."""
        deadline = self.after(max(0.0, seconds), wake, pulse)
        try:
            await pulse
        finally:
            deadline.cancel()

    @property
    def waiting(self) -> list[Deadline]:
        """Those that are to be called."""
        placed = (each for place, _, each in self._heap if place == each.place)
        reached = (*self._later, *self._next, *self._ripe)
        return [each for each in (*placed, *reached) if each.moment() < NEVER]

    def gap(self) -> float:
        """Tell for how long none is due, in seconds."""
        return self.due / SECOND - self.time()

    def add(self, deadline: Deadline, when: float) -> None:
        """Look at a deadline at a moment, unless it is looked at before."""
        place = on_grid(when)
        if place / SECOND < when:
            place += 1  # called before, who waits for the rest would wait for ever
        if deadline.place <= place:
            return
        heap = self._heap
        if len(heap) > self._crowd:
            self._tidy()
            heap = self._heap
        deadline.place = place
        heapq.heappush(heap, (place, next(self._numbers), deadline))
        if place < self.due:
            self.due = place
            self._turn.want(place)

    def look(self, reached: float) -> None:
        """See which moments have come; called at each border until all are called."""
        heap, reached_now = self._heap, list[Deadline]()
        self._ripe += self._next
        self._next = self._later
        while heap and heap[0][0] <= reached:
            place, _, deadline = heapq.heappop(heap)
            if place != deadline.place:
                continue  # it has another one
            deadline.place = NEVER
            moment = deadline.moment()
            if moment == NEVER:
                continue
            late = reached - on_grid(moment)
            if late < 0:
                self.add(deadline, moment)
            elif late > HELD_UP and deadline.is_patient and not deadline.put_off:
                deadline.put_off, deadline.when = True, self.time() + CHANCE
                self.add(deadline, deadline.when)
            elif late > LATE:
                self._ripe.append(deadline)
            else:
                reached_now.append(deadline)
        self._later = reached_now
        if self._ripe:
            self._scheduler.last(self)
        if self._next or self._later:
            self.due = NOW
        else:
            self.due = heap[0][0] if heap else NEVER

    def function(self, _now: float) -> None:
        """Call those whose time it is: the last thing in a turn."""
        ripe, self._ripe = self._ripe, []
        reached = self.time() + REACHED
        for each in sorted(ripe, key=_order):
            moment = each.moment()
            if moment <= reached:
                contained(self._turn.loop, each.call)
            elif moment < NEVER and each.place == NEVER:  # it was heard of meanwhile
                self.add(each, moment)

    def _tidy(self) -> None:
        """Forget the places of those that were cancelled, and of earlier moments."""
        left = []
        for entry in self._heap:
            place, _, each = entry
            if place == each.place:
                if each.moment() < NEVER:
                    left.append(entry)
                else:
                    each.place = NEVER
        heapq.heapify(left)
        self._heap = left
        self._crowd = max(FEW, 2 * len(left))


def _order(deadline: Deadline) -> tuple[Order, float]:
    return deadline.order, deadline.moment()
