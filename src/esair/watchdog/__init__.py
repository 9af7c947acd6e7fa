"""A second small process that makes the robot safe when its own dies or hangs.

When the robot's process is killed, is stopped, or its scheduler has not turned for
`watchdog_limit` while something was told to move, the watchdog stops that process, throws
away what is queued, sends each watched actuator its safe frames, and ends the process. It
never moves anything, and never writes while the robot runs. What no watchdog can do: help
when the computer dies.
"""

from esair.watchdog._frames import Outlet, SafeFrames, can_frame
from esair.watchdog._watchdog import LIMIT, Watchdog

__all__ = ["LIMIT", "Outlet", "SafeFrames", "Watchdog", "can_frame"]
