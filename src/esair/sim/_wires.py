"""The parts' ends of the wires: pseudo-terminals, or the same bytes in memory.

Time that jumps and descriptors do not mix: bytes in flight in the kernel are not seen
by a virtual clock. So there the wires are in memory; bytes and frames are the same.
"""

from __future__ import annotations

import asyncio
import collections
import contextlib
import errno
import os
import pty
import tty
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Protocol

from esair.buses import Frame, FrameLink, SerialLink, python_can
from esair.exceptions import DeviceLostError
from esair.loop import Lane, spawn


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


class CanWire(Protocol):
    """The parts' end of a CAN bus."""

    def send(self, frame: Frame) -> None:
        """Send a frame to everybody else on the bus."""

    async def open(self) -> None:
        """Begin."""

    async def close(self) -> None:
        """End."""


class MemoryCan:
    """A CAN bus in memory: every node gets the frames of all others, in order.

    Args:
        heard: Called with each frame that the robot sends.
    """

    def __init__(self, heard: Callable[[Frame], None]) -> None:
        self._heard = heard
        self._loop = asyncio.get_running_loop()
        self._robots: list[_MemoryNode] = []

    async def open(self) -> None:
        """Begin."""

    async def close(self) -> None:
        """End."""

    def send(self, frame: Frame) -> None:
        """Send a frame of a part to the robot."""
        for node in tuple(self._robots):
            self._loop.call_soon(node.deliver, frame)

    def obey(self, frame: Frame) -> None:
        """Hand a frame of the robot to the parts."""
        self._heard(frame._replace(time=self._loop.time()))

    async def node(
        self, received: Callable[[Frame], None], _gone: Callable[[Exception], None]
    ) -> FrameLink:
        """Open a node of the robot."""
        node = _MemoryNode(self._loop, self, received)
        self._robots.append(node)
        return node

    def forget(self, node: _MemoryNode) -> None:
        """Let a node leave."""
        if node in self._robots:
            self._robots.remove(node)


class _MemoryNode:
    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        wire: MemoryCan,
        received: Callable[[Frame], None],
    ) -> None:
        self._loop = loop
        self._wire = wire
        self._received: Callable[[Frame], None] | None = received

    async def send(self, frame: Frame) -> bool:
        if self._received is None:
            raise ConnectionError("the node is closed")
        self._loop.call_soon(self._wire.obey, frame)
        return True

    async def close(self) -> None:
        self._received = None
        self._wire.forget(self)

    def deliver(self, frame: Frame) -> None:
        if self._received is not None:
            self._received(frame._replace(time=self._loop.time()))


class VirtualCan:
    """The parts' node on a bus of python-can's ``virtual`` interface.

    Args:
        channel: The name of the bus, the same for all nodes.
        heard: Called with each frame that the robot sends.

    Attributes:
        lost: How many frames were not sent because the bus took none.
    """

    queue_limit = 256

    def __init__(self, channel: str, heard: Callable[[Frame], None]) -> None:
        self.channel = channel
        self.lost = 0
        self._heard = heard
        self._loop = asyncio.get_running_loop()
        self._lane = Lane("sim_can")
        self._link: FrameLink | None = None
        self._queue: collections.deque[Frame] = collections.deque(
            maxlen=self.queue_limit
        )
        self._sender: asyncio.Task[None] | None = None

    async def open(self) -> None:
        """Begin."""
        opener = python_can("virtual", self.channel, lane=self._lane)
        self._link = await opener(self._heard, lambda _error: None)

    async def close(self) -> None:
        """End."""
        link, self._link = self._link, None
        self._queue.clear()
        if self._sender is not None:
            await asyncio.wait({self._sender})
        if link is not None:
            await link.close()
        await self._lane.join(timeout=0.5)

    def send(self, frame: Frame) -> None:
        """Send a frame of a part to the robot."""
        if self._link is None:
            return
        if len(self._queue) == self.queue_limit:
            self.lost += 1
        self._queue.append(frame)
        if self._sender is None or self._sender.done():
            self._sender = spawn(self._loop, self._send_all(), name="sim can")

    async def _send_all(self) -> None:
        while self._queue and self._link is not None:
            try:
                await self._link.send(self._queue.popleft())
            except OSError:
                self.lost += 1


class Chip(Protocol):
    """A chip on an I²C bus: registers."""

    def read(self, register: int, length: int) -> bytes:
        """Return registers."""

    def write(self, register: int, data: bytes) -> None:
        """Set registers."""


class SimI2cMaster:
    """An I²C bus with simulated chips, behind the methods of ``smbus2.SMBus``.

    Args:
        chips: The chips by their addresses. An address without one does not answer.
    """

    def __init__(self, chips: dict[int, Chip]) -> None:
        self.chips = chips
        self.plugged = True
        self.closed = False

    def read_byte_data(self, i2c_addr: int, register: int) -> int:
        """Read one register."""
        return self._chip(i2c_addr).read(register, 1)[0]

    def write_byte_data(self, i2c_addr: int, register: int, value: int) -> None:
        """Write one register."""
        self._chip(i2c_addr).write(register, bytes([value]))

    def read_i2c_block_data(
        self, i2c_addr: int, register: int, length: int
    ) -> list[int]:
        """Read up to 32 registers in one transfer."""
        return list(self._chip(i2c_addr).read(register, min(length, 32)))

    def write_i2c_block_data(
        self, i2c_addr: int, register: int, data: Sequence[int]
    ) -> None:
        """Write up to 32 registers in one transfer."""
        self._chip(i2c_addr).write(register, bytes(data[:32]))

    def close(self) -> None:
        """Let the bus go."""
        self.closed = True

    def _chip(self, address: int) -> Chip:
        if not self.plugged:
            raise OSError(errno.ENODEV, os.strerror(errno.ENODEV))
        if address not in self.chips:
            raise OSError(errno.ENXIO, os.strerror(errno.ENXIO))
        return self.chips[address]
