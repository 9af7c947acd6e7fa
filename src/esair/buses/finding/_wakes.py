"""Waiting for something to be plugged in: udev's events, or the next look."""

from __future__ import annotations

import contextlib
import os
import select
from pathlib import Path
from typing import Any, Self

SUBSYSTEMS = ("tty", "net", "i2c-dev", "gpio", "spidev", "input", "video4linux")
"""What the events that wake are about."""

_UDEVD = Path("/run/udev/control")


class Wakes:
    """Sleeps until udev has news, somebody wakes it, or a time has passed.

    Events need pyudev (the extra ``hotplug``) and are a favor: without them, in a
    container or on another system, only the time counts.

    Attributes:
        has_events: Whether udev is listened to.
    """

    def __init__(self) -> None:
        self._read, self._write = os.pipe()
        os.set_blocking(self._read, False)
        os.set_blocking(self._write, False)
        self._monitor: Any = None
        self._poll = select.poll()
        self._poll.register(self._read, select.POLLIN)

    @property
    def has_events(self) -> bool:
        """Whether udev is listened to."""
        return self._monitor is not None

    def listen(self) -> None:
        """Begin to listen to udev, if that is possible. Blocks for a moment."""
        with contextlib.suppress(Exception):  # no pyudev, no libudev, no netlink, ...
            import pyudev

            # The kernel's own events reach a container; udev's do not, but come
            # when links are made and permissions given.
            source = "udev" if _UDEVD.exists() else "kernel"
            monitor = pyudev.Monitor.from_netlink(pyudev.Context(), source=source)
            for subsystem in SUBSYSTEMS:
                monitor.filter_by(subsystem)
            monitor.start()
            self._poll.register(monitor.fileno(), select.POLLIN)
            self._monitor = monitor

    def wait(self, seconds: float) -> None:
        """Sleep; events that come together count as one."""
        for fd, events in self._poll.poll(max(0.0, seconds) * 1000):
            if fd == self._read:
                with contextlib.suppress(BlockingIOError):
                    os.read(fd, 4096)
            elif events & ~select.POLLIN:
                self._deafen(fd)
            else:
                self._drain(fd)

    def wake(self) -> None:
        """Wake the sleeper, from any thread."""
        with contextlib.suppress(BlockingIOError):
            os.write(self._write, b"!")

    def close(self) -> None:
        """Give the descriptors back; nothing else may be called any more."""
        self._monitor = None
        os.close(self._read)
        os.close(self._write)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _drain(self, fd: int) -> None:
        try:
            while self._monitor.poll(0) is not None:
                pass
        except Exception:  # too many events at once, or libudev gave up
            self._deafen(fd)

    def _deafen(self, fd: int) -> None:
        """Never be woken again and again by a descriptor that is broken."""
        self._poll.unregister(fd)
        self._monitor = None
