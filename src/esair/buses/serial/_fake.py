"""The far ends of a serial line (a pseudo-terminal, memory), and the fake that has one."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import os
import pty
import random
import termios
import tty
from collections.abc import Awaitable, Callable, Mapping
from pathlib import Path
from typing import Any

import attrs

from esair.buses._bus import Bus, LateWire
from esair.buses._exchanges import Exchange
from esair.buses._fakes import Fake, os_error
from esair.buses.serial._bus import SerialBus
from esair.buses.serial._line import SerialLink, SerialWire
from esair.exceptions import DeviceLostError
from esair.framing import Framing
from esair.loop import ignore, turn_of


class FarLine(SerialWire):
    """What the far ends have in common.

    Attributes:
        heard: Called with the bytes that come from the robot.
        lost: How many bytes were lost, because nobody took them.
    """

    def __init__(self) -> None:
        super().__init__()
        self.heard: Callable[[bytes], None] = ignore
        self.lost: int = 0
        self._loop = asyncio.get_running_loop()


class PtyLine(FarLine):
    """A serial line that is a pseudo-terminal, and can be unplugged.

    Args:
        path: Where the port appears, as a symbolic link, while it is plugged in; only
            under the name that the kernel gives it if None.
    """

    def __init__(self, path: Path | None = None) -> None:
        super().__init__()
        self.path = path
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

    def stall(self, after: int = 0) -> None:
        """Take no byte more, as a device that holds CTS down; at once in any case."""
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


class MemoryLine(FarLine):
    """A serial line in memory, with the same ends as a `PtyLine`."""

    def __init__(self, name: str) -> None:
        super().__init__()
        self.name = name
        self._link: _MemoryLink | None = None
        self.plugged: bool = False
        """Whether the port is there."""
        self._room: int | None = None

    def plug(self) -> None:
        """Let the port appear; nothing happens if it is there."""
        if not self.plugged:
            self.plugged = True
            self._tell_plugged()

    def unplug(self) -> None:
        """Let the port vanish, as a pulled cable does."""
        self.plugged = False
        self._break_off(os_error(errno.EIO))

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
        if not self.plugged:
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
        if self.plugged:
            self.heard(data)


@attrs.define(eq=False)
class _MemoryLink:
    """The robot's end of a line in memory."""

    _loop: asyncio.AbstractEventLoop
    _protocol: asyncio.Protocol | None
    _far_end: Callable[[bytes], int]
    _waiting: bytes = b""
    _broken: bool = False

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


SENT_LIMIT = 1024
"""How many messages of the robot are kept; then the newest win."""

WRITTEN_LIMIT = 65536
"""How many bytes of the robot are kept, and how many may be on their way to it."""

PIECE_PERIOD = 0.001
"""Between two pieces on a pseudo-terminal, in s: the kernel joins what comes at once."""

XOFF, XON = b"\x13", b"\x11"

Reply = Callable[[bytes], bytes | None]


class FakeSerial(Fake[bytes, bytes], SerialBus):
    """A `SerialBus` with nothing real on it: the test is the device.

    On a virtual clock the line is in memory. On a real clock it is a pseudo-terminal,
    opened as any port is, so that descriptors, threads and the kernel take part.

    ``until(wanted, timeout=1.0)`` waits for a message of the robot and returns it, the
    oldest in ``sent`` that is meant; ``fail(error, after=0, times=1)`` raises an error
    from a write, and an `OSError` is the end of the line, too.

    It can be told everything before it is opened, and it is the same line after it was
    closed, unplugged or hung up; only what waits on it is lost then.

    Args:
        name: Its name.
        framing: What a message is, as for `SerialBus`; in both directions.
        echo: Whether there is one wire for both directions: what the robot writes comes
            back to it, before any answer. An ``on_write`` of the test makes the echo itself,
            as part of what it returns, so that it can be damaged or missing.
        **options: What else `SerialBus` takes, such as ``write_timeout``.

    Attributes:
        sent: The messages that the robot sent, without their framing, oldest first;
            the newest 1024. They are there a moment after ``send`` has returned: ``until``
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
        echo: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(
            name=name,
            framing=framing,
            wire=LateWire(self._reach),
            echo=echo,
            **options,
        )
        self._begin(SENT_LIMIT)
        self.written: bytes = b""
        self.on_write: Reply | None = None
        self.on_frame: Reply | None = None
        self.lost_bytes: int = 0
        self._plugged = True
        self._stalled = False
        self._room = 0
        self._far: MemoryLine | PtyLine | None = None
        self._far_framing = self.framing.fresh()
        self._answers: dict[bytes, bytes | Reply] = {}
        self._piece = 0
        self._speed = 0.0
        self._outgoing = bytearray()
        self._pushing: asyncio.TimerHandle | None = None
        self._repeated: list[tuple[Callable[[], bytes], float]] = []
        self._repeating: list[asyncio.TimerHandle] = []

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
        if self._far is not None:
            self._far.stall(after)

    def resume(self) -> None:
        """Take and give again, also what waited."""
        self._stalled = False
        if self._far is not None:
            self._far.resume()
        self._push()

    def xoff(self) -> None:
        """Send XOFF: the robot may write no more, if its port heeds XON and XOFF."""
        self._heed(XOFF, MemoryLine.stall)

    def xon(self) -> None:
        """Send XON: the robot may write again."""
        self._heed(XON, MemoryLine.resume)

    def _heed(self, byte: bytes, act: Callable[[MemoryLine], object]) -> None:
        if isinstance(self._far, MemoryLine) and self._options.get("xonxoff"):
            act(self._far)
        elif self._far is not None:
            self._far.write(byte)

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
        if self._stalled:
            self._far.stall(self._room)
        return self._far

    def _drop_wire(self) -> None:
        wire, self._far = self._far, None
        if wire is not None:
            wire.unplug()
            self.lost_bytes += wire.lost

    def _heard(self, data: bytes) -> None:
        self.written = (self.written + data)[-WRITTEN_LIMIT:]
        echo = data if self._echoes else None
        if back := self.on_write(data) if self.on_write is not None else echo:
            self.feed(back)
        for message in self._far_framing.feed(data):
            self.sent.append(message)
            reply = self._answers.get(message, self.on_frame)
            payload = reply(message) if callable(reply) else reply
            if payload is not None:
                self.say(payload)
            self._awaited.came(message)

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
