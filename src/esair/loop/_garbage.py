"""Collects cyclic garbage while robots run, in the gaps between their steps."""

from __future__ import annotations

import asyncio
import gc
import math
import sys
import time

from esair.loop._of_loop import OfLoop, turn_of
from esair.loop._scheduler import OneShot, Scheduler

LOOK = 0.25
"""How often the collector looks whether there is something to do, in seconds."""

SOON = 0.005  # how soon it looks again at the soonest, where much garbage is made

TRIES = 20
"""How many gaps that are too short are let pass before one is used all the same."""

YOUNG = 500
"""From how many new objects on a gap is used; Python 3.13 itself waits for 2,000."""

LONG = 0.001
"""How long a collection in a gap shall take at most, in seconds of CPU time.

What has been kept and takes longer to look at is set aside.
"""

PAUSE = 0.02
"""How much is let come at most: what takes this long to collect, in seconds of CPU time."""

FEW = 30_000  # by how many blocks of memory it may grow without a look at all

_BLOCKS = 4  # of memory, that an object takes which the collector knows, roughly
_FEW_OBJECTS = 20_000  # what may come in any program, however small it is
_USUAL = 2e-7  # what it takes to collect an object, before it was measured, in seconds


class Collector:
    """The garbage collector of the process while robots run; one for the process.

    The interpreter still collects young objects by itself, which takes microseconds.
    Full collections are made here, when nothing is due for as long as one takes. The
    interpreter makes one in the midst of a step only when so much has come since the
    last one that the program has doubled, or that it takes `PAUSE` to collect: it counts
    what comes, and is told from how much on. That bounds the pile, and by it the pause,
    whatever makes garbage, how fast, and whether there are gaps at all.

    What exists when a robot is up, and what was kept and takes long to look at, is set
    aside and not looked at again until the program has grown to twice as much memory.
    That look at everything is the only pause that is as long as the program is large.
    While robots only start or stop, the interpreter waits until the program has doubled:
    what they are made of is kept, and no look at it comes before actuators are safe.
    """

    def __init__(self) -> None:
        self._robots = 0
        self._up = 0  # how many of them neither start nor stop
        self._before = (0, 0, 0)
        self._know_nothing()
        self._ended_young = 0  # what the interpreter has collected until the last time
        self._is_ours = False
        self._came, self._began = 0, 0.0  # what there was when a forced one began
        self.collections: int = 0
        """How many full collections there were since the first robot has started."""
        self.forced: int = 0
        """How many of them were not in a gap: no gap was long enough, or none came."""
        self.collected: int = 0
        """How many objects they have freed."""
        self.longest: float = 0.0
        """The longest of them in a gap, in seconds of CPU time."""
        self.longest_forced: float = 0.0
        """The longest of the others, in seconds of CPU time."""

    def start(self) -> None:
        """A robot starts: from now on the pile is bounded here."""
        self._robots += 1
        if self._robots > 1:
            return
        self._before = gc.get_threshold()
        self.reset()
        self._know_nothing()
        self._begin_anew()
        gc.callbacks.append(self._hear)

    def is_up(self) -> None:
        """It runs: what there is now is kept, and full collections are made in gaps."""
        self._up += 1
        if self._up == 1:
            self._know_nothing()
            self._is_ours = True
            self._set_aside()
            self._is_ours = False

    def is_down(self) -> None:
        """It stops."""
        self._up -= 1
        self._say_when()

    def stop(self) -> None:
        """It has stopped; the last one gives the interpreter its settings back."""
        self._robots -= 1
        if self._robots == 0:
            gc.callbacks.remove(self._hear)
            gc.set_threshold(*self._before)
            gc.unfreeze()

    def _know_nothing(self) -> None:
        self._known = sys.getallocatedblocks()  # when all was looked at
        self._each = self._each_of_many = _USUAL
        self._kept = 0.0  # what it takes to look at what was kept, in seconds
        self._looks_at_all = False

    def reset(self) -> None:
        """Count from nothing."""
        self.collections = self.forced = self.collected = 0
        self.longest = self.longest_forced = 0.0

    def counts(self) -> dict[str, int]:
        """Return what was counted since the first robot has started."""
        return {
            "collections": self.collections,
            "forced": self.forced,
            "collected": self.collected,
            "longest_us": round(self.longest * 1e6),
            "longest_forced_us": round(self.longest_forced * 1e6),
        }

    def came(self) -> int:
        """Tell how many objects have come since the last full collection, at most."""
        if not gc.isenabled():
            return 0
        young, middle, old = gc.get_count()
        each, many, _ = self._before
        since = _collected_young() - self._ended_young
        return max(young, young + (each + 1) * (middle + (many + 2) * old) - since)

    def in_a_gap(self) -> int:
        """Tell how many objects shall come between two collections in gaps."""
        return round(max(LONG - self._kept, LONG / 2) / self._each)

    def fits(self, gap: float) -> bool:
        """Tell whether a full collection is expected to be over within a gap."""
        if self._looks_at_all:
            return sys.getallocatedblocks() * 7.5e-8 <= gap
        return self._expected() * 1.5 <= gap

    def _expected(self) -> float:
        return self._kept + self.came() * self._each

    def collect(self, *, forced: bool = False) -> None:
        """Make a full collection now, and measure it."""
        came, began = self.came(), time.thread_time()
        self._is_ours = True
        at_all, self._looks_at_all = self._looks_at_all, False
        if at_all:
            gc.unfreeze()
        collected = gc.collect()
        took = time.thread_time() - began
        if not at_all and took > 1.5 * LONG:
            gc.collect()  # what is left now was kept
            self._kept = time.thread_time() - began - took
        self._learn(took, came, collected, forced=forced)
        if at_all or self._kept > LONG:
            self._set_aside(at_all=at_all)
        self._kept = min(self._kept, took)
        self._is_ours = False
        self._count(time.thread_time() - began, collected, forced=forced)
        self._begin_anew()

    def _hear(self, phase: str, info: dict[str, int]) -> None:
        """Hear of a collection; a full one that is not ours came in the midst of work."""
        generation = info["generation"]
        if generation == 0 or self._is_ours:
            return
        if phase == "start":
            self._came, self._began = self.came(), time.thread_time()
            return
        if generation == 1:
            self._say_when()
            return
        took, collected = time.thread_time() - self._began, info["collected"]
        came = self._came
        self._learn(took, came, collected, forced=True)
        self._count(took, collected, forced=True)
        if took > PAUSE or (took > PAUSE / 2 and 2 * collected < came):
            gc.freeze()  # most was kept, and would be looked at each time
            self._look_for_twice_as_much()
        self._begin_anew()

    def _learn(self, took: float, came: int, collected: int, *, forced: bool) -> None:
        """Learn from a collection of mostly garbage what an object takes.

        The few of a gap are in the processor's cache: many take longer, each of them.
        """
        if collected >= 1_000 and 2 * collected >= came:
            each = max(took - self._kept, took / 4) / max(came, collected)
            self._each = min(max((self._each + each) / 2, 5e-8), 1e-4)
            if forced:
                usual = (self._each_of_many + each) / 2
                self._each_of_many = min(max(each, usual, 5e-8), 1e-4)

    def _count(self, took: float, collected: int, *, forced: bool) -> None:
        self.collections += 1
        self.collected += collected
        if forced:
            self.forced += 1
            self.longest_forced = max(self.longest_forced, took)
        else:
            self.longest = max(self.longest, took)

    def _set_aside(self, *, at_all: bool = False) -> None:
        gc.freeze()
        gc.collect()  # of nothing: the interpreter waits for a quarter of what was there
        self._kept = 0.0
        if at_all:
            self._known = sys.getallocatedblocks()
        else:
            self._look_for_twice_as_much()
        self._begin_anew()

    def _look_for_twice_as_much(self) -> None:
        """Have the next collection look at all of it if the program has grown so much.

        Another allocator than Python's own does not count its blocks.
        """
        blocks = sys.getallocatedblocks()
        self._looks_at_all = not blocks or blocks - self._known > max(self._known, FEW)

    def _begin_anew(self) -> None:
        self._ended_young = _collected_young()
        self._say_when()

    def _say_when(self) -> None:
        """Tell the interpreter how many more objects may come before it collects.

        It counts how often it has moved what is young to what is old, and knows nothing
        of what it has freed before.
        """
        each, many, _ = self._before
        most: float = max(self._known // _BLOCKS, _FEW_OBJECTS)
        if self._up:
            most = min(most, PAUSE / max(self._each, self._each_of_many))
        rounds = round((most - self.came()) / max((each + 1) * (many + 2), 1))
        gc.set_threshold(each, many, max(gc.get_count()[2] + rounds - 1, 0))


def _collected_young() -> int:
    young, middle, _ = gc.get_stats()
    return int(young["collected"] + middle["collected"])


collector: Collector = Collector()  # the one of this process


class Gaps(OfLoop):
    """Has the collector work in the gaps of one loop's scheduler; counted."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._scheduler = Scheduler.of(loop)
        self._users = 0
        self._next: OneShot | None = None
        self._last = -math.inf  # when it was collected last
        self._tries = 0

    def start(self) -> None:
        """A robot is up: look for gaps from now on."""
        collector.is_up()
        self._users += 1
        # On a virtual clock looks that never end would hide a deadlock.
        if self._users == 1 and not turn_of(self._loop).virtual:
            self._last = self._loop.time()
            self._look_in(LOOK)

    def stop(self) -> None:
        """Look for them no more, if no other robot is on the loop."""
        collector.is_down()
        self._users -= 1
        if self._users == 0 and self._next is not None:
            self._scheduler.cancel(self._next)
            self._next = None

    def _look_in(self, seconds: float) -> None:
        self._next = self._scheduler.at(self._loop.time() + seconds, self._look)

    def _look(self, now: float) -> None:
        if self._tries or collector.came() >= YOUNG:
            self._loop.call_soon(self._try)  # when the steps of this moment are done
        else:
            self._look_in(min(max(now - self._last, SOON), LOOK))

    def _try(self) -> None:
        if self._next is None:
            self._tries = 0
            return
        gap = self._scheduler.gap()
        fits = collector.fits(gap)
        self._tries += 1
        if not fits and self._tries < TRIES:
            self._look_in(max(gap, 0.0) + 0.0005)
            return
        self._tries = 0
        came, now = collector.came(), self._loop.time()
        collector.collect(forced=not fits)
        pace = came / max(now - self._last, SOON)
        self._last = now
        self._look_in(min(max(collector.in_a_gap() / pace, SOON), LOOK))
