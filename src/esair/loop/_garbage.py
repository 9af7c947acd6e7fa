"""Collects cyclic garbage while robots run, in the gaps between their steps."""

from __future__ import annotations

import asyncio
import gc
import math
import sys
import time

from esair.loop._of_loop import OfLoop
from esair.loop._rate_group import Job
from esair.loop._scheduler import Scheduler

LOOK = 0.25
"""How often the collector looks whether there is something to do, in seconds."""

TRIES = 20
"""How many gaps that are too short are let pass before one is used all the same."""

LONG = 0.001  # a collection that takes longer sets aside what it has kept, in seconds
MAX_SHARE = 0.02  # the greatest share of time that full collections may take
FEW = 200_000  # by how many blocks of memory more it may grow without a look at all

_NEVER = 1_000_000


YOUNG = 500
"""From how many new objects on a gap is used; Python 3.13 itself waits for 2,000."""


class Collector:
    """The garbage collector of the process while robots run; one for the process.

    The interpreter still collects young objects by itself, which takes microseconds.
    It never makes a full collection: that stops the program for milliseconds, in the
    midst of a step. They are made here, when nothing is due for as long as one takes.
    What exists at the start, and what a long collection has kept, is set aside and not
    looked at again until the program has grown to twice as much memory. Objects are not
    even counted: what a collection keeps takes half as long to count as to collect.
    """

    def __init__(self) -> None:
        self._robots = 0
        self._before = (0, 0, 0)
        self._not_before = -math.inf
        self._before_all = 0  # how many blocks of memory there were before the robot,
        self._known = 0  # and how many more when all was looked at
        self.collections = 0  # how many full collections there were
        self.collected = 0  # how many objects they have freed
        self.longest = 0.0
        """The longest of them, in seconds, since the first robot has started."""
        self._expected = 0.0
        self._looks_at_all = False

    def start(self) -> None:
        """A robot runs: from now on full collections are made in gaps only."""
        if self._robots == 0:
            self._before = gc.get_threshold()
            gc.freeze()
            gc.set_threshold(self._before[0], self._before[1], _NEVER)
            self._before_all, self._known = sys.getallocatedblocks(), 0
            self.longest = self._expected = 0.0
            self._looks_at_all = False
        self._robots += 1

    def stop(self) -> None:
        """It has stopped; the last one gives the interpreter its settings back."""
        self._robots -= 1
        if self._robots == 0:
            gc.set_threshold(*self._before)
            gc.unfreeze()

    def wanted(self, now: float) -> bool:
        """Tell whether there is something to collect, and time to do it."""
        if now < self._not_before or not gc.isenabled():
            return False
        young, *older = gc.get_count()
        return young >= YOUNG or any(older)

    def fits(self, gap: float) -> bool:
        """Tell whether a full collection is expected to be over within a gap."""
        return self._expected * 1.5 <= gap

    def collect(self) -> None:
        """Make a full collection now, and measure it."""
        began = time.perf_counter()
        self.collected += gc.collect()
        took = self._expected = time.perf_counter() - began
        self.collections += 1
        if took > LONG:
            self._set_aside_what_was_kept()
        took = time.perf_counter() - began
        self.longest = max(self.longest, took)
        self._not_before = time.monotonic() + took / MAX_SHARE

    def _set_aside_what_was_kept(self) -> None:
        gc.freeze()
        self._expected = 0.0
        blocks = sys.getallocatedblocks()
        there = blocks - self._before_all
        if self._looks_at_all:
            self._looks_at_all = False
            self._known = there
        elif not blocks or there - self._known > max(self._known, FEW):
            # Another allocator than Python's own does not count its blocks.
            gc.unfreeze()  # the next collection looks at all of it
            self._looks_at_all = True
            self._expected = blocks * 5e-8


collector = Collector()  # the one of this process


class Gaps(OfLoop):
    """Has the collector work in the gaps of one loop's scheduler; counted."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._scheduler = Scheduler.of(loop)
        self._users = 0
        self._job: Job | None = None
        self._tries = 0

    def start(self) -> None:
        collector.start()
        self._users += 1
        # On a virtual clock a job that never ends would hide a deadlock.
        if self._users == 1 and not getattr(self._loop, "virtual", False):
            self._job = self._scheduler.every(LOOK, self._look)

    def stop(self) -> None:
        """Look for them no more, if no other robot is on the loop."""
        collector.stop()
        self._users -= 1
        if self._users == 0 and self._job is not None:
            self._job.stop()
            self._job = None

    def _look(self, now: float) -> None:
        if self._tries == 0 and collector.wanted(now):
            self._loop.call_soon(self._try)  # when the steps of this moment are done

    def _try(self) -> None:
        if self._job is None:
            self._tries = 0
            return
        gap = self._scheduler.gap()
        self._tries += 1
        if collector.fits(gap) or self._tries >= TRIES:
            self._tries = 0
            collector.collect()
        else:
            self._loop.call_later(max(gap, 0.0) + 0.0005, self._try)
