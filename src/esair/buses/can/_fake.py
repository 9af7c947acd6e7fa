"""The far end of a CAN bus, in memory, and the fake whose other nodes a test plays."""

from __future__ import annotations

import asyncio
import collections
from collections.abc import Callable, Collection, Iterable
from typing import Any, TypeAlias

import attrs

from esair.buses._bus import listen
from esair.buses._fakes import Fake
from esair.buses.can import _frame as frames
from esair.buses.can._bus import CanBus
from esair.buses.can._frame import (
    CanState,
    CanWire,
    Filter,
    Frame,
    FrameKind,
    FrameLink,
)
from esair.loop import clock_of

Reply: TypeAlias = "Frame | Iterable[Frame] | None"


class MemoryCan(CanWire):
    """A CAN bus in memory: the robot's node gets the frames of all others, in order.

    Args:
        heard: Called with each frame of the robot that is on the wire.
        takes: Takes a frame of the robot, and tells whether there was room for it; puts it
            on the wire by `carry`, now or later. All go there at once unless given.

    Attributes:
        state: The state of the robot's controller.
    """

    def __init__(
        self,
        heard: Callable[[Frame], None],
        takes: Callable[[Frame], bool] | None = None,
    ) -> None:
        super().__init__()
        self.plugged: bool = True
        self.state: CanState = CanState.ACTIVE
        self._heard = heard
        self._takes = takes or self.carry
        self._robots: list[_MemoryNode] = []

    def unplug(self) -> None:
        """Take the robot's adapter away."""
        if self.plugged:
            self.plugged = False
            for node in tuple(self._robots):
                node.gone(ConnectionError("it was unplugged"))

    def plug(self) -> None:
        """Bring it back."""
        if not self.plugged:
            self.plugged = True
            self._tell_plugged()

    def send(self, frame: Frame) -> None:
        """Send a frame of a part, or an error frame of its controller, to the robot."""
        for node in tuple(self._robots):
            node.loop.call_soon(node.deliver, frame)

    async def open(
        self, received: Callable[[Frame], None], gone: Callable[[Exception], None]
    ) -> FrameLink:
        """Open a node of the robot.

        Raises:
            ConnectionError: It is unplugged.
        """
        self.check()
        node = _MemoryNode(self, self.state, received, gone)
        self._robots.append(node)
        return node

    def check(self) -> None:
        """Raise a `ConnectionError` if it is unplugged."""
        if not self.plugged:
            raise ConnectionError("it is unplugged")

    def take(self, frame: Frame) -> bool:
        """Take a frame of the robot; tell whether there was room for it."""
        self.check()
        return self._takes(frame)

    def carry(self, frame: Frame) -> bool:
        """Put a frame of the robot on the wire."""
        loop = asyncio.get_running_loop()
        loop.call_soon(self._obey, frame, clock_of(loop))
        return True

    def _obey(self, frame: Frame, clock: Callable[[], float]) -> None:
        self._heard(frame._replace(time=clock()))

    def forget(self, node: _MemoryNode) -> None:
        """Let a node leave."""
        if node in self._robots:
            self._robots.remove(node)


@attrs.define(eq=False)
class _MemoryNode:
    _wire: MemoryCan
    state: CanState
    _received: Callable[[Frame], None] | None
    gone: Callable[[Exception], None]
    loop: asyncio.AbstractEventLoop = attrs.field(factory=asyncio.get_running_loop)

    def listen(self, filters: Collection[Filter] | None) -> None:
        """Hear all: nothing is saved by less."""

    async def send(self, frame: Frame, timeout: float) -> bool:
        if self._received is None:
            raise ConnectionError("the node is closed")
        return self._wire.take(frame)

    async def close(self) -> None:
        self._received = None
        self._wire.forget(self)

    def deliver(self, frame: Frame) -> None:
        if self._received is not None:
            self._received(frame._replace(time=clock_of(self.loop)()))


SENT_LIMIT = 100_000
"""How many frames of the robot are remembered; then the newest win."""

QUEUE_LIMIT = 10
"""How many frames of the robot its controller keeps while nobody acknowledges."""

HOLD_LIMIT = 1024
"""How many frames of the other nodes wait while the bus is stalled."""


class FakeCan(Fake[Frame, int], CanBus):
    """A CAN bus whose other nodes say what a test tells them to say.

    ::

        async def test_wheels_turn(fake_can):
            can = fake_can("drive")
            can.answer(0x101, Frame(0x181, b"ok"))
            async with esair.Robot(resources=[Wheels(bus=can)], behaviors=[Go()]):
                frame = await can.until(0x101)
            assert frame.data == b"go"

    It is in memory, so it works on the virtual clock and on the real one, and its
    frames come in the order in which they were sent.

    ``until(wanted, timeout=1.0)`` waits for a frame, by its id or a condition; of each id
    the newest counts, also one that was sent before. ``fail(error, after=0, times=1)``
    raises an error from a send; an `OSError` is the loss of the bus.

    Args:
        name: The name of the bus.
        **options: ``send_timeout``, ``fd`` and ``lost_when`` of `CanBus`.

    Attributes:
        sent: The frames that the robot has sent and that reached the bus, in order. They
            are there a moment after ``send`` has returned: ``until`` waits for that.
        dropped: How many frames to the robot were lost because the bus was stalled for
            too long.
    """

    def __init__(self, name: str = "can", **options: Any) -> None:
        self._far = MemoryCan(self._heard, self._takes)
        super().__init__(name=name, interface="fake", wire=self._far, **options)
        self._begin(SENT_LIMIT)
        self.dropped: int = 0
        self._powered = True
        self._newest: dict[int, Frame] = {}
        self._on_send: list[Callable[[Frame], Reply]] = []
        self._queue: collections.deque[Frame] = collections.deque()
        self._held: collections.deque[Frame] = collections.deque(maxlen=HOLD_LIMIT)
        self._acknowledged = True
        self._stalled = False
        self._full = 0

    def feed(
        self,
        id: int,  # noqa: A002 - what everybody calls it
        data: bytes = b"",
        *,
        extended: bool = False,
        remote: bool = False,
    ) -> None:
        """Send a frame to the robot; it is lost if the bus is closed or unplugged."""
        frames.key_of(self.name, id, extended=extended)
        frames.check_data(self.name, data, fd=self.fd)
        kind = FrameKind.REMOTE if remote else FrameKind.DATA
        if not self._powered:
            return
        self._say(Frame(id, bytes(data), extended, kind=kind))

    def on_send(self, listener: Callable[[Frame], Reply]) -> Callable[[], None]:
        """Call a function with each frame of the robot; what it returns is sent back.

        Args:
            listener: Returns a frame, several, or None.

        Returns:
            How to stop that.
        """
        return listen(self._on_send, listener)

    def answer(
        self,
        id: int,  # noqa: A002 - what everybody calls it
        reply: Reply | Callable[[Frame], Reply],
        *,
        extended: bool = False,
    ) -> Callable[[], None]:
        """Answer each frame with an id.

        Args:
            id: The id of the frames that are answered.
            reply: A frame, several, or a function that makes them of the question.
            extended: Whether the id has 29 bits.

        Returns:
            How to stop that.
        """
        frames.key_of(self.name, id, extended=extended)

        def listener(frame: Frame) -> Reply:
            if (frame.id, frame.extended) != (id, extended):
                return None
            return reply(frame) if callable(reply) else reply

        return self.on_send(listener)

    def error_frame(self, error: int | CanState, data: bytes = b"") -> None:
        """Have the robot's controller report an error.

        Args:
            error: A state that it enters; or the classes of an error frame, as in
                ``linux/can/error.h``.
            data: The bytes of the error frame; what is missing of 8 is zero.
        """
        classes: int = error
        if error is CanState.BUS_OFF:
            classes = frames.BUS_OFF
        elif isinstance(error, CanState):
            classes = frames.CONTROLLER
            data = bytes((0, frames.CONTROLLER_BITS[error])) + data[2:]
        frame = Frame(classes, data.ljust(8, b"\0"), kind=FrameKind.ERROR)
        self._far.send(frame)

    def bus_off(self) -> None:
        """Take the robot's controller off the bus; it cannot be opened until `restart`."""
        self._far.state = CanState.BUS_OFF
        self._queue.clear()
        self.error_frame(CanState.BUS_OFF)

    def restart(self) -> None:
        """Start the controller again, and say that the bus can be opened."""
        self._start()
        self.arrived()

    def _start(self) -> None:
        self._far.state = CanState.ACTIVE
        self._queue.clear()

    def acknowledge(self, yes: bool = True) -> None:
        """Say whether another node acknowledges what the robot sends.

        If none does, the controller reports it and keeps 10 frames; then there is no
        room. What it has kept goes out once somebody acknowledges.
        """
        self._acknowledged = yes
        self._drain()

    def full(self, times: int = 1) -> None:
        """Have no room for the next frames: so many times, retries included."""
        self._full = times

    def silence(self) -> None:
        """Have nodes without power: what they are told reaches none, and none speaks."""
        self._powered = False

    def speak(self) -> None:
        """Have nodes with power again."""
        self._powered = True

    def power_cycle(self, seconds: float = 0.5) -> None:
        """Take the nodes' power; they have started again after so many seconds."""
        self.silence()
        asyncio.get_running_loop().call_later(seconds, self.speak)

    def stall(self) -> None:
        """Take and give no frames until `resume`."""
        self._stalled = True

    def resume(self) -> None:
        """Go on, with the frames that were fed meanwhile, the newest 1024."""
        self._stalled = False
        while self._held:
            self._far.send(self._held.popleft())
        self._drain()

    def unplug(self) -> None:
        """Be gone, from this moment on."""
        self._far.unplug()

    def plug(self) -> None:
        """Be there again, with a controller that was started anew."""
        self._start()
        self._far.plug()

    def _say(self, frame: Frame) -> None:
        if not self._stalled:
            self._far.send(frame)
            return
        self.dropped += len(self._held) == HOLD_LIMIT
        self._held.append(frame)

    def _takes(self, frame: Frame) -> bool:
        self._failures.check()
        if self._stalled or self._far.state is CanState.BUS_OFF:
            return False
        if self._full:
            self._full -= 1
            return False
        if self._acknowledged:
            return self._far.carry(frame)
        if len(self._queue) >= QUEUE_LIMIT:
            return False
        if not self._queue:
            self.error_frame(frames.NO_ACKNOWLEDGE)
        self._queue.append(frame)
        return True

    def _drain(self) -> None:
        while self._queue and self._acknowledged and not self._stalled:
            self._far.carry(self._queue.popleft())

    def _is(self, item: Frame, wanted: int) -> bool:
        return item.id == wanted

    def _there(self) -> Iterable[Frame]:
        return reversed(self._newest.values())

    def _heard(self, frame: Frame) -> None:
        key = frames.key_of(self.name, frame.id, extended=frame.extended)
        self._newest.pop(key, None)
        self._newest[key] = frame
        self.sent.append(frame)
        self._awaited.came(frame)
        for listener in tuple(self._on_send) if self._powered else ():
            reply = listener(frame)
            for each in [reply] if isinstance(reply, Frame) else reply or ():
                self._say(each)
