"""An event loop whose turns can be repeated: one border, one look at the clock.

A turn is one pass of the loop, its border is the selector. There the clock is read once
(`TurnLoop.time` stands still until the next border), what has come in takes effect, and
the scheduler is woken if something is due. So what the robot does in a turn follows
from the time of the turn and from its entries alone, and a run can be replayed.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import math
import selectors
import time
from collections.abc import Callable
from typing import Any

from esair.loop._door import Door
from esair.loop._futures import raisable, settle
from esair.loop._ownership import current_owner
from esair.loop._scheduler import Scheduler
from esair.loop._tape import Player, TapeWriter


class When(float):
    """The moment of a timer; among equal moments the first one made comes first.

    Equal moments are usual where the clock stands still in a turn, and a heap keeps no
    order among equals: it would depend on timers of drivers, which a replay has not.
    """

    __slots__ = ("number",)
    number: int

    def __lt__(self, other: float) -> bool:
        if float(self) == float(other) and isinstance(other, When):
            return self.number < other.number
        return float(self) < float(other)


class TurnSelector(selectors.DefaultSelector):
    """The selector of a loop that has a border."""

    border: Callable[[float | None, Callable[[float | None], Any]], Any] | None = None

    def select(self, timeout: float | None = None) -> Any:
        if self.border is None:
            return super().select(timeout)
        return self.border(timeout, super().select)


class TurnLoop(asyncio.SelectorEventLoop):
    """The event loop of `esair.run`: what happens in it can be kept and repeated."""

    takes_entries = True
    wakes_scheduler = True

    def __init__(self, *, player: Player | None = None) -> None:
        self.turn = 0
        """The number of this turn, since the run began that is kept or repeated."""
        self.player = player
        self._plays = False
        self._tape: TapeWriter | None = None
        self._shift = 0.0
        if player is not None:
            self._shift = player.began - time.monotonic()
        self._now = time.monotonic() + self._shift
        self._timers = itertools.count()
        self._works = itertools.count(1)
        selector = TurnSelector()
        super().__init__(selector)
        self._door = Door.of(self)
        self._scheduler = Scheduler.of(self)
        self._beside = Scheduler.beside(self)
        selector.border = self._border

    def keep(self, tape: TapeWriter | None) -> None:
        if self._tape is not None:
            self._tape.close()
        self._tape = self._door.tape = tape
        if tape is not None:
            self.turn = 0
            tape.turn(self._now)

    def play(self) -> None:
        """Begin to repeat the run, in the turn in which its keeping began."""
        player = self.player
        assert player is not None
        self._plays = True
        self.turn = 0
        self._now = player.began
        self._door.tape = player
        player.begin(self._door)

    def time(self) -> float:
        """Return when this turn began, in seconds of the monotonic clock."""
        return self._now

    def call_at(  # type: ignore[override]
        self, when: float, callback: Any, *args: Any, context: Any = None
    ) -> asyncio.TimerHandle:
        """Call a function at a moment; functions of one moment in the order of calls."""
        moment = When(when)
        moment.number = next(self._timers)
        return super().call_at(moment, callback, *args, context=context)

    def run_in_executor(  # type: ignore[override]
        self, executor: Any, func: Callable[..., Any], *args: Any
    ) -> asyncio.Future[Any]:
        """Run a function in a thread; if a component asks, its end comes by the door."""
        if current_owner() is None:
            return super().run_in_executor(executor, func, *args)
        future: asyncio.Future[Any] = self.create_future()
        tag = ("thread", f"work {next(self._works)}")

        def work() -> None:
            result: Any = None
            error: BaseException | None = None
            try:
                result = func(*args)
            except BaseException as raised:  # contained, as in a task
                error = raisable(raised, "the behavior")
            with contextlib.suppress(RuntimeError):  # the loop is closed
                self._door.post(0, tag, settle, future, result, error)

        inner = super().run_in_executor(executor, work)
        future.add_done_callback(lambda done: done.cancelled() and inner.cancel())
        return future

    def _border(
        self, timeout: float | None, select: Callable[[float | None], Any]
    ) -> Any:
        if self._plays:
            return self._replay(timeout, select)
        door, scheduler, beside = self._door, self._scheduler, self._beside
        if door.waiting:
            timeout = 0.0
        elif timeout is None or timeout > 0.0:
            now = time.monotonic() + self._shift
            if scheduler.is_due(now) or beside.is_due(now):
                timeout = 0.0
            elif timeout is not None:  # asyncio counts from the beginning of the turn
                timeout = max(0.0, timeout - (now - self._now))
        events = select(timeout)
        self.turn += 1
        now = self._now = time.monotonic() + self._shift
        if self._tape is not None:
            self._tape.turn(now)
        if door.waiting:
            door.take()
        scheduler.look(now)
        beside.look(now)
        return events

    def _replay(
        self, timeout: float | None, select: Callable[[float | None], Any]
    ) -> Any:
        player = self.player
        assert player is not None
        events = select(0.0)
        self.turn += 1
        moment = None if player.is_over else player.next_turn()
        if moment is not None:
            self._now = moment
            player.take()
        else:
            player.end()
            events = [*events, *self._hurry(timeout, select)]
        if self._door.waiting:
            self._door.take()
        self._scheduler.look(self._now)
        self._beside.look(self._now)
        return events

    def _hurry(
        self, timeout: float | None, select: Callable[[float | None], Any]
    ) -> Any:
        """Nothing is repeated any more: time goes to what is next, without a wait."""
        gap = min(self._scheduler.gap(), self._beside.gap())
        gap = max(0.0, min(gap, math.inf if timeout is None else timeout))
        if self._door.waiting or gap == 0.0:
            return ()
        events = select(0.001)  # what threads still do
        if not (events or self._door.waiting) and gap < math.inf:
            self._now += gap
        return events
