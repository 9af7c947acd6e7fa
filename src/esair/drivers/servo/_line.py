"""The line to the servos, as the maker's package wants it and as a port has it."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import select
import struct
import termios
from typing import Final, Protocol

from esair.buses.serial import Port
from esair.loop import now

ANSWER_TIMEOUT: Final = 0.05
"""How long a servo may take for a whole answer, in seconds."""

GRACE: Final = 0.1
"""How much later an answer that is there may be taken, in seconds."""

_LOW_LATENCY: Final = 0x2000
"""A flag of ``struct serial_struct``, and where they are in it; linux/serial.h."""
_FLAGS: Final = 16


class ServoLink(Protocol):
    """A half-duplex line to servos; may block, is used by one thread."""

    def write(self, data: bytes, seconds: float) -> None:
        """Send bytes; raise `OSError` if they cannot all be sent in time."""

    def read(self, size: int, seconds: float) -> bytes:
        """Return at least one and at most *size* bytes; none if none come in time."""

    def discard(self) -> None:
        """Throw away what has come and was not read."""

    def close(self) -> None:
        """Let the line go."""


class SdkPort:
    """The SDK's ``PortHandler``, with a line that waits instead of spinning.

    The SDK's own reads nothing again and again until its time, which is wall time, has
    passed; and on a line that is never silent it reads for ever.
    """

    def __init__(self, line: ServoLink, baudrate: int) -> None:
        self.line = line
        self.is_using = False
        self._baudrate = baudrate
        self._end = 0.0

    def close(self) -> None:
        self.line.close()

    def getBaudRate(self) -> int:  # noqa: N802 - the SDK's names
        return self._baudrate

    def clearPort(self) -> None:  # noqa: N802
        self.line.discard()

    def writePort(self, packet: list[int]) -> int:  # noqa: N802
        self.line.write(bytes(packet), ANSWER_TIMEOUT)
        self._end = now() + ANSWER_TIMEOUT
        return len(packet)

    def readPort(self, length: int) -> bytes:  # noqa: N802
        # What is there is taken a little later, too: this thread may have come late.
        left = self._end - now()
        return self.line.read(length, max(0.0, left)) if left > -GRACE else b""

    def setPacketTimeout(self, packet_length: int) -> None:  # noqa: N802
        """Keep the deadline, which began with the request."""

    def setPacketTimeoutMillis(self, msec: float) -> None:  # noqa: N802
        """Keep the deadline, which began with the request."""

    def isPacketTimeout(self) -> bool:  # noqa: N802
        return now() >= self._end


class PortLink:
    """An open port, for a thread that may wait."""

    def __init__(self, port: Port) -> None:
        self._port = port
        self._fd = port.fileno()
        self._hasten()

    def fileno(self) -> int:
        return self._fd

    def _hasten(self) -> None:
        """Have an adapter of FTDI pass on at once what came: it keeps it for 16 ms."""
        state = bytearray(128)
        with contextlib.suppress(OSError):  # another driver has nothing like that
            fcntl.ioctl(self._fd, termios.TIOCGSERIAL, state)
            (flags,) = struct.unpack_from("=i", state, _FLAGS)
            struct.pack_into("=i", state, _FLAGS, flags | _LOW_LATENCY)
            fcntl.ioctl(self._fd, termios.TIOCSSERIAL, state)

    def write(self, data: bytes, seconds: float) -> None:
        end = now() + seconds
        while data:
            self._wait(select.POLLOUT, end - now())
            with contextlib.suppress(BlockingIOError):
                data = data[os.write(self._fd, data) :]
            if data and now() > end:
                raise TimeoutError(errno.ETIMEDOUT, "the servos' line takes no bytes")

    def read(self, size: int, seconds: float) -> bytes:
        if not self._wait(select.POLLIN, seconds):
            return b""
        with contextlib.suppress(BlockingIOError):
            return os.read(self._fd, size)
        return b""

    def discard(self) -> None:
        while self.read(4096, 0.0):
            pass

    def close(self) -> None:
        self._port.shut()

    def _wait(self, event: int, seconds: float) -> bool:
        poll = select.poll()
        poll.register(self._fd, event)
        found = poll.poll(max(0.0, seconds) * 1000)
        if found and found[0][1] & (select.POLLHUP | select.POLLERR | select.POLLNVAL):
            raise OSError(errno.EIO, "the other end hung up")
        return bool(found)
