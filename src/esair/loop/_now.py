"""The robot's time, wherever it is asked for."""

from __future__ import annotations

import asyncio
import threading
import time

from esair.loop._of_loop import clock_beside, clock_of, turn_of
from esair.loop._portal import portal

_thread = threading.local()


def works_for(loop: asyncio.AbstractEventLoop) -> None:
    """Say, in a thread, whose work it does from now on."""
    _thread.loop = loop


def sleep_in_thread(seconds: float) -> None:
    """Sleep in a thread that works for a robot, by the clock of `now`.

    For a fake whose calls block: on the virtual clock it takes no real time.
    """
    loop = getattr(_thread, "loop", None)
    wait = time.sleep if loop is None else turn_of(loop).wait_in_thread
    wait(seconds)


def now() -> float:
    """Return the robot's monotonic time, in seconds.

    It is the same clock in the event loop, in the thread of a plain behavior or a
    blocking driver, on the virtual clock and in a replay: that of the readings'
    ``time``. In a thread that esair knows nothing of it is `time.monotonic`.
    """
    loop = asyncio._get_running_loop()  # noqa: SLF001 - it does not raise
    if loop is not None:
        return clock_of(loop)()
    own = portal.get(None)
    if own is not None:
        return own.call(_moment)  # by the door: so it is the same in a replay
    loop = getattr(_thread, "loop", None)
    return time.monotonic() if loop is None else clock_beside(loop)()


async def _moment() -> float:
    return clock_of(asyncio.get_running_loop())()
