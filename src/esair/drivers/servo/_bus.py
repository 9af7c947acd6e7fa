"""The line of the servos: master and servos take turns on one wire."""

from __future__ import annotations

import contextlib
import errno
import os
import select
import time
from collections.abc import Callable
from typing import Any, Final, Protocol, TypeVar

from dynamixel_sdk import (  # type: ignore[import-untyped]
    COMM_RX_CORRUPT,
    COMM_RX_TIMEOUT,
    PacketHandler,
)

from esair.buses import Bus, Exchanges, open_on, shut_on, wanted
from esair.buses.serial import OPEN_TIMEOUT, Port, SerialPlace, close_port, reach_port
from esair.exceptions import (
    ConfigError,
    DeviceFaultError,
    DeviceLostError,
    DriverStuckError,
    describe,
)
from esair.watchdog import Outlet

T = TypeVar("T")

HARDWARE_ERROR = 70

ANSWER_TIMEOUT: Final = 0.05
"""How long a servo may take for a whole answer, in seconds."""

LATE_LIMIT: Final = 0.1
"""How long after it was given up an answer may still come, in seconds."""

ALERT: Final = 0x80
"""The bit of an answer that says: look at ``HARDWARE_ERROR``."""

_HARDWARE_ERRORS = {
    0x01: "input voltage",
    0x04: "overheating",
    0x08: "motor encoder",
    0x10: "electrical shock",
    0x20: "overload",
}


def hardware_errors(bits: int) -> str:
    """Name the bits of ``HARDWARE_ERROR``."""
    named = [text for bit, text in _HARDWARE_ERRORS.items() if bits & bit]
    return ", ".join(named) or f"code {bits:#04x}"


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


class ServoBus(Bus):
    """The line that servos share.

    In ``bus.stats`` what is sent and received is counted in packets.

    Args:
        name: The name of the bus.
        port: A device file, or ``usb:VID:PID[:SERIAL]``.
        baudrate: Bits per second; servos come set to 57600.
        timeout: How long one request may take, its turn included, in seconds.
        opener: Opens something else than a port, such as a fake; may block.
    """

    def __init__(
        self,
        *,
        name: str,
        port: str = "",
        baudrate: int = 57600,
        timeout: float = 0.5,
        opener: Callable[[], ServoLink] | None = None,
    ) -> None:
        super().__init__(name=name)
        if type(baudrate) is not int or baudrate < 1:
            raise ConfigError(
                name, "baudrate", f"expected bits per second, not {baudrate!r:.80}"
            )
        self.port = port
        self.baudrate = baudrate
        self.timeout = timeout
        self._opener = opener
        self._exchanges = Exchanges(self, late_limit=LATE_LIMIT)
        self._device: Port | None = None
        self._link: _SdkPort | None = None
        self._handler: Any = PacketHandler(2.0)
        self._place: SerialPlace | None = None
        if opener is None:
            self._place = SerialPlace(name, port)
            self._presence = self._place.look
            if self._place.is_url:
                raise ConfigError(
                    name, "port", f"expected a device file or usb:..., not {port!r:.80}"
                )

    @property
    def outlet(self) -> Outlet | None:
        """A duplicate of the descriptor of its port."""
        if self._device is None or not self._device.has_descriptor:
            return None
        return Outlet("serial", descriptor=self._device.fileno())

    def packet(self, servo: int, address: int, value: int) -> bytes:
        """Return the packet that writes one byte and wants no answer."""
        written: list[bytes] = []

        class Captured:
            is_using = False

            def writePort(self, packet: list[int]) -> int:  # noqa: N802 - the SDK's
                written.append(bytes(packet))
                return len(packet)

            def clearPort(self) -> None:  # noqa: N802
                """There is nothing in it."""

        self._handler.write1ByteTxOnly(Captured(), servo, address, value)
        return b"".join(written)

    async def ping(self, servo: int) -> int:
        """Return the model number of a servo.

        Raises:
            DeviceFaultError: It does not answer, or its answer is damaged.
            DeviceLostError: The line is gone.
            DriverStuckError: It took too long.
        """

        def call(handler: Any, link: _SdkPort) -> tuple[int, int, int]:
            return handler.ping(link, servo)  # type: ignore[no-any-return]

        return await self._request(servo, "ping", call)

    async def read(self, servo: int, address: int, size: int) -> int:
        """Return an entry of a servo's control table of 1, 2 or 4 bytes.

        Errors are those of `ping`; a servo that has shut down is a fault, too.
        """

        def call(handler: Any, link: _SdkPort) -> tuple[int, int, int]:
            read = {
                1: handler.read1ByteTxRx,
                2: handler.read2ByteTxRx,
                4: handler.read4ByteTxRx,
            }[size]
            return read(link, servo, address)  # type: ignore[no-any-return]

        return await self._request(servo, f"read {address}", call)

    async def write(self, servo: int, address: int, size: int, value: int) -> None:
        """Change an entry of a servo's control table; args and errors as for `read`."""

        def call(handler: Any, link: _SdkPort) -> tuple[int, int, int]:
            write = {
                1: handler.write1ByteTxRx,
                2: handler.write2ByteTxRx,
                4: handler.write4ByteTxRx,
            }[size]
            result, error = write(link, servo, address, value & (1 << 8 * size) - 1)
            return 0, result, error

        await self._request(servo, f"write {address}", call)

    async def _request(
        self,
        servo: int,
        what: str,
        call: Callable[[Any, _SdkPort], tuple[int, int, int]],
    ) -> int:
        link = self._link
        if not self.is_open or link is None:
            raise DeviceLostError(self.name, "the line is not open")
        # The package tells answers apart by the servo, and throws away what came before.
        exchange = self._exchanges.request(servo, timeout=self.timeout)
        exchange.name = what
        async with exchange:
            exchange.begin()
            value, result, error = await self._call(link, what, call, exchange.left)
            if result != COMM_RX_TIMEOUT:
                exchange.end()
        if result:
            self.stats.bad_frames += result == COMM_RX_CORRUPT
            fault = DeviceFaultError(
                self.name, f"servo {servo}, {what}: {_plain(self._handler, result)}"
            )
            if result == COMM_RX_TIMEOUT:
                fault.errno = errno.ETIMEDOUT  # it has no power, say
            self._count(fault)
            raise fault
        self.stats.received += 1
        if error & ALERT and what != _LOOK:
            bits = await self.read(servo, HARDWARE_ERROR, 1)
            raise DeviceFaultError(
                self.name,
                f"servo {servo} has shut down: {hardware_errors(bits)}; "
                "take its power away for a moment",
            )
        if error & ~ALERT:
            text = self._handler.getRxPacketError(error & ~ALERT)
            raise DeviceFaultError(
                self.name, f"servo {servo}, {what}: {text.rpartition('] ')[2]}"
            )
        return value

    async def _call(
        self,
        link: _SdkPort,
        what: str,
        call: Callable[[Any, _SdkPort], tuple[int, int, int]],
        seconds: float,
    ) -> tuple[int, int, int]:
        if self._link is not link:
            raise DeviceLostError(self.name, "the line is not open")
        self.stats.sent += 1
        try:
            return await self.executor.call(
                self._run, link, call, timeout=seconds, guard=wanted
            )
        except DriverStuckError as stuck:
            self._count(stuck)
            raise
        except TimeoutError as slow:
            late = DriverStuckError(self.name, what, ANSWER_TIMEOUT)
            self._count(late)
            raise late from slow
        except OSError as gone:
            loss = DeviceLostError(self.name, describe(gone))
            self._exchanges.fail(loss)
            self.lost(loss)
            raise loss from gone

    def _run(
        self, link: _SdkPort, call: Callable[[Any, _SdkPort], tuple[int, int, int]]
    ) -> tuple[int, int, int]:
        link.is_using = False  # what a call that has failed half-way has left
        return call(self._handler, link)

    def _count(self, error: BaseException) -> None:
        self.stats.errors += 1
        self.stats.last_error = describe(error)

    async def _open(self) -> None:
        await self._close()  # what a loss has left behind
        self._exchanges.clear()
        line: ServoLink
        if self._opener is None:
            assert self._place is not None
            self._device = await reach_port(
                self.executor, self._place, self.baudrate, {}, {}
            )
            line = _PortLink(self._device.fileno())
        else:
            try:
                line = await open_on(
                    self.executor, self._opener, _close_line, timeout=OPEN_TIMEOUT
                )
            except DeviceLostError:
                raise
            except OSError as error:  # DriverStuckError is one
                raise DeviceLostError(self.name, describe(error)) from error
        self._link = _SdkPort(line, self.baudrate)

    async def _close(self) -> None:
        link, self._link = self._link, None
        device, self._device = self._device, None
        if device is not None:
            await close_port(device, self.executor)
        elif link is not None:
            await shut_on(self.executor, lambda: _close_line(link.line), timeout=0.5)


def _close_line(line: ServoLink) -> None:
    with contextlib.suppress(OSError):
        line.close()


_LOOK: Final = f"read {HARDWARE_ERROR}"


def _plain(handler: Any, result: int) -> str:
    return str(handler.getTxRxResult(result)).rpartition("] ")[2] or f"error {result}"


class _SdkPort:
    """The SDK's ``PortHandler``, with a line that waits instead of spinning.

    The SDK's own reads nothing again and again until its time, which is wall time, has
    passed; and on a line that is never silent it reads for ever.
    """

    def __init__(self, line: ServoLink, baudrate: int) -> None:
        self.line = line
        self.is_using = False
        self._baudrate = baudrate
        self._end = 0.0

    def getBaudRate(self) -> int:  # noqa: N802 - the SDK's names
        return self._baudrate

    def clearPort(self) -> None:  # noqa: N802
        self.line.discard()

    def writePort(self, packet: list[int]) -> int:  # noqa: N802
        self.line.write(bytes(packet), ANSWER_TIMEOUT)
        self._end = time.monotonic() + ANSWER_TIMEOUT
        return len(packet)

    def readPort(self, length: int) -> bytes:  # noqa: N802
        left = self._end - time.monotonic()
        return self.line.read(length, left) if left > 0 else b""

    def setPacketTimeout(self, packet_length: int) -> None:  # noqa: N802
        """Keep the deadline, which began with the request."""

    def setPacketTimeoutMillis(self, msec: float) -> None:  # noqa: N802
        """Keep the deadline, which began with the request."""

    def isPacketTimeout(self) -> bool:  # noqa: N802
        return time.monotonic() >= self._end


class _PortLink:
    """An open port, for a thread that may wait."""

    def __init__(self, fd: int) -> None:
        self._fd = fd

    def write(self, data: bytes, seconds: float) -> None:
        end = time.monotonic() + seconds
        while data:
            self._wait(select.POLLOUT, end - time.monotonic())
            with contextlib.suppress(BlockingIOError):
                data = data[os.write(self._fd, data) :]
            if data and time.monotonic() > end:
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
        """Leave it to the port."""

    def _wait(self, event: int, seconds: float) -> bool:
        poll = select.poll()
        poll.register(self._fd, event)
        found = poll.poll(max(0.0, seconds) * 1000)
        if found and found[0][1] & (select.POLLHUP | select.POLLERR | select.POLLNVAL):
            raise OSError(errno.EIO, "the other end hung up")
        return bool(found)
