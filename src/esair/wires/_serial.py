"""The far end of a serial line: a pseudo-terminal, or the same bytes in memory."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import os
import pty
import tty
from collections.abc import Callable
from pathlib import Path

from esair.buses import SerialLink
from esair.exceptions import DeviceLostError


def _nobody(_data: bytes) -> None:
    return None


class PtyLine:
    """A serial line that is a pseudo-terminal, and can be unplugged.

    Args:
        path: Where the port appears, as a symbolic link, while it is plugged in.

    Attributes:
        heard: Called with the bytes that come from the robot.
        lost: How many bytes did not fit, because nobody read the port.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.heard: Callable[[bytes], None] = _nobody
        self.lost = 0
        self._loop = asyncio.get_running_loop()
        self._master = -1
        self._slave = -1

    @property
    def plugged(self) -> bool:
        """Whether the port is there."""
        return self._master >= 0

    def plug(self) -> None:
        """Let the port appear; nothing happens if it is there."""
        if self.plugged:
            return
        # The simulation keeps the robot's end open too: else the terminal is hung up
        # whenever the robot is not there.
        self._master, self._slave = pty.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.path.unlink(missing_ok=True)
        self.path.symlink_to(os.ttyname(self._slave))
        self._loop.add_reader(self._master, self._readable)

    def unplug(self) -> None:
        """Let the port vanish, as a pulled cable does."""
        if not self.plugged:
            return
        self._loop.remove_reader(self._master)
        os.close(self._master)
        os.close(self._slave)
        self._master = self._slave = -1
        self.path.unlink(missing_ok=True)

    def write(self, data: bytes) -> None:
        """Send bytes to the robot; what does not fit is lost, as on a wire."""
        if not self.plugged:
            return
        sent = 0
        with contextlib.suppress(BlockingIOError):
            sent = os.write(self._master, data)
        self.lost += len(data) - sent

    def _readable(self) -> None:
        with contextlib.suppress(BlockingIOError):
            data = os.read(self._master, 4096)
            if data:
                self.heard(data)


class MemoryLine:
    """A serial line in memory, with the same ends as a `PtyLine`."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.heard: Callable[[bytes], None] = _nobody
        self.lost = 0
        self._loop = asyncio.get_running_loop()
        self._link: _MemoryLink | None = None
        self._plugged = False

    @property
    def plugged(self) -> bool:
        """Whether the port is there."""
        return self._plugged

    def plug(self) -> None:
        """Let the port appear."""
        self._plugged = True

    def unplug(self) -> None:
        """Let the port vanish, as a pulled cable does."""
        self._plugged = False
        link, self._link = self._link, None
        if link is not None:
            link.break_off(OSError(errno.EIO, os.strerror(errno.EIO)))

    def write(self, data: bytes) -> None:
        """Send bytes to the robot; they are lost if nobody is there."""
        if self._link is None or self._link.is_closing():
            self.lost += len(data)
        else:
            self._loop.call_soon(self._link.deliver, data)

    async def open(self, protocol: asyncio.Protocol) -> SerialLink:
        """Open the robot's end."""
        if not self._plugged:
            raise DeviceLostError(self.name, "nothing is plugged in")
        if self._link is not None and not self._link.is_closing():
            raise DeviceLostError(self.name, "somebody else has the line")
        self._link = _MemoryLink(self._loop, protocol, self._obey)
        return self._link

    def _obey(self, data: bytes) -> None:
        if self._plugged:
            self.heard(data)


class _MemoryLink:
    """The robot's end of a line in memory."""

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        protocol: asyncio.Protocol,
        far_end: Callable[[bytes], None],
    ) -> None:
        self._loop = loop
        self._protocol: asyncio.Protocol | None = protocol
        self._far_end = far_end

    def write(self, data: bytes) -> None:
        if self._protocol is not None:
            self._loop.call_soon(self._far_end, data)

    def get_write_buffer_size(self) -> int:
        return 0

    def set_write_buffer_limits(
        self, high: int | None = None, low: int | None = None
    ) -> None:
        """Need no limits: bytes never wait here."""

    def flush(self) -> None:
        """Have nothing to throw away: bytes never wait here."""

    def is_closing(self) -> bool:
        return self._protocol is None

    def abort(self) -> None:
        self._protocol = None

    def deliver(self, data: bytes) -> None:
        if self._protocol is not None:
            self._protocol.data_received(data)

    def break_off(self, error: OSError) -> None:
        if self._protocol is not None:
            self._loop.call_soon(self._protocol.connection_lost, error)
