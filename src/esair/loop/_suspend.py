"""The computer slept: monotonic clocks stood still, the world did not."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from esair.loop._tape import TapeWriter

if TYPE_CHECKING:
    from esair.loop._turn import Turn

JUMP = 0.1  # from how many seconds of sleep on everything that is known counts as old

GLANCE = 0.25
"""How often a robot looks whether the computer slept, if nothing else is due, in s."""

_TAG = ("computer", "slept")

_log = logging.getLogger("esair")


class SuspendWatch:
    """Tells who listens when the computer was suspended, and for how long.

    It compares the clock that goes on while the computer sleeps with the one that
    does not. It looks at each border where something is due, so listeners hear of a
    sleep before the next step.
    """

    def __init__(self, turn: Turn) -> None:
        self._slept = turn.slept
        self._door = turn.door
        if self._door.player is not None:
            self._door.player.listen(_TAG, self._woke)
        self._before = max(self._slept() for _ in range(3))
        self._listeners: tuple[Callable[[float], None], ...] = ()

    def listen(self, listener: Callable[[float], None]) -> None:
        """Call a function with the seconds of each sleep."""
        self._listeners = (*self._listeners, listener)

    def forget(self, listener: Callable[[float], None]) -> None:
        """Call the function no more."""
        self._listeners = tuple(each for each in self._listeners if each != listener)

    def look(self) -> None:
        """Find out whether the computer slept since the last look."""
        slept = self._slept() - self._before
        if slept <= 0.0:
            return  # a pause between the readings makes it smaller, never larger
        self._before += slept
        if slept > JUMP and self._door.player is None:
            if isinstance(self._door.tape, TapeWriter):
                self._door.tape.arrived(_TAG, slept)
            self._woke(slept)

    def _woke(self, slept: float) -> None:
        _log.warning("the computer slept for %.1f s: all readings are old", slept)
        for listener in self._listeners:
            listener(slept)


def computer_slept() -> float:
    """Return how long the computer has slept in all, in seconds; 0 if it cannot tell."""
    boot = getattr(time, "CLOCK_BOOTTIME", None)
    return 0.0 if boot is None else time.clock_gettime(boot) - time.monotonic()
