"""The ports of serial lines. The only module that knows pyserial and pyserial-asyncio."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import fcntl
import functools
import os
import re
import select
import stat
import termios
import threading
import time
from collections.abc import Callable, Hashable
from pathlib import Path
from typing import Any

from esair.buses._serial_line import SerialLink
from esair.buses._serial_threads import READ_PERIOD, ThreadLink
from esair.exceptions import (
    BusyError,
    ConfigError,
    DeviceLostError,
    DriverStuckError,
    describe,
)
from esair.loop import Lane

OPEN_TIMEOUT = 2.0
"""How long opening a port may take, in seconds."""

DRAIN_TIMEOUT = 0.2
"""How long a close waits for bytes that the kernel still holds, in seconds."""

_TAKEN = frozenset({errno.EAGAIN, errno.EBUSY})
"""What the kernel says about a port that somebody else has."""

_NUMBERED = re.compile(r"/dev/tty(USB|ACM)\d+\Z")

_USB = re.compile(r"usb:[0-9A-Fa-f]{4}:[0-9A-Fa-f]{4}(:.+)?\Z")


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
        if port.startswith("usb:") and not _USB.match(port):
            raise ConfigError(
                owner,
                "port",
                "expected usb:VID:PID or usb:VID:PID:SERIAL, both numbers with four "
                f"hexadecimal digits, not {port!r:.80}",
            )
        self.owner = owner
        self.port = port
        self.is_usb = port.startswith("usb:")
        self.is_url = "://" in port

    def find(self) -> str:
        """Return the path, or the URL, to open. Blocks.

        Raises:
            ConnectionError: The USB device is not there.
        """
        if not self.is_usb:
            return self.port
        from esair import discovery

        return discovery.find_port(self.port)

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
            same = self.find() == path and os.stat(path).st_rdev == os.fstat(fd).st_rdev
        except OSError:
            same = False
        if not same:
            raise ConnectionError(f"{path} is no longer {self.port}")

    def advice(self, path: str) -> str:
        """Say how to name a port whose number is chance; empty if it is none. Blocks."""
        if self.is_usb or not _NUMBERED.match(path):
            return ""
        from esair import discovery

        identity = discovery.serial_identity(path)
        better = f"now it is {identity!r}" if identity else "see /dev/serial/by-path"
        return f"{path} is another device after the next start, perhaps: {better}"


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
        self._fd = _descriptor(device)
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

    def flush(self) -> None:
        """Do not wait: `shut` does it, in a thread and for a limited time."""

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
        with contextlib.suppress(OSError):
            self.device.close()

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


class Opening:
    """One attempt to open a port, in a thread that nobody may wait for any more.

    Args:
        place: Where the port is.
        baudrate: Bits per second.
        options: Further settings of ``serial.Serial``.
    """

    def __init__(
        self, place: SerialPlace, baudrate: int, options: dict[str, Any]
    ) -> None:
        self._place = place
        self._baudrate = baudrate
        self._options = options
        self._lock = threading.Lock()
        self._abandoned = False
        self._port: Port | None = None

    def open(self) -> Port:
        """Open the port, exclusively. Blocks.

        Raises:
            DeviceLostError: It is not there, or belongs to somebody else.
            ConfigError: Its driver does not know the settings.
        """
        place = self._place
        path = place.port
        try:
            path = place.find()
            port = Port(self._open_device(path), path)
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
            raise DeviceLostError(place.owner, _explain(path, error)) from error
        except (ValueError, TypeError, LookupError) as error:  # its own word for no
            raise ConfigError(place.owner, "port", f"{path}: {error}") from error
        with self._lock:
            self._port = port
            if self._abandoned:
                port.shut()
            return port

    def abandon(self) -> None:
        """Close the port as soon as it is open: nobody will use it."""
        with self._lock:
            self._abandoned = True
            if self._port is not None:  # closing can block whoever does it
                threading.Thread(target=self._port.shut, daemon=True).start()

    def _open_device(self, path: str) -> Any:
        import serial

        if self._place.is_url:
            return serial.serial_for_url(
                path, self._baudrate, timeout=READ_PERIOD, **self._options
            )
        return serial.Serial(
            path,
            self._baudrate,
            timeout=0,
            write_timeout=0,
            exclusive=True,
            **self._options,
        )


async def open_link(
    opening: Opening, protocol: asyncio.Protocol, lane: Lane
) -> tuple[SerialLink, Port]:
    """Open a port in a thread and hand it to the event loop.

    Args:
        opening: The attempt.
        protocol: Is told what comes.
        lane: The thread of the bus.

    Raises:
        DeviceLostError: It is not there, belongs to somebody else, or the opening
            took too long; what is opened late is closed at once.
        ConfigError: Its driver does not know the settings.
    """
    try:
        port = await lane.call(opening.open, timeout=OPEN_TIMEOUT)
    except DriverStuckError as error:
        opening.abandon()
        raise DeviceLostError(lane.name, describe(error)) from error
    except BaseException:
        opening.abandon()
        raise
    port.failed = protocol.connection_lost
    loop = asyncio.get_running_loop()
    if port.has_descriptor:
        transport = _transport_class()(loop, protocol, port)
        return transport, port
    return ThreadLink(loop, protocol, port.device, name=lane.name), port


async def close_port(port: Port, lane: Lane) -> None:
    """Close a port in a thread; one that is stuck there is left to it."""
    with contextlib.suppress(DriverStuckError, BusyError):
        await lane.call(port.shut, timeout=DRAIN_TIMEOUT + 0.5)


@functools.cache
def _transport_class() -> Any:
    import serial_asyncio

    class DirectTransport(serial_asyncio.SerialTransport):  # type: ignore[misc]
        """Sends in the caller's own step what the kernel takes at once."""

        def write(self, data: bytes) -> None:
            if not self._closing and not self._write_buffer:
                data = data[self._serial.write(data) :]
            if data:
                super().write(data)

    return DirectTransport


def _descriptor(device: Any) -> int:
    try:
        return int(device.fileno())
    except (OSError, AttributeError):  # loop://, rfc2217://
        return -1


def _explain(path: str, error: BaseException) -> str:
    code = getattr(error, "errno", None)
    if code in _TAKEN:
        return f"{path} belongs to {_owner(path)}: a port has one user"
    if code == errno.EACCES:
        with contextlib.suppress(OSError, KeyError):
            return f"{path} may be opened by the group {Path(path).group()!r} only"
    return f"{path} cannot be opened: {describe(error)}"


def _owner(path: str) -> str:
    """Name the process that has a port open, as far as this user may know."""
    try:
        wanted = os.stat(path)
    except OSError:
        return "somebody else"
    pid = _lock_holder(wanted) or _opener(wanted)
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
