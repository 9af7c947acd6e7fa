"""The computer slept: monotonic clocks stood still, the world did not."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable

from esair.loop._door import Door
from esair.loop._of_loop import OfLoop
from esair.loop._tape import TapeWriter

JUMP = 0.1  # from how many seconds of sleep on everything that is known counts as old

GLANCE = 0.25
"""How often a robot looks whether the computer slept, if nothing else is due, in s."""

_TAG = ("computer", "slept")

_log = logging.getLogger("esair")


class SuspendWatch(OfLoop):
    """Tells who listens when the computer was suspended, and for how long.

    It compares the clock that goes on while the computer sleeps with the one that
    does not. The scheduler looks at it each time it begins to turn, so listeners hear
    of a sleep before the next step.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._slept = _slept_of(loop)
        self._door = Door.of(loop)
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


def _slept_of(loop: asyncio.AbstractEventLoop) -> Callable[[], float]:
    """Return the function that tells how long the computer has slept in all."""
    if hasattr(loop, "suspended"):  # a virtual clock sleeps when its test says so
        return lambda: float(loop.suspended)
    boot = getattr(time, "CLOCK_BOOTTIME", None)
    if boot is None:
        return float  # this system cannot tell
    return lambda: time.clock_gettime(boot) - time.monotonic()
