"""The robot's time, wherever it is asked for."""

from __future__ import annotations

import asyncio
import threading
import time

from esair.loop._portal import portal
from esair.loop._timer import clock_of

_thread = threading.local()


def works_for(loop: asyncio.AbstractEventLoop) -> None:
    """Say, in a thread, whose work it does from now on."""
    _thread.loop = loop


def now() -> float:
    """Return the robot's monotonic time, in seconds.

    It is the same clock in the event loop, in the thread of a plain behavior or a
    blocking driver, on the virtual clock and in a replay: that of the readings'
    ``time``. In a thread that esair knows nothing of it is `time.monotonic`.
    """
    loop = asyncio._get_running_loop()  # noqa: SLF001 - it does not raise
    if loop is None:
        own = portal.get(None)
        loop = getattr(_thread, "loop", None) if own is None else own.loop
        if loop is None:
            return time.monotonic()
    return clock_of(loop)()
