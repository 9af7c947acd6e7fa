"""The far end of a CAN bus: in memory, or a node of python-can."""

from __future__ import annotations

import asyncio
import collections
from collections.abc import Callable
from typing import Protocol

from esair.buses import Frame, FrameLink, python_can
from esair.loop import Lane, spawn


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
