"""A CAN bus in memory, whose other nodes a test plays."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable
from typing import Any, TypeAlias

from esair.buses._bus import listen
from esair.buses._inbox import Awaited, Sent
from esair.buses.can import _frame as frames
from esair.buses.can._bus import CanBus
from esair.buses.can._far_end import MemoryCan
from esair.buses.can._frame import CanState, Frame, FrameKind

SENT_LIMIT = 100_000
"""How many frames of the robot are remembered; then the newest win."""

Reply: TypeAlias = "Frame | Iterable[Frame] | None"


class FakeCan(CanBus):
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

    Args:
        name: The name of the bus.
        **options: ``send_timeout``, ``fd`` and ``lost_when`` of `CanBus`.

    Attributes:
        sent: The frames that the robot has sent and that reached the bus, in order. They
            are there a moment after ``send`` has returned: `until` waits for that.
    """

    def __init__(self, name: str = "can", **options: Any) -> None:
        self._far = MemoryCan(self._heard)
        super().__init__(name=name, interface="fake", wire=self._far, **options)
        self.sent: Sent[Frame] = Sent(maxlen=SENT_LIMIT)
        self._powered = True
        self._newest: dict[int, Frame] = {}
        self._on_send: list[Callable[[Frame], Reply]] = []
        self._until: Awaited[Frame] = Awaited()

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
        self._far.send(Frame(id, bytes(data), extended, kind=kind))

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

    async def until(
        self, wanted: int | Callable[[Frame], bool], *, timeout: float = 1.0
    ) -> Frame:
        """Wait until the robot has sent a frame, and return it.

        Of each id the newest frame counts, also one that was sent before the call.

        Args:
            wanted: An id, or a condition on a frame.
            timeout: How long to wait, in seconds.

        Raises:
            TimeoutError: It did not come; the last frames are in the message.
        """
        words = repr(wanted) if callable(wanted) else f"a frame {wanted:#x}"
        return await self._until.until(
            wanted if callable(wanted) else lambda frame: frame.id == wanted,
            reversed(self._newest.values()),
            timeout,
            lambda: (
                f"{self.name}: {words} did not come in {timeout:g} s; "
                f"the last frames are {self.sent[-5:]!r}"
            ),
        )

    def error_frame(self, error: int | CanState, data: bytes = b"") -> None:
        """Have the robot's controller report an error.

        Args:
            error: A state that it enters; or the classes of an error frame, as in
                ``linux/can/error.h``.
            data: The bytes of the error frame.
        """
        if error is CanState.BUS_OFF:
            self._far.error_frame(frames.BUS_OFF, data)
        elif isinstance(error, CanState):
            said = bytes((0, frames.CONTROLLER_BITS[error])) + data[2:]
            self._far.error_frame(frames.CONTROLLER, said)
        else:
            self._far.error_frame(error, data)

    def bus_off(self) -> None:
        """Take the robot's controller off the bus; it cannot be opened until `restart`."""
        self._far.bus_off()

    def restart(self) -> None:
        """Start the controller again, and say that the bus can be opened."""
        self._far.restart()
        self.arrived()

    def acknowledge(self, yes: bool = True) -> None:
        """Say whether another node acknowledges what the robot sends.

        If none does, the controller reports it and keeps 10 frames; then there is no
        room. What it has kept goes out once somebody acknowledges.
        """
        self._far.acknowledge(yes)

    def full(self, times: int = 1) -> None:
        """Have no room for the next frames: so many times, retries included."""
        self._far.full(times)

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
        self._far.stall()

    def resume(self) -> None:
        """Go on, with the frames that were fed meanwhile, the newest 1024."""
        self._far.resume()

    def unplug(self) -> None:
        """Be gone, from this moment on."""
        self._far.unplug()

    def plug(self) -> None:
        """Be there again, with a controller that was started anew."""
        self._far.restart()
        self._far.plug()

    def fail(self, error: Exception, *, after: int = 0, times: int | None = 1) -> None:
        """Raise an error from a send of the robot.

        Args:
            error: What to raise; an `OSError` is the loss of the bus.
            after: How many sends go well before.
            times: How many sends fail; None for all from then on.
        """
        self._far.fail(error, after=after, times=times)

    def _heard(self, frame: Frame) -> None:
        key = frames.key_of(self.name, frame.id, extended=frame.extended)
        self._newest.pop(key, None)
        self._newest[key] = frame
        self.sent.append(frame)
        self._until.came(frame)
        for listener in tuple(self._on_send) if self._powered else ():
            reply = listener(frame)
            if isinstance(reply, Frame):
                self._far.send(reply)
            elif reply is not None:
                for each in reply:
                    self._far.send(each)
