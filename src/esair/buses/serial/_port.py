"""The port of a serial line: where it is, who has it, how it is opened.

The only module that knows pyserial and pyserial-asyncio; both are imported when a port is
opened. All but `ThreadLink` and `link_of` blocks.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import fcntl
import functools
import math
import os
import re
import select
import stat
import termios
import time
from collections.abc import Callable, Hashable, Mapping
from pathlib import Path
from typing import Any

from esair.buses._bus import open_on, shut_on
from esair.buses.finding import parse_identity
from esair.buses.serial import _ports
from esair.buses.serial._line import SerialLink
from esair.exceptions import (
    ConfigError,
    DeviceLostError,
    DriverStuckError,
    describe,
)
from esair.loop import SAFE, Executor, spawn, urgency

_NUMBERED = re.compile(r"/dev/tty(USB|ACM)\d+\Z")


class SerialPlace:
    """Where a port is to be found: a device file, a USB device, or a URL of pyserial.

    Args:
        owner: The name of the bus, for errors.
        port: ``/dev/ttyUSB0``, ``usb:VID:PID[:SERIAL]`` or ``loop://``.

    Raises:
        ConfigError: It is none of them.
    """

    def __init__(self, owner: str, port: str) -> None:
        if not isinstance(port, str) or not port:
            raise ConfigError(
                owner,
                "port",
                "expected the path of a device file, usb:VID:PID[:SERIAL], or a URL "
                f"such as loop://, not {port!r:.80}",
            )
        self.is_usb: bool = port.startswith("usb:")
        if self.is_usb:
            parse_identity(port, component=owner, field="port")
        self.owner = owner
        self.port = port
        self.is_url: bool = "://" in port

    def find(self) -> str:
        """Return the path, or the URL, to open. Blocks.

        Raises:
            ConnectionError: The USB device is not there.
        """
        if not self.is_usb:
            return self.port
        return _ports.find_port(self.port)

    def look(self) -> Hashable | None:
        """Return what is at the place now; None if nothing is. Blocks.

        Another value means that something was plugged in since.
        """
        try:
            path = self.find()
            found = os.stat(path)
        except OSError:
            return None
        return path, found.st_rdev, found.st_ino, found.st_ctime_ns

    def check(self, path: str, fd: int) -> None:
        """Make sure that an open descriptor is of the device that is meant. Blocks.

        Raises:
            ConnectionError: Another device was plugged in while it was opened.
        """
        if not self.is_usb:
            return
        try:
            # Not its path: udev may have made a better name for it meanwhile.
            same = os.stat(self.find()).st_rdev == os.fstat(fd).st_rdev
        except OSError:
            same = False
        if not same:
            raise ConnectionError(f"{path} is no longer {self.port}")

    def advice(self, path: str) -> str:
        """Say how to name a port whose number is chance; empty if it is none. Blocks."""
        if self.is_usb or not _NUMBERED.match(path):
            return ""
        identity = _ports.serial_identity(path)
        better = f"now it is {identity!r}" if identity else "see /dev/serial/by-path"
        return f"{path} is another device after the next start, perhaps: {better}"


_TAKEN = frozenset({errno.EAGAIN, errno.EBUSY})
"""What the kernel says about a port that somebody else has."""


def explain(path: str, error: BaseException) -> str:
    """Say why a port cannot be opened, and whose it is if somebody has it."""
    code = getattr(error, "errno", None)
    if code in _TAKEN:
        return f"{path} belongs to {_owner(path)}: a port has one user"
    if code == errno.EACCES:
        with contextlib.suppress(OSError, KeyError):
            return f"{path} may be opened by the group {Path(path).group()!r} only"
    why = os.strerror(code) if isinstance(code, int) else describe(error)
    return f"{path} cannot be opened: {why}"


def _owner(path: str) -> str:
    """Name the process that has a port open, as far as this user may know."""
    try:
        pid = _lock_holder(wanted := os.stat(path)) or _opener(wanted)
    except OSError:
        return "somebody else"
    if pid is None:
        return "another process"
    if pid == os.getpid():
        return f"this process ({pid}) already"
    with contextlib.suppress(OSError):
        return f"process {pid} ({Path(f'/proc/{pid}/comm').read_text().strip()})"
    return f"process {pid}"


def _lock_holder(wanted: os.stat_result) -> int | None:
    node = (
        f"{os.major(wanted.st_dev):02x}:{os.minor(wanted.st_dev):02x}:{wanted.st_ino}"
    )
    # A line: number, FLOCK, ADVISORY, WRITE, pid, device and inode, 0, EOF.
    with contextlib.suppress(OSError):
        for line in Path("/proc/locks").read_text().splitlines():
            fields = line.split()
            if fields[1] == "FLOCK" and fields[5] == node and int(fields[4]) > 0:
                return int(fields[4])
    return None


def _opener(wanted: os.stat_result) -> int | None:
    for link in Path("/proc").glob("[0-9]*/fd/*"):
        with contextlib.suppress(OSError):  # another user's, or closed meanwhile
            found = link.stat()
            if found.st_rdev == wanted.st_rdev and stat.S_ISCHR(found.st_mode):
                return int(link.parts[2])
    return None


READ_PERIOD = 0.1
"""How long a thread waits for bytes before it looks whether it is needed, in s."""

PIECE = 256
"""How many bytes are given to the line at once; what waits can be thrown away."""


class ThreadLink:
    """Two threads that read and write, for a port that the loop cannot wait for.

    The methods are those of a transport: nothing waits, and bytes that the line has
    not taken can be thrown away, except the piece that is being written.
    """

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        protocol: asyncio.Protocol,
        device: Any,
        *,
        name: str,
    ) -> None:
        self._loop = loop
        self._protocol = protocol
        self._device = device
        self._in = Executor(f"{name}-in")
        self._out = Executor(f"{name}-out")
        self._buffer = bytearray()
        self._in_flight = 0
        self._closing = False
        self._name = name
        self._reading = spawn(loop, self._read(), name=f"{name} in")
        self._writing: asyncio.Task[None] | None = None

    def write(self, data: bytes) -> None:
        """Take bytes and send them when the line takes them."""
        if self._closing:
            return
        self._buffer += data
        if self._writing is None:
            self._writing = spawn(self._loop, self._write(), name=f"{self._name} out")

    def get_write_buffer_size(self) -> int:
        """Return how many bytes the line has not taken yet."""
        return len(self._buffer) + self._in_flight

    def flush(self) -> None:
        """Throw the bytes away that are not being written."""
        self._buffer.clear()

    def is_closing(self) -> bool:
        """Return whether the line was let go."""
        return self._closing

    def abort(self) -> None:
        """Let the line go at once; the threads end as soon as the port lets them."""
        self._closing = True
        self._buffer.clear()
        self._reading.cancel()
        if self._writing is not None:
            self._writing.cancel()
        self._in.close()
        self._out.close()

    async def _read(self) -> None:
        with self._telling():
            while True:
                data = await self._in.call(self._take, timeout=math.inf)
                if data:
                    self._protocol.data_received(data)

    async def _write(self) -> None:
        with self._telling():
            while self._buffer:
                piece = bytes(self._buffer[:PIECE])
                del self._buffer[:PIECE]
                self._in_flight = len(piece)
                await self._out.call(self._device.write, piece, timeout=math.inf)
                self._in_flight = 0
            self._writing = None
            self._protocol.resume_writing()

    def _take(self) -> bytes:
        device = self._device
        first: bytes = device.read(1)
        waiting = min(device.in_waiting, 4096) if first else 0
        return first + device.read(waiting) if waiting else first

    @contextlib.contextmanager
    def _telling(self) -> Any:
        """Tell the protocol of an error of the port."""
        try:
            yield
        except Exception as error:  # pyserial raises SerialException, TypeError, ...
            if not self._closing:
                self._protocol.connection_lost(error)


OPEN_TIMEOUT = 2.0
"""How long opening a port may take, in seconds."""

KERNEL_HOLDS = 0.25
"""The kernel gets no message while it has bytes for so many seconds: what is safe would
come behind them, and nobody would notice a device that takes none."""

LOOK_AGAIN = 0.005
"""After which pause the kernel is asked again for room, in seconds."""

DRAIN_TIMEOUT = 0.2
"""How long a close waits for bytes that the kernel still holds, in seconds."""


class Port:
    """An open port as the transport sees it: pyserial's, but nothing in it waits.

    pyserial's own ``read`` uses select(), which fails from descriptor 1024 on; its
    ``write`` repeats EAGAIN without end, which stops the event loop (pyserial#280);
    its ``flush``, which the transport calls at its end, waits for a device that may
    never take another byte.

    Args:
        device: The open ``serial.Serial``.
        path: What was opened.

    Attributes:
        advice: How to name it better; empty if its name is as good as any.
    """

    advice = ""
    timeout: float | None = 0
    write_timeout: float | None = 0

    def __init__(self, device: Any, path: str) -> None:
        self.device = device
        self.path = path
        self.failed: Callable[[Exception | None], None] = lambda _error: None
        self._fd = -1
        with contextlib.suppress(OSError, AttributeError):  # loop://, rfc2217://
            self._fd = int(device.fileno())
        self._is_terminal = self._fd >= 0 and os.isatty(self._fd)
        self._open = True
        if self._is_terminal:  # beside the lock, for programs that look for none
            with contextlib.suppress(OSError):
                fcntl.ioctl(self._fd, termios.TIOCEXCL)

    @property
    def has_descriptor(self) -> bool:
        """Whether the event loop can wait for it."""
        return self._fd >= 0

    def fileno(self) -> int:
        """Return the descriptor."""
        return self._fd

    def read(self, size: int = 1) -> bytes:
        """Return what is there, at most *size* bytes."""
        try:
            data = os.read(self._fd, size)
        except (BlockingIOError, InterruptedError):
            return b""
        except OSError as error:
            self._fail(error)
            return b""
        if not data and self._hung_up():
            self._fail(None)
        return data

    def write(self, data: bytes) -> int:
        """Return how many bytes the kernel took; never waits."""
        try:
            return os.write(self._fd, data)
        except (BlockingIOError, InterruptedError):
            return 0
        except OSError as error:
            self._fail(error)
            return 0

    def has_room(self) -> bool:
        """Tell whether what the kernel has to send is on the wire soon."""
        if not self._is_terminal:
            return True
        try:
            held = float(self.device.out_waiting)
        except (OSError, termios.error):
            return True  # the write tells why
        return 10 * held <= float(self.device.baudrate) * KERNEL_HOLDS

    def flush(self) -> None:
        """Do not wait: `shut` does it, in a thread and for a limited time."""

    def throw_away(self, most: int) -> int:
        """Throw away what the kernel has taken and not sent, unless that is too much.

        Returns how many bytes were thrown away.
        """
        if self._is_terminal:
            with contextlib.suppress(OSError, termios.error):
                held = int(self.device.out_waiting)
                if 0 < held <= most:
                    self.device.reset_output_buffer()
                    return held
        return 0

    def close(self) -> None:
        """Leave the closing, which can block, to `shut`."""

    def shut(self) -> None:
        """Give the kernel a moment for what it holds, throw away the rest, close."""
        if not self._open:
            return
        self._open = False
        give_up = time.monotonic() + DRAIN_TIMEOUT
        with contextlib.suppress(Exception):  # termios.error of a device that is gone
            while self.device.out_waiting and self._is_terminal:
                if time.monotonic() > give_up:
                    self.device.reset_output_buffer()
                    break
                time.sleep(0.005)
        if self._is_terminal:
            with contextlib.suppress(OSError):
                fcntl.ioctl(self._fd, termios.TIOCNXCL)
        # pyserial forgets to close a socket whose other end has gone.
        socket = getattr(self.device, "_socket", None)
        with contextlib.suppress(OSError):
            self.device.close()
        if socket is not None:
            socket.close()

    def _fail(self, error: Exception | None) -> None:
        # Later: in the middle of its own work the transport cannot be aborted.
        asyncio.get_running_loop().call_soon(self.failed, error)

    def _hung_up(self) -> bool:
        """Tell the end of the line from nothing to read, which are alike for a tty."""
        if stat.S_ISSOCK(os.fstat(self._fd).st_mode):
            return True
        poll = select.poll()
        poll.register(self._fd, 0)  # hang-up and error are told unasked
        return bool(poll.poll(0))


def open_port(
    place: SerialPlace,
    baudrate: int,
    options: Mapping[str, Any],
    levels: Mapping[str, bool],
) -> Port:
    """Open a port, exclusively. Blocks."""
    import serial

    path = place.port
    try:
        path = place.find()
        own: dict[str, Any] = {"timeout": READ_PERIOD}
        if not place.is_url:
            own = {"timeout": 0, "write_timeout": 0, "exclusive": True}
        device: Any = serial.serial_for_url(
            path, baudrate, do_not_open=True, **own, **options
        )
        for name, level in levels.items():
            setattr(device, name, level)
        device.open()
        port = Port(device, path)
        try:
            if port.has_descriptor:
                place.check(path, port.fileno())
                port.advice = place.advice(path)
        except BaseException:
            port.shut()
            raise
    except ConfigError:
        raise
    except (OSError, termios.error) as error:
        raise DeviceLostError(place.owner, explain(path, error)) from error
    except (ValueError, TypeError, LookupError) as error:  # its own word for no
        raise ConfigError(place.owner, "port", f"{path}: {error}") from error
    return port


async def reach_port(
    executor: Executor,
    place: SerialPlace,
    baudrate: int,
    options: Mapping[str, Any],
    levels: Mapping[str, bool],
) -> Port:
    """Open a port on the thread of a bus; what is opened late is closed at once.

    Errors are those of `open_port`; one that takes too long is a `DeviceLostError`.
    """
    try:
        return await open_on(
            executor,
            functools.partial(open_port, place, baudrate, options, levels),
            Port.shut,
            timeout=OPEN_TIMEOUT,
        )
    except DriverStuckError as error:
        raise DeviceLostError(executor.name, describe(error)) from error


def link_of(port: Port, protocol: asyncio.Protocol, name: str) -> SerialLink:
    """Hand an open port to the event loop."""
    port.failed = protocol.connection_lost
    loop = asyncio.get_running_loop()
    if port.has_descriptor:
        link = _transport_class()(loop, protocol, port)
        link.set_write_buffer_limits(high=0)
        told: SerialLink = link
        return told
    return ThreadLink(loop, protocol, port.device, name=name)


async def close_port(port: Port, executor: Executor) -> None:
    """Close a port in a thread; one that is stuck there is left to it."""
    await shut_on(executor, port.shut, timeout=DRAIN_TIMEOUT + 0.5)


@functools.cache
def _transport_class() -> Any:
    import serial_asyncio

    class DirectTransport(serial_asyncio.SerialTransport):  # type: ignore[misc]
        """Sends in the caller's own step what the kernel takes at once."""

        _rushes = False
        """Whether what is safe waits: only in the kernel is it not thrown away."""

        def write(self, data: bytes) -> None:
            idle = not self._closing and not self._write_buffer
            is_safe = urgency.get().level >= SAFE
            self._rushes = is_safe or (self._rushes and not idle)
            if idle and (is_safe or self._serial.has_room()):
                data = data[self._serial.write(data) :]
            if data:
                super().write(data)
                if is_safe:
                    self._look_again()

        def _write_ready(self) -> None:
            if not self._rushes and not self._serial.has_room():
                self._remove_writer()
                self._loop.call_later(LOOK_AGAIN, self._look_again)
                return
            waiting = self._write_buffer
            waiting[0] = waiting[0][self._serial.write(waiting[0]) :]
            if not waiting[0]:
                del waiting[0]
            if not waiting:
                self._remove_writer()
                self._maybe_resume_protocol()

        def _look_again(self) -> None:
            if self._write_buffer:
                self._ensure_writer()

    return DirectTransport
