"""Timers that wake the event loop at a given moment."""

from __future__ import annotations

import asyncio
import contextlib
import os
import time
from collections.abc import Callable
from typing import Protocol


class Timer(Protocol):
    """Calls a function once, at the moment it was last set to."""

    def set(self, when: int) -> None:
        """Call at this moment of the loop's clock, in nanoseconds, and at no other."""

    def close(self) -> None:
        """Never call again."""


class LoopTimer:
    """The event loop's own timer. Selectors round it up to whole milliseconds."""

    def __init__(
        self, loop: asyncio.AbstractEventLoop, function: Callable[[], None]
    ) -> None:
        self._loop = loop
        self._function = function
        self._handle: asyncio.TimerHandle | None = None

    def set(self, when: int) -> None:
        self.close()
        self._handle = self._loop.call_at(when / 1e9, self._function)

    def close(self) -> None:
        if self._handle is not None:
            self._handle.cancel()
            self._handle = None


class DescriptorTimer:
    """Linux's timerfd: the kernel wakes the selector, some 50 us after the moment."""

    def __init__(
        self, loop: asyncio.AbstractEventLoop, function: Callable[[], None]
    ) -> None:
        self._loop = loop
        self._function = function
        from esair.loop import _timerfd  # loads ctypes: only when something runs

        self._settime = _timerfd.settime
        self._fd = _timerfd.create()
        try:
            loop.add_reader(self._fd, self._expired)
        except BaseException:
            os.close(self._fd)
            raise

    def set(self, when: int) -> None:
        self._settime(self._fd, max(1, when))

    def close(self) -> None:
        if self._fd >= 0:
            self._loop.remove_reader(self._fd)
            os.close(self._fd)
            self._fd = -1

    def _expired(self) -> None:
        try:
            os.read(self._fd, 8)
        except BlockingIOError:  # set again in the meantime
            return
        self._function()


def clock_of(loop: asyncio.AbstractEventLoop) -> Callable[[], float]:
    """Return the best function that reads a loop's clock, in seconds.

    That of uvloop stands still between its turns and counts whole milliseconds.
    """
    kind = type(loop)
    if kind.time is asyncio.BaseEventLoop.time or kind.__module__ == "uvloop":
        return time.monotonic  # what they read
    return loop.time


def clock_beside(loop: asyncio.AbstractEventLoop) -> Callable[[], float]:
    """Return what reads a loop's clock amid a turn too, in any thread.

    That of the robot may stand still while a turn lasts. What this reads may not
    decide anything in a robot, or it has to be kept: it is another in a replay.
    """
    if getattr(loop, "wakes_scheduler", False):
        return time.monotonic
    return clock_of(loop)


def timer_for(loop: asyncio.AbstractEventLoop, function: Callable[[], None]) -> Timer:
    """Return the most exact timer that a loop can have.

    A loop whose clock is not the kernel's says so by an attribute ``virtual``.
    """
    if not getattr(loop, "virtual", False):
        with contextlib.suppress(OSError, NotImplementedError, AttributeError):
            return DescriptorTimer(loop, function)
    return LoopTimer(loop, function)
