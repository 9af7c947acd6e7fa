"""An event loop whose turns can be repeated: one border, one look at the clock.

A turn is one pass of the loop, its border is the selector. There the clock is read once
(`TurnLoop.time` stands still until the next border), what has come in takes effect, and
the scheduler is woken if something is due. So what the robot does in a turn follows
from the time of the turn and from its entries alone, and a run can be replayed.
"""

from __future__ import annotations

import asyncio
import itertools
import selectors
import time
from collections.abc import Callable
from typing import Any

from esair.loop._door import Door
from esair.loop._scheduler import Scheduler
from esair.loop._tape import Player, Recorder


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
        """Wait for descriptors, and begin a turn."""
        if self.border is None:
            return super().select(timeout)
        return self.border(timeout, super().select)


class TurnLoop(asyncio.SelectorEventLoop):
    """The event loop of runs that are recorded, and of their replays.

    Args:
        recorder: Gets everything that a replay needs.
        player: Gives the clock and the entries of a recorded run.
    """

    takes_entries = True
    wakes_scheduler = True

    def __init__(
        self, *, recorder: Recorder | None = None, player: Player | None = None
    ) -> None:
        self.turn = 0
        """The number of this turn."""
        self._now = time.monotonic()
        self._timers = itertools.count()
        self._recorder = recorder
        self._player = player
        selector = TurnSelector()
        super().__init__(selector)
        self.tape = player or recorder
        door = self._door = Door.of(self)
        door.tape = self.tape
        self._scheduler = Scheduler.of(self)
        if player is not None:
            self._now = player.begin(door)
        elif recorder is not None:
            recorder.begin(self._now)
        selector.border = self._border

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

    def _border(
        self, timeout: float | None, select: Callable[[float | None], Any]
    ) -> Any:
        if self._player is not None:
            return self._replay(self._player, select)
        if self._door.waiting:
            timeout = 0.0
        elif timeout is None or timeout > 0.0:
            now = time.monotonic()
            if self._scheduler.is_due(now):
                timeout = 0.0
            elif timeout is not None:  # asyncio counts from the beginning of the turn
                timeout = max(0.0, timeout - (now - self._now))
        events = select(timeout)
        self.turn += 1
        self._now = time.monotonic()
        if self._recorder is not None:
            self._recorder.turn(self.turn, self._now)
        if self._door.waiting:
            self._door.take()
        self._scheduler.look(self._now)
        return events

    def _replay(self, player: Player, select: Callable[[float | None], Any]) -> Any:
        events = select(0.0)
        self.turn += 1
        self._now = player.moment(self.turn)
        player.take(self.turn)
        if self._door.waiting:
            self._door.take()
        self._scheduler.look(self._now)
        return events
