"""A second small process that makes the robot safe when its own dies or hangs.

When the robot's process is killed, is stopped, or its scheduler has not turned for
`watchdog_limit` while something was told to move, the watchdog stops that process, throws
away what is queued, sends each watched actuator its safe frames, and ends the process. It
never moves anything, and never writes while the robot runs. What no watchdog can do: help
when the computer dies.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from esair.loading import late
from esair.watchdog._limit import LIMIT

if TYPE_CHECKING:
    from esair.watchdog._frames import Outlet, SafeFrames, can_frame
    from esair.watchdog._watchdog import Watchdog

__all__ = ["LIMIT", "Outlet", "SafeFrames", "Watchdog", "can_frame"]


# Loaded by who needs it: it is a tenth of the time that `import esair` takes.
_LATE = {"_frames": "Outlet SafeFrames can_frame", "_watchdog": "Watchdog"}
__getattr__, _ = late(__name__, _LATE)
