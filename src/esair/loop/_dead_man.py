"""The dead man of each actuator: what has not been heard of for a time."""

from __future__ import annotations

import asyncio
import heapq
import itertools
from collections.abc import Callable
from typing import Protocol

from esair.loop._of_loop import OfLoop
from esair.loop._rate_group import REACHED, OneShot, Order, contained
from esair.loop._scheduler import Scheduler
from esair.loop._timer import clock_of


class Mortal(Protocol):
    """Something that has to be heard of again and again."""

    @property
    def dies(self) -> float:
        """At which moment it is dead unless it is heard of, in seconds."""

    def dead(self) -> None:
        """Learn that it is dead; it is watched no more."""


class DeadMan:
    """Watches one thing that must not stay silent."""

    __slots__ = ("_all", "armed", "moment", "mortal", "number")

    def __init__(self, loop: asyncio.AbstractEventLoop, mortal: Mortal) -> None:
        self._all = DeadMen.of(loop)
        self.mortal = mortal
        self.armed = False
        self.moment = 0.0  # when it is looked at next, if its number is not 0
        self.number = 0

    def arm(self) -> None:
        """Tell it that it is dead when its moment comes; that moves as it is heard of."""
        if not self.armed:
            self.armed = True
            self._all.add(self)

    def disarm(self) -> None:
        if self.armed:
            self.armed = False
            self._all.drop()


class DeadMen(OfLoop):
    """Looks after all of a loop behind one timer.

    A timer each, moved at each command, would cost more than the commands. Here being
    heard of costs nothing: at the moment that was known first it is looked whether it
    has moved. Each has one place in the heap at most, but for those that get impatient.
    Who is heard of in a turn is so before anybody is found dead in it.
    """

    __slots__ = ("_armed", "_heap", "_look", "_loop", "_numbers", "_scheduler", "_time")

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._scheduler = Scheduler.of(loop)
        self._time = clock_of(loop)
        self._numbers = itertools.count(1)
        self._heap: list[tuple[float, int, DeadMan]] = []
        self._look: OneShot | None = None
        self._armed = 0

    def add(self, man: DeadMan) -> None:
        self._armed += 1
        moment = man.mortal.dies
        if man.number and man.moment <= moment:
            return  # it has a place from before, and is looked at there
        self._place(man, moment, heapq.heappush)
        if self._heap[0][-1] is man or self._look is None:
            self._look_at(moment)

    def drop(self) -> None:
        """One has gone; the timer goes with the last one."""
        self._armed -= 1
        if self._armed == 0:
            for _, _, man in self._heap:
                man.number = 0
            self._heap.clear()
            self._look_no_more()

    def _place(self, man: DeadMan, moment: float, put: Callable[..., object]) -> None:
        man.moment = moment
        man.number = next(self._numbers)
        put(self._heap, (moment, man.number, man))

    def _look_at(self, moment: float) -> None:
        self._look_no_more()
        self._look = self._scheduler.at(moment, self._looks, order=Order.DEAD)

    def _look_no_more(self) -> None:
        if self._look is not None:
            self._scheduler.cancel(self._look)
            self._look = None

    def _looks(self, _now: float) -> None:
        self._look = None
        heap, now = self._heap, self._time() + REACHED
        while heap and heap[0][0] <= now:
            _, number, man = heap[0]
            if number == man.number and man.armed:
                moment = man.mortal.dies
                if moment > now:
                    self._place(man, moment, heapq.heapreplace)
                    continue
            heapq.heappop(heap)
            if number == man.number:
                man.number = 0
                if man.armed:
                    man.disarm()
                    contained(self._loop, man.mortal.dead)
        if heap and self._look is None:
            self._look_at(heap[0][0])
