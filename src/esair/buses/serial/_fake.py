"""A serial line whose far end does what its test says."""

from __future__ import annotations

import asyncio
import random
from collections.abc import Callable, Mapping
from typing import Any

from esair.buses._bus import Bus, LateWire
from esair.buses._exchanges import Exchange
from esair.buses._failures import Failures
from esair.buses._inbox import Awaited, Sent
from esair.buses.serial._bus import SerialBus
from esair.buses.serial._far_end import MemoryLine, PtyLine
from esair.exceptions import DeviceLostError
from esair.framing import Framing
from esair.loop import turn_of

SENT_LIMIT = 1024
"""How many messages of the robot are kept; then the newest win."""

WRITTEN_LIMIT = 65536
"""How many bytes of the robot are kept, and how many may be on their way to it."""

PIECE_PERIOD = 0.001
"""Between two pieces on a pseudo-terminal, in s: the kernel joins what comes at once."""

XOFF, XON = b"\x13", b"\x11"

Reply = Callable[[bytes], bytes | None]


class FakeSerial(SerialBus):
    """A `SerialBus` with nothing real on it: the test is the device.

    On a virtual clock the line is in memory. On a real clock it is a pseudo-terminal,
    opened as any port is, so that descriptors, threads and the kernel take part.

    It can be told everything before it is opened, and it is the same line after it was
    closed, unplugged or hung up; only what waits on it is lost then.

    Args:
        name: Its name.
        framing: What a message is, as for `SerialBus`; in both directions.
        **options: What else `SerialBus` takes, such as ``write_timeout``.

    Attributes:
        sent: The messages that the robot sent, without their framing, oldest first;
            the newest 1024. They are there a moment after ``send`` has returned: `until`
            waits for that.
        written: The same as the bytes that went over the wire; the newest 65536.
        on_write: Called with the bytes that the robot wrote, as they come; what it
            returns goes back to the robot.
        on_frame: Called with each message of the robot; what it returns is framed and
            goes back.
        lost_bytes: How many bytes went to the robot when nobody was there, or did not fit.

    Example:
        >>> async def test_it_asks_who_is_there(fake_serial):
        ...     line = fake_serial("front")
        ...     line.answer(b"who?", b"sonar 1.2")
        ...     await line.open()
        ...     assert await line.ask(b"who?") == b"sonar 1.2"
        ...     assert line.sent[-1] == b"who?"
        ...     await line.close()
    """

    def __init__(
        self,
        name: str = "serial",
        *,
        framing: Framing | str | Mapping[str, Any] = "lines",
        **options: Any,
    ) -> None:
        super().__init__(
            name=name, framing=framing, wire=LateWire(self._reach), **options
        )
        self.sent: Sent[bytes] = Sent(maxlen=SENT_LIMIT)
        self.written: bytes = b""
        self.on_write: Reply | None = None
        self.on_frame: Reply | None = None
        self.lost_bytes: int = 0
        self._plugged = True
        self._stalled = False
        self._room: int | None = None
        self._far: MemoryLine | PtyLine | None = None
        self._far_framing = self.framing.fresh()
        self._answers: dict[bytes, bytes | Reply] = {}
        self._until: Awaited[bytes] = Awaited()
        self._piece = 0
        self._speed = 0.0
        self._outgoing = bytearray()
        self._pushing: asyncio.TimerHandle | None = None
        self._repeated: list[tuple[Callable[[], bytes], float]] = []
        self._repeating: list[asyncio.TimerHandle] = []
        self._failures = Failures()

    # From the device to the robot.

    def feed(self, data: bytes) -> None:
        """Send bytes to the robot, as they are; lost if nobody is there to hear them."""
        if self._line is None or self._far is None:
            self.lost_bytes += len(data)
            return
        room = WRITTEN_LIMIT - len(self._outgoing)
        self.lost_bytes += max(0, len(data) - room)
        self._outgoing += data[:room]
        self._push()

    def say(self, payload: bytes) -> None:
        """Send a message to the robot, framed."""
        self.feed(self._far_framing.encode(payload))

    def garbage(self, seed: int, count: int) -> None:
        """Send random bytes to the robot, the same for the same seed."""
        self.feed(random.Random(seed).randbytes(count))

    def repeat(self, make: Callable[[], bytes], period: float) -> None:
        """Send bytes again and again while the line is open.

        Args:
            make: Called each time for the bytes; none are sent if it returns none.
            period: From one time to the next, in seconds.
        """
        self._repeated.append((make, period))
        if self.is_open:
            self._start_repeating(make, period)

    def split(self, size: int) -> None:
        """Deliver everything in pieces of *size* bytes from now on; 0 for whole."""
        self._piece = size

    def slow(self, bytes_per_second: float) -> None:
        """Send to the robot no faster than this from now on; 0 for no limit."""
        self._speed = bytes_per_second

    # From the robot to the device.

    def answer(self, request: bytes, reply: bytes | Reply) -> None:
        """Answer each message of the robot that equals a request.

        Args:
            request: The message, without its framing.
            reply: What is sent back, framed; or a function that gets the message and
                returns it, or None for silence.
        """
        self._answers[request] = reply

    async def until(
        self, wanted: bytes | Callable[[bytes], bool], *, timeout: float = 1.0
    ) -> bytes:
        """Wait until the robot has sent a message, and return it.

        What is in ``sent`` already counts; clear it to wait for a new one.

        Args:
            wanted: A message without its framing, or a condition on it.
            timeout: How long to wait, in seconds.

        Raises:
            TimeoutError: It did not come; the last messages are in the error.
        """
        return await self._until.until(
            wanted if callable(wanted) else lambda message: message == wanted,
            self.sent,
            timeout,
            lambda: (
                f"{self.name}: {wanted!r} was not sent in {timeout:g} s; "
                f"the last messages are {self.sent[-5:]!r}"
            ),
        )

    # What goes wrong.

    def unplug(self) -> None:
        """Pull the cable: the port is gone until `plug`."""
        self._plugged = False
        self._quiet()
        if self._far is not None:
            self._far.unplug()

    def plug(self) -> None:
        """Plug the cable in again; the bus is told that it can be opened."""
        self._plugged = True
        if self._far is None:
            self.arrived()
        else:
            self._far.plug()

    def end_of_file(self) -> None:
        """Hang up: the line ends, and the port is there to be opened again."""
        self._quiet()
        if self._far is not None:
            self._far.hang_up()

    def stall(self, after: int = 0) -> None:
        """Take and give no byte until `resume`, as a device that holds CTS down.

        Args:
            after: How many bytes it takes before; on a virtual clock only.
        """
        self._stalled = True
        self._room = after
        self._stall_wire()

    def resume(self) -> None:
        """Take and give again, also what waited."""
        self._stalled = False
        if self._far is not None:
            self._far.resume()
        self._push()

    def xoff(self) -> None:
        """Send XOFF: the robot may write no more, if its port heeds XON and XOFF."""
        if isinstance(self._far, MemoryLine) and self._options.get("xonxoff"):
            self._far.stall()
        elif self._far is not None:
            self._far.write(XOFF)

    def xon(self) -> None:
        """Send XON: the robot may write again."""
        if isinstance(self._far, MemoryLine) and self._options.get("xonxoff"):
            self._far.resume()
        elif self._far is not None:
            self._far.write(XON)

    def fail(
        self, error: BaseException, *, after: int = 0, times: int | None = 1
    ) -> None:
        """Raise an error from a write; an `OSError` is the end of the line, too.

        Args:
            error: What the kernel, or pyserial, says.
            after: How many writes go well before.
            times: How many writes fail; None for all from then on.
        """
        self._failures.add(error, after, times)

    # The bus, as the robot uses it.

    def _put(self, data: bytes, request: Exchange | None = None) -> int:
        error = self._failures.due() if self.is_open else None
        if isinstance(error, OSError) and self._line is not None:
            self._line.connection_lost(error)
            assert self.error is not None
            raise self.error
        if error is not None:
            raise error
        return super()._put(data, request)

    async def close(self) -> None:
        """Close the bus; the next opening makes a new line."""
        await super().close()
        if isinstance(self._far, PtyLine):  # a safe command is the last to come
            self._far.hear_the_rest()
        self._drop_wire()

    async def _open(self) -> None:
        await super()._open()
        for make, period in self._repeated:
            self._start_repeating(make, period)

    async def _close(self) -> None:
        self._quiet()
        await super()._close()

    async def _reach(self, _bus: Bus) -> MemoryLine | PtyLine:
        if not self._plugged:
            raise DeviceLostError(self.name, "nothing is plugged in")
        self._far_framing = self.framing.fresh()
        if self._far is None:
            virtual = turn_of(asyncio.get_running_loop()).virtual
            self._far = MemoryLine(self.name) if virtual else PtyLine()
            self._far.heard = self._heard
            self._far.plug()
        self._stall_wire()
        return self._far

    def _drop_wire(self) -> None:
        wire, self._far = self._far, None
        if wire is not None:
            wire.unplug()
            self.lost_bytes += wire.lost

    def _stall_wire(self) -> None:
        if not self._stalled or self._far is None:
            return
        if isinstance(self._far, MemoryLine):
            self._far.stall(self._room or 0)
        else:
            self._far.stall()

    def _heard(self, data: bytes) -> None:
        self.written = (self.written + data)[-WRITTEN_LIMIT:]
        if self.on_write is not None and (back := self.on_write(data)):
            self.feed(back)
        for message in self._far_framing.feed(data):
            self.sent.append(message)
            reply = self._answers.get(message, self.on_frame)
            payload = reply(message) if callable(reply) else reply
            if payload is not None:
                self.say(payload)
            self._until.came(message)

    def _push(self) -> None:
        """Send what waits: at once, or piece by piece."""
        if self._stalled or self._pushing is not None:
            return
        wire = self._far
        while wire is not None and self._outgoing:
            size = self._piece or len(self._outgoing)
            pause = PIECE_PERIOD if self._piece and isinstance(wire, PtyLine) else 0.0
            if self._speed:
                size = self._piece or max(1, int(self._speed * PIECE_PERIOD))
                pause = size / self._speed
            piece = bytes(self._outgoing[:size])
            del self._outgoing[:size]
            wire.write(piece)
            if pause:
                loop = asyncio.get_running_loop()
                self._pushing = loop.call_later(pause, self._push_on)
                return

    def _push_on(self) -> None:
        self._pushing = None
        self._push()

    def _start_repeating(self, make: Callable[[], bytes], period: float) -> None:
        loop = asyncio.get_running_loop()
        place = len(self._repeating)

        def turn() -> None:
            self._repeating[place] = loop.call_later(period, turn)
            if data := make():
                self.feed(data)

        self._repeating.append(loop.call_later(period, turn))

    def _quiet(self) -> None:
        """Have nothing on its way any more."""
        self._outgoing.clear()
        if self._pushing is not None:
            self._pushing.cancel()
            self._pushing = None
        for timer in self._repeating:
            timer.cancel()
        self._repeating.clear()
