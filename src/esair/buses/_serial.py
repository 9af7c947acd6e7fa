"""Serial lines. The only module that knows pyserial and pyserial-asyncio."""

from __future__ import annotations

import asyncio
import contextlib
import os
import select
import threading
import time
from collections.abc import Awaitable, Callable
from typing import Any, Protocol

from esair.buses._bus import Bus
from esair.buses._inbox import Inbox, within
from esair.exceptions import (
    BusyError,
    ConfigError,
    DeviceLostError,
    DriverStuckError,
    describe,
)

OPEN_TIMEOUT = 2.0
"""How long opening a port may take, in seconds."""

DRAIN_TIMEOUT = 0.2
"""How long a close waits for bytes that the kernel still holds, in seconds."""


class SerialLink(Protocol):
    """One end of a serial line; pyserial-asyncio's transport is one."""

    def write(self, data: bytes) -> None:
        """Take bytes and send them when the line takes them; never waits."""

    def get_write_buffer_size(self) -> int:
        """Return how many bytes the line has not taken yet."""

    def set_write_buffer_limits(
        self, high: int | None = None, low: int | None = None
    ) -> None:
        """Say above and below how many bytes the protocol is told."""

    def flush(self) -> None:
        """Throw the bytes away that the line has not taken yet."""

    def is_closing(self) -> bool:
        """Return whether the line was let go."""

    def abort(self) -> None:
        """Let the line go at once; what it has not taken is thrown away."""


SerialOpener = Callable[[asyncio.Protocol], Awaitable[SerialLink]]


class SerialBus(Bus):
    """A serial line, and the lines of text or frames on it.

    Several devices may share it: each listens with a prefix of its own and writes
    whole messages, which are never mixed. Nothing here ever blocks the event loop:
    the port is opened and closed on the bus's thread, exclusively, and a device that
    stops taking bytes costs the writer its deadline and nobody else anything.

    Args:
        name: The name of the bus.
        port: The device file, such as ``/dev/ttyUSB0``.
        baudrate: Bits per second.
        delimiter: What ends a message on the line.
        max_line: The longest message in bytes; a longer one is thrown away.
        out_limit: How many bytes may wait to be sent; more is refused.
        write_timeout: How long a write may take unless it says otherwise, in s.
        opener: Opens something else than a port, such as a wire in memory.
        **options: Further settings of ``serial.Serial``, such as ``parity="E"``.

    Attributes:
        overlong: How many bytes were thrown away because no delimiter came.
        unheard: How many messages nobody listened to.
        discarded: How many bytes were thrown away because a write took too long.
        refused: How many writes were refused because too many bytes waited.
    """

    def __init__(
        self,
        *,
        name: str,
        port: str = "",
        baudrate: int = 115200,
        delimiter: bytes = b"\n",
        max_line: int = 4096,
        out_limit: int = 4096,
        write_timeout: float = 0.5,
        opener: SerialOpener | None = None,
        **options: Any,
    ) -> None:
        super().__init__(name=name)
        if not port and opener is None:
            raise ConfigError(name, "port", "expected the path of a device file")
        if "://" in port or port.startswith("usb:"):
            raise ConfigError(
                name, "port", f"expected the path of a device file, not {port!r:.80}"
            )
        if type(baudrate) is not int or baudrate < 1:
            raise ConfigError(
                name, "baudrate", f"expected bits per second, not {baudrate!r:.80}"
            )
        if not delimiter:
            raise ConfigError(name, "delimiter", "expected at least one byte")
        self.port = port
        self.baudrate = baudrate
        self.delimiter = delimiter
        self.max_line = max_line
        self.out_limit = out_limit
        self.write_timeout = write_timeout
        self.overlong = 0
        self.unheard = 0
        self.discarded = 0
        self.refused = 0
        self._options = options
        self._opener = opener or self._open_port
        self._line: _Line | None = None
        self._inboxes: list[tuple[bytes, Inbox[bytes]]] = []

    def lines(self, prefix: bytes = b"", *, limit: int = 64) -> Inbox[bytes]:
        """Listen to the messages that begin with a prefix, without their delimiter.

        Args:
            prefix: What they begin with; every message if empty.
            limit: How many are kept until they are taken; then the newest win.

        Raises:
            DeviceLostError: The bus is not open.
        """
        self._connected()
        inbox: Inbox[bytes] = Inbox(limit, self._forget)
        self._inboxes = [*self._inboxes, (prefix, inbox)]
        return inbox

    async def write(self, data: bytes, *, timeout: float | None = None) -> None:
        """Send bytes in one piece and wait until the kernel has taken them.

        Args:
            data: A whole message.
            timeout: How long to wait, in seconds; ``write_timeout`` if None.

        Raises:
            DeviceLostError: The line is gone. Nobody knows how much was sent.
            BusyError: Too many bytes wait already; nothing was sent.
            DriverStuckError: The device took no bytes in time. All bytes that
                waited are thrown away, so that none of them comes late.
        """
        line = self._connected()
        link = line.link
        if link.get_write_buffer_size() + len(data) > self.out_limit:
            self.refused += 1
            raise BusyError(
                f"bus {self.name}", "number of bytes to send", self.out_limit
            )
        link.write(data)
        if not link.get_write_buffer_size():
            return
        seconds = self.write_timeout if timeout is None else timeout
        sent: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        line.writers.append(sent)
        try:
            await within(sent, seconds)
        except TimeoutError:
            stuck = DriverStuckError(self.name, "write", seconds)
            self.discarded += link.get_write_buffer_size()
            link.flush()
            line.settle(stuck)
            raise stuck from None
        finally:
            if sent in line.writers:
                line.writers.remove(sent)

    def _connected(self) -> _Line:
        if not self.is_open or self._line is None:
            raise DeviceLostError(self.name, "the line is not open")
        return self._line

    def _forget(self, inbox: Inbox[bytes]) -> None:
        self._inboxes = [entry for entry in self._inboxes if entry[1] is not inbox]

    async def _open(self) -> None:
        await self._close()  # what a loss has left behind
        line = _Line(self, self._received, self._gone)
        line.link = await self._opener(line)
        line.link.set_write_buffer_limits(high=0)
        self._line = line

    async def _close(self) -> None:
        line, self._line = self._line, None
        inboxes, self._inboxes = self._inboxes, []
        gone = DeviceLostError(self.name, "the line was closed")
        for _, inbox in inboxes:
            inbox.fail(gone)
        if line is None:
            return
        line.bus = None
        line.settle(gone)
        if not line.link.is_closing():  # first, so that nobody watches the descriptor
            line.link.abort()
        port = getattr(line.link, "port", None)
        if port is not None:
            with contextlib.suppress(DriverStuckError, BusyError):
                await self.lane.call(port.shut, timeout=DRAIN_TIMEOUT + 0.3)

    async def _open_port(self, protocol: asyncio.Protocol) -> SerialLink:
        attempt = _Attempt(self.port, self.baudrate, self._options)
        try:
            port = await self.lane.call(attempt.open, timeout=OPEN_TIMEOUT)
        except OSError as error:
            if isinstance(error, DriverStuckError):
                attempt.abandon()
            detail = f"{self.port} cannot be opened: {describe(error)}"
            raise DeviceLostError(self.name, detail) from error
        except BaseException:
            attempt.abandon()
            raise
        import serial_asyncio

        line = protocol
        assert isinstance(line, _Line)
        port.failed = line.connection_lost
        transport = serial_asyncio.SerialTransport(
            asyncio.get_running_loop(), protocol, port
        )
        transport.port = port
        link: SerialLink = transport
        return link

    def _received(self, message: bytes) -> None:
        heard = False
        for prefix, inbox in self._inboxes:
            if message.startswith(prefix):
                inbox.offer(message)
                heard = True
        if not heard:
            self.unheard += 1

    def _gone(self, line: _Line, error: Exception | None) -> None:
        line.bus = None
        if line is not self._line:
            return
        detail = describe(error) if error is not None else "the other end hung up"
        loss = DeviceLostError(self.name, detail)
        loss.__cause__ = error
        line.settle(loss)
        if not line.link.is_closing():
            line.link.abort()
        inboxes, self._inboxes = self._inboxes, []
        for _, inbox in inboxes:
            inbox.fail(loss)
        self.lost(loss)


class _Line(asyncio.Protocol):
    """One opening of the line: cuts bytes into messages and knows who waits."""

    link: SerialLink

    def __init__(
        self,
        bus: SerialBus,
        received: Callable[[bytes], None],
        gone: Callable[[_Line, Exception | None], None],
    ) -> None:
        self.bus: SerialBus | None = bus
        self._received = received
        self._gone = gone
        self.writers: list[asyncio.Future[None]] = []
        self._buffer = bytearray()
        self._skipping = False

    def data_received(self, data: bytes) -> None:
        bus = self.bus
        if bus is None:
            return
        buffer = self._buffer
        buffer += data
        begin = 0
        while (end := buffer.find(bus.delimiter, begin)) >= 0:
            if self._skipping:
                bus.overlong += end - begin
                self._skipping = False
            elif end - begin > bus.max_line:
                bus.overlong += end - begin
            else:
                self._received(bytes(buffer[begin:end]))
            begin = end + len(bus.delimiter)
        del buffer[:begin]
        if len(buffer) > bus.max_line:  # the end of an endless message may be cut
            keep = len(bus.delimiter) - 1
            bus.overlong += len(buffer) - keep
            del buffer[: len(buffer) - keep]
            self._skipping = True

    def resume_writing(self) -> None:
        self.settle(None)

    def connection_lost(self, exc: Exception | None) -> None:
        if self.bus is not None:
            self._gone(self, exc)

    def settle(self, error: BaseException | None) -> None:
        """Tell all writers that wait how it ended."""
        writers, self.writers = self.writers, []
        for writer in writers:
            if writer.done():
                continue
            if error is None:
                writer.set_result(None)
            else:
                writer.set_exception(error)


class _Attempt:
    """One attempt to open a port, in a thread that nobody may wait for any more."""

    def __init__(self, path: str, baudrate: int, options: dict[str, Any]) -> None:
        self._path = path
        self._baudrate = baudrate
        self._options = options
        self._lock = threading.Lock()
        self._abandoned = False
        self._port: _Port | None = None

    def open(self) -> _Port:
        import serial

        device = serial.Serial(
            self._path,
            self._baudrate,
            timeout=0,
            write_timeout=0,
            exclusive=True,
            **self._options,
        )
        with self._lock:
            self._port = _Port(device)
            if self._abandoned:
                self._port.shut()
            return self._port

    def abandon(self) -> None:
        """Close the port as soon as it is open: nobody will use it."""
        with self._lock:
            self._abandoned = True
            if self._port is not None:
                self._port.shut()


class _Port:
    """The port as the transport sees it: pyserial's, but nothing in it waits.

    pyserial's own ``read`` uses select(), which fails from descriptor 1024 on; its
    ``write`` repeats EAGAIN without end, which stops the event loop (pyserial#280);
    its ``flush``, which the transport calls at its end, waits for a device that may
    never take another byte.
    """

    timeout: float | None = 0
    write_timeout: float | None = 0

    def __init__(self, device: Any) -> None:
        self._device = device
        self._fd: int = device.fileno()
        self.failed: Callable[[Exception | None], None] = lambda _error: None

    def fileno(self) -> int:
        return self._fd

    def read(self, size: int = 1) -> bytes:
        try:
            data = os.read(self._fd, size)
        except (BlockingIOError, InterruptedError):
            return b""
        except OSError as error:
            self._fail(error)
            return b""
        if not data and _hung_up(self._fd):
            self._fail(None)
        return data

    def write(self, data: bytes) -> int:
        try:
            return os.write(self._fd, data)
        except (BlockingIOError, InterruptedError):
            return 0
        except OSError as error:
            self._fail(error)
            return 0

    def _fail(self, error: Exception | None) -> None:
        # Later: in the middle of its own work the transport cannot be aborted.
        asyncio.get_running_loop().call_soon(self.failed, error)

    def flush(self) -> None:
        """Do not wait: `shut` does it, in a thread and for a limited time."""

    def close(self) -> None:
        """Leave the closing, which can block, to `shut`."""

    def shut(self) -> None:
        """Give the kernel a moment for what it holds, throw away the rest, close."""
        give_up = time.monotonic() + DRAIN_TIMEOUT
        with contextlib.suppress(Exception):  # termios.error of a device that is gone
            while self._device.out_waiting:
                if time.monotonic() > give_up:
                    self._device.reset_output_buffer()
                    break
                time.sleep(0.005)
        with contextlib.suppress(OSError):
            self._device.close()


def _hung_up(fd: int) -> bool:
    poll = select.poll()
    poll.register(fd, select.POLLIN)
    return bool(poll.poll(0))
