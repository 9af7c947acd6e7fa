"""The far end of a serial line: a pseudo-terminal, or the same bytes in memory."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import os
import pty
import termios
import tty
from collections.abc import Awaitable, Callable
from pathlib import Path

from esair.buses.serial._line import SerialLink, SerialWire
from esair.exceptions import DeviceLostError


def _nobody(_data: bytes) -> None:
    return None


class PtyLine(SerialWire):
    """A serial line that is a pseudo-terminal, and can be unplugged.

    Args:
        path: Where the port appears, as a symbolic link, while it is plugged in; only
            under the name that the kernel gives it if None.

    Attributes:
        heard: Called with the bytes that come from the robot.
        lost: How many bytes did not fit, because nobody read the port.
    """

    def __init__(self, path: Path | None = None) -> None:
        super().__init__()
        self.path = path
        self.heard: Callable[[bytes], None] = _nobody
        self.lost: int = 0
        self._loop = asyncio.get_running_loop()
        self._master = -1
        self._slave = -1

    @property
    def plugged(self) -> bool:
        """Whether the port is there."""
        return self._master >= 0

    @property
    def port(self) -> str:
        """The device file of the port.

        Raises:
            DeviceLostError: It is not there.
        """
        if not self.plugged:
            raise DeviceLostError(str(self.path or "pty"), "nothing is plugged in")
        return os.ttyname(self._slave)

    def plug(self) -> None:
        """Let the port appear; nothing happens if it is there."""
        if self.plugged:
            return
        # The far end keeps the robot's end open too: else the terminal is hung up
        # whenever the robot is not there.
        self._master, self._slave = pty.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        if self.path is not None:
            self.path.unlink(missing_ok=True)
            self.path.symlink_to(os.ttyname(self._slave))
        self._loop.add_reader(self._master, self._readable)
        self._tell_plugged()

    async def open(
        self,
        protocol: asyncio.Protocol,
        port: Callable[[str], Awaitable[SerialLink]] | None = None,
    ) -> SerialLink:
        """Open the robot's end, as any port is opened."""
        if port is None:
            raise DeviceLostError(self.port, "a terminal is opened by a bus")
        path = self.port  # which is told only while it is plugged in
        return await port(str(self.path or path))

    def unplug(self) -> None:
        """Let the port vanish, as a pulled cable does."""
        if not self.plugged:
            return
        self._loop.remove_reader(self._master)
        os.close(self._master)
        os.close(self._slave)
        self._master = self._slave = -1
        if self.path is not None:
            self.path.unlink(missing_ok=True)

    def hang_up(self) -> None:
        """End the connection; the port is there again at once."""
        self.unplug()
        self.plug()

    def stall(self) -> None:
        """Take no byte more, as a device that holds CTS down."""
        if self.plugged:
            termios.tcflow(self._slave, termios.TCOOFF)

    def resume(self) -> None:
        """Take bytes again."""
        if self.plugged:
            termios.tcflow(self._slave, termios.TCOON)

    def write(self, data: bytes) -> None:
        """Send bytes to the robot; what does not fit is lost, as on a wire."""
        if not self.plugged:
            return
        sent = 0
        with contextlib.suppress(BlockingIOError):
            sent = os.write(self._master, data)
        self.lost += len(data) - sent

    def hear_the_rest(self) -> None:
        """Hear what the robot has sent and the loop has not come to yet."""
        while self.plugged and self._readable():
            pass

    def _readable(self) -> bool:
        with contextlib.suppress(BlockingIOError):
            data = os.read(self._master, 4096)
            if data:
                self.heard(data)
                return True
        return False


class MemoryLine(SerialWire):
    """A serial line in memory, with the same ends as a `PtyLine`."""

    def __init__(self, name: str) -> None:
        super().__init__()
        self.name = name
        self.heard: Callable[[bytes], None] = _nobody
        self.lost: int = 0
        self._loop = asyncio.get_running_loop()
        self._link: _MemoryLink | None = None
        self._plugged = False
        self._room: int | None = None

    @property
    def plugged(self) -> bool:
        """Whether the port is there."""
        return self._plugged

    def plug(self) -> None:
        """Let the port appear; nothing happens if it is there."""
        if not self._plugged:
            self._plugged = True
            self._tell_plugged()

    def unplug(self) -> None:
        """Let the port vanish, as a pulled cable does."""
        self._plugged = False
        self._break_off(OSError(errno.EIO, os.strerror(errno.EIO)))

    def hang_up(self) -> None:
        """End the connection; the port is there again at once."""
        self._break_off(None)

    def stall(self, after: int = 0) -> None:
        """Take no byte more.

        Args:
            after: How many are taken before.
        """
        self._room = after

    def resume(self) -> None:
        """Take bytes again, first those that wait."""
        self._room = None
        if self._link is not None:
            self._link.drain()

    def write(self, data: bytes) -> None:
        """Send bytes to the robot; they are lost if nobody is there."""
        if self._link is None or self._link.is_closing():
            self.lost += len(data)
        else:
            self._loop.call_soon(self._link.deliver, data)

    async def open(
        self,
        protocol: asyncio.Protocol,
        port: Callable[[str], Awaitable[SerialLink]] | None = None,
    ) -> SerialLink:
        """Open the robot's end."""
        if not self._plugged:
            raise DeviceLostError(self.name, "nothing is plugged in")
        if self._link is not None and not self._link.is_closing():
            raise DeviceLostError(self.name, "somebody else has the line")
        self._link = _MemoryLink(self._loop, protocol, self._take)
        return self._link

    def _break_off(self, error: OSError | None) -> None:
        link, self._link = self._link, None
        if link is not None:
            link.break_off(error)

    def _take(self, data: bytes) -> int:
        """Take bytes from the robot as far as there is room; return how many."""
        taken = data
        if self._room is not None:
            taken = data[: self._room]
            self._room -= len(taken)
        if taken:
            self._loop.call_soon(self._obey, taken)
        return len(taken)

    def _obey(self, data: bytes) -> None:
        if self._plugged:
            self.heard(data)


class _MemoryLink:
    """The robot's end of a line in memory."""

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        protocol: asyncio.Protocol,
        far_end: Callable[[bytes], int],
    ) -> None:
        self._loop = loop
        self._protocol: asyncio.Protocol | None = protocol
        self._far_end = far_end
        self._waiting = b""
        self._broken = False

    def write(self, data: bytes) -> None:
        if self._protocol is None:
            return
        if not self._waiting and not self._broken:
            data = data[self._far_end(data) :]
        self._waiting += data

    def drain(self) -> None:
        """Send what waits, as far as there is room now."""
        if self._protocol is None or self._broken or not self._waiting:
            return
        self._waiting = self._waiting[self._far_end(self._waiting) :]
        if not self._waiting:
            self._loop.call_soon(self._protocol.resume_writing)

    def get_write_buffer_size(self) -> int:
        return len(self._waiting)

    def set_write_buffer_limits(
        self, high: int | None = None, low: int | None = None
    ) -> None:
        """Need no limits: the protocol is told when everything is sent."""

    def flush(self) -> None:
        self._waiting = b""

    def is_closing(self) -> bool:
        return self._protocol is None

    def abort(self) -> None:
        self._protocol = None
        self._waiting = b""

    def deliver(self, data: bytes) -> None:
        if self._protocol is not None:
            self._protocol.data_received(data)

    def break_off(self, error: OSError | None) -> None:
        self._broken = True
        if self._protocol is not None:
            self._loop.call_soon(self._protocol.connection_lost, error)
