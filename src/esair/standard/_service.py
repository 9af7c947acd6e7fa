"""What systemd is told of a robot: that it is up, that its loop turns, that it stops."""

from __future__ import annotations

import contextlib
import os
import socket


class ServiceManager:
    """Tells the service manager how the robot is, as ``sd_notify`` does.

    A service of ``Type=notify`` is up when its robot is. With ``WatchdogSec`` a beat is
    sent from the event loop, four times in that time at least: a process whose loop is
    stuck is ended and started anew. Without systemd nothing is done.
    """

    def __init__(self) -> None:
        place = os.environ.get("NOTIFY_SOCKET", "")
        self._address = "\0" + place[1:] if place.startswith("@") else place
        mine = os.environ.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        usec = os.environ.get("WATCHDOG_USEC", "") if mine else ""
        self._period = int(usec) / 4e6 if usec.isdecimal() else 0.0
        self._next = 0.0

    def tell(self, state: str) -> None:
        """Tell it a state, such as ``READY=1``; what it does not hear is lost."""
        if self._address:
            kind = socket.SOCK_DGRAM | socket.SOCK_NONBLOCK | socket.SOCK_CLOEXEC
            with (
                contextlib.suppress(OSError),
                socket.socket(socket.AF_UNIX, kind) as way,
            ):
                way.sendto(state.encode(), self._address)

    def beat(self, now: float) -> None:
        """Tell that the loop turns, if it is time to."""
        if self._period and now >= self._next:
            self._next = now + self._period
            self.tell("WATCHDOG=1")
