"""The far end of a CAN bus: memory."""

from __future__ import annotations

import asyncio
import collections
from collections.abc import Callable, Collection

from esair.buses._failures import Failures
from esair.buses.can._frame import (
    CanState,
    CanWire,
    Filter,
    Frame,
    FrameKind,
    FrameLink,
)
from esair.loop import clock_of

Received = Callable[[Frame], None]
Gone = Callable[[Exception], None]


class MemoryCan(CanWire):
    """A CAN bus in memory: every node gets the frames of all others, in order.

    It can be told to do what a bus does on a bad day.

    Args:
        heard: Called with each frame of the robot that is on the wire.

    Attributes:
        state: The state of the robot's controller.
        dropped: How many frames of the parts were lost because the bus was stalled
            for too long.
    """

    queue_limit = 10
    """How many frames of the robot wait in its controller."""

    hold_limit = 1024
    """How many frames of the parts wait while the bus is stalled."""

    def __init__(self, heard: Callable[[Frame], None]) -> None:
        super().__init__()
        self.plugged: bool = True
        self._users: dict[object, Gone] = {}
        self.state: CanState = CanState.ACTIVE
        self.dropped: int = 0
        self._heard = heard
        self._robots: list[_MemoryNode] = []
        self._queue: collections.deque[Frame] = collections.deque()
        self._held: collections.deque[Frame] = collections.deque(maxlen=self.hold_limit)
        self._acknowledged = True
        self._stalled = False
        self._full = 0
        self._failures = Failures()

    def unplug(self) -> None:
        """Take the robot's adapter away."""
        if not self.plugged:
            return
        self.plugged = False
        users, self._users = self._users, {}
        for gone in users.values():
            gone(ConnectionError("it was unplugged"))

    def plug(self) -> None:
        """Bring it back."""
        if self.plugged:
            return
        self.plugged = True
        self._tell_plugged()

    def _check(self) -> None:
        if not self.plugged:
            raise ConnectionError("it is unplugged")

    def send(self, frame: Frame) -> None:
        """Send a frame of a part to the robot."""
        if self._stalled:
            if len(self._held) == self.hold_limit:
                self.dropped += 1
            self._held.append(frame)
            return
        for node in tuple(self._robots):
            node.deliver_soon(frame)

    async def open(self, received: Received, gone: Gone) -> FrameLink:
        """Open a node of the robot.

        Raises:
            ConnectionError: It is unplugged.
        """
        self._check()
        node = _MemoryNode(self, received)
        self._robots.append(node)
        self._users[node] = gone
        return node

    def error_frame(self, classes: int, data: bytes = b"") -> None:
        """Have the robot's controller report an error, as ``linux/can/error.h`` says.

        Args:
            classes: The classes of the error, a bit each.
            data: Up to 8 bytes; what is missing is zero.
        """
        frame = Frame(classes, data.ljust(8, b"\0"), kind=FrameKind.ERROR)
        for node in tuple(self._robots):
            node.deliver_soon(frame)

    def acknowledge(self, yes: bool = True) -> None:
        """Say whether another node acknowledges what the robot sends.

        If none does, the controller says so and keeps the frames that it has: the
        first `queue_limit`. They are sent once somebody acknowledges again.
        """
        self._acknowledged = yes
        self._drain()

    def full(self, times: int = 1) -> None:
        """Have no room for the next frames of the robot."""
        self._full = times

    def stall(self) -> None:
        """Take and give nothing until `resume`."""
        self._stalled = True

    def resume(self) -> None:
        """Go on, with the frames of the parts that waited."""
        self._stalled = False
        held = tuple(self._held)
        self._held.clear()
        for frame in held:
            self.send(frame)
        self._drain()

    def fail(self, error: Exception, *, after: int = 0, times: int | None = 1) -> None:
        """Raise an error from a send of the robot.

        Args:
            error: What to raise.
            after: How many sends go well before.
            times: How many sends fail; None for all from then on.
        """
        self._failures.add(error, after, times)

    def bus_off(self) -> None:
        """Take the robot's controller off the bus, until `restart`."""
        self.state = CanState.BUS_OFF
        self._queue.clear()
        self.error_frame(0x40)

    def restart(self) -> None:
        """Start the controller again, as ``ip link set can0 down; ... up`` does."""
        self.state = CanState.ACTIVE
        self._queue.clear()

    def take(self, frame: Frame, node: _MemoryNode) -> bool:
        """Take a frame of the robot; tell whether there was room for it."""
        self._check()
        self._failures.check()
        if self._stalled or self.state is CanState.BUS_OFF:
            return False
        if self._full:
            self._full -= 1
            return False
        if not self._acknowledged:
            if len(self._queue) >= self.queue_limit:
                return False
            if not self._queue:
                self.error_frame(0x20)
            self._queue.append(frame)
            return True
        node.loop.call_soon(self._obey, frame, node.loop)
        return True

    def forget(self, node: _MemoryNode) -> None:
        """Let a node leave."""
        self._users.pop(node, None)
        if node in self._robots:
            self._robots.remove(node)

    def _drain(self) -> None:
        if not self._acknowledged or self._stalled or not self._queue:
            return
        loop = asyncio.get_running_loop()
        while self._queue:
            loop.call_soon(self._obey, self._queue.popleft(), loop)

    def _obey(self, frame: Frame, loop: asyncio.AbstractEventLoop) -> None:
        self._heard(frame._replace(time=clock_of(loop)()))


class _MemoryNode:
    def __init__(self, wire: MemoryCan, received: Received) -> None:
        self.loop: asyncio.AbstractEventLoop = asyncio.get_running_loop()
        self.state: CanState = wire.state
        self._wire = wire
        self._received: Received | None = received

    def listen(self, filters: Collection[Filter] | None) -> None:
        """Hear all: nothing is saved by less."""

    async def send(self, frame: Frame, timeout: float) -> bool:
        if self._received is None:
            raise ConnectionError("the node is closed")
        return self._wire.take(frame, self)

    async def close(self) -> None:
        self._received = None
        self._wire.forget(self)

    def deliver_soon(self, frame: Frame) -> None:
        self.loop.call_soon(self._deliver, frame)

    def _deliver(self, frame: Frame) -> None:
        if self._received is not None:
            self._received(frame._replace(time=clock_of(self.loop)()))
