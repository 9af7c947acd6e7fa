"""The robot's time, wherever it is asked for."""

from __future__ import annotations

import asyncio
import threading
import time

from esair.loop._portal import portal
from esair.loop._timer import clock_beside, clock_of

_thread = threading.local()


def works_for(loop: asyncio.AbstractEventLoop) -> None:
    """Say, in a thread, whose work it does from now on."""
    _thread.loop = loop


def sleep_in_thread(seconds: float) -> None:
    """Sleep in a thread that works for a robot, by the clock of `now`.

    For a fake whose calls block: on the virtual clock it takes no real time.
    """
    virtual = getattr(getattr(_thread, "loop", None), "wait_in_thread", None)
    (time.sleep if virtual is None else virtual)(seconds)


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
        if getattr(own.loop, "wakes_scheduler", False):
            return own.call(_moment)  # by the door: so it is the same in a replay
        return clock_of(own.loop)()
    loop = getattr(_thread, "loop", None)
    return time.monotonic() if loop is None else clock_beside(loop)()


async def _moment() -> float:
    return asyncio.get_running_loop().time()
