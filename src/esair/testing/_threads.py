"""Threads on the virtual clock: which compute, which wait, and which are stuck."""

from __future__ import annotations

import contextlib
import os
import sys
import threading
import time
import traceback
from pathlib import Path

import esair.loop
from esair.loop import Door

LOOK = 0.02
"""How often threads are looked at while the loop waits for them, in real seconds."""

ASLEEP = 0.05  # After how long a sleep a thread waits for the outside, in real seconds

BLOCKED = 10.0
"""After how long a sleep a thread that time waits for is stuck, in real seconds."""

ENDLESS = 60.0
"""After how long a thread that computes is stuck, if nothing else happens meanwhile."""

_ITS_WAY = (threading.__file__, os.path.join(os.path.dirname(esair.loop.__file__), ""))
"""Where the code lies through which each function comes into a thread."""


class BlockedError(RuntimeError):
    """Time stands still: a thread sleeps in a call, or computes without end."""


class Threads:
    """Tells what the threads do that a loop on the virtual clock has given work to."""

    def __init__(self) -> None:
        self._slept: dict[threading.Thread, tuple[float, float]] = {}
        """How much each has computed, and since when it has not, in real seconds."""
        self._turn = -1  # the last one in which the loop has only waited
        self._since = 0.0  # when it began to, in real time

    def wake(self, door: Door) -> None:
        """Let time wait again for those that have heard from the outside."""
        for thread, outside, holds in door.at_hand():
            if outside and not holds and self._asleep_for(thread) == 0.0:
                door.go_on(thread)

    def outside(self, door: Door) -> bool:
        """Tell whether some wait for the outside, which may have something to say."""
        return any(outside for _, outside, _ in door.at_hand())

    def look(self, door: Door, turn: int) -> None:
        """Let time pass by those that wait for the outside; the loop does nothing else."""
        now = time.monotonic()
        if turn != self._turn + 1:  # it has done something since
            self._since = now
        self._turn = turn
        endless = now - self._since >= ENDLESS
        stuck = []
        at_hand = door.at_hand()
        for thread, outside, holds in at_hand:
            slept = self._asleep_for(thread)
            if outside and holds and slept >= ASLEEP:
                door.rest(thread)
            elif (slept >= BLOCKED and (holds or outside)) or (endless and holds):
                stuck.append(thread)
        known = {thread for thread, _, _ in at_hand}
        self._slept = {key: it for key, it in self._slept.items() if key in known}
        if not stuck:
            return
        told = "\n".join(f"  thread {each.name!r}: {_where(each)}" for each in stuck)
        for thread in stuck:  # told once: the end of the test does not wait for it
            self._slept.pop(thread, None)
            door.rest(thread)
        raise BlockedError(
            f"time stands still, for {ENDLESS if endless else BLOCKED:g} s of real time "
            f"by now:\n{told}\n"
            "let it take its time by loop.wait_in_thread(seconds), write it as "
            "async def, or mark the test real_clock"
        )

    def _asleep_for(self, thread: threading.Thread) -> float:
        """Return for how long a thread has not computed, in real seconds."""
        now, computed = time.monotonic(), _computed(thread)
        before, since = self._slept.get(thread, (-1.0, now))
        if computed != before or _runs(thread):
            since = now
        self._slept[thread] = computed, since
        return now - since


def _computed(thread: threading.Thread) -> float:
    """Return how long a thread has computed, in seconds."""
    with contextlib.suppress(OSError, TypeError, AttributeError):
        return time.clock_gettime(time.pthread_getcpuclockid(thread.ident))  # type: ignore[arg-type]
    return 0.0


def _runs(thread: threading.Thread) -> bool:
    """Tell whether a thread computes, or would if a processor were free."""
    with contextlib.suppress(OSError, IndexError):
        stat = Path(f"/proc/self/task/{thread.native_id}/stat").read_text()
        return stat.rpartition(")")[2].split()[0] == "R"
    return False


def _where(thread: threading.Thread) -> str:
    """Say in which line of which function a thread is: of somebody's own, if it is."""
    frame = sys._current_frames().get(thread.ident or 0)  # noqa: SLF001 - the way to it
    if frame is None:
        return "it has ended"
    stack = traceback.extract_stack(frame)
    own = [each for each in stack if not each.filename.startswith(_ITS_WAY)]
    line = (own or stack)[-1]
    return f"{line.filename}:{line.lineno} in {line.name}: {line.line}"
