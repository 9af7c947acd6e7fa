"""How things that are plugged in are found: what the media share.

Nothing here opens a device. What is found of one medium is in the folder of the medium;
all of it together is `esair.discovery`.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import re
import select
import threading
from collections.abc import Callable, Hashable, Sequence
from pathlib import Path
from typing import Any, Self

import attrs

from esair.exceptions import ConfigError

__all__ = [
    "ROOT",
    "Device",
    "UsbIdentity",
    "Wakes",
    "entries",
    "identity_of",
    "parse_identity",
    "permission",
    "pick",
    "quoted",
    "read",
    "usb_device",
    "watch",
    "who_may",
    "words_of",
]

ROOT = Path("/")
"""Where ``/sys`` and ``/dev`` are."""

LONGEST = 120
"""How much of a text is taken, in characters."""


def read(path: Path, longest: int = LONGEST) -> str:
    """Return a text in one line without control characters; empty if there is none.

    A device chooses its own strings; none of them may move the cursor of a terminal.
    """
    try:
        text = path.read_bytes().decode("utf-8", errors="replace").strip()
    except OSError:
        return ""
    return "".join(
        each if each.isprintable() and each != "\N{REPLACEMENT CHARACTER}" else "?"
        for each in text[:longest]
    )


def entries(directory: Path) -> list[Path]:
    """Return what a directory has, by name and number; nothing if it is not there."""
    try:
        found = list(directory.iterdir())
    except OSError:
        return []
    return sorted(found, key=_natural)


def _natural(path: Path) -> tuple[str, int]:  # ttyUSB10 is behind ttyUSB9
    letters = path.name.rstrip("0123456789")
    return letters, int(path.name[len(letters) :] or -1)


SUBSYSTEMS = ("tty", "net", "i2c-dev", "gpio", "spidev", "input", "video4linux")
"""What the events that wake are about."""

_UDEVD = Path("/run/udev/control")


class Wakes:
    """Sleeps until udev has news, somebody wakes it, or a time has passed.

    Events need pyudev (the extra ``hotplug``) and are a favor: without them, in a
    container or on another system, only the time counts.
    """

    def __init__(self) -> None:
        self._read, self._write = os.pipe()
        os.set_blocking(self._read, False)
        os.set_blocking(self._write, False)
        self._monitor: Any = None
        self._poll = select.poll()
        self._poll.register(self._read, select.POLLIN)

    @property
    def has_events(self) -> bool:
        """Whether udev is listened to."""
        return self._monitor is not None

    def listen(self) -> None:
        """Begin to listen to udev, if that is possible. Blocks for a moment."""
        with contextlib.suppress(Exception):  # no pyudev, no libudev, no netlink, ...
            import pyudev

            # The kernel's own events reach a container; udev's do not, but come
            # when links are made and permissions given.
            source = "udev" if _UDEVD.exists() else "kernel"
            monitor = pyudev.Monitor.from_netlink(pyudev.Context(), source=source)
            for subsystem in SUBSYSTEMS:
                monitor.filter_by(subsystem)
            monitor.start()
            self._poll.register(monitor.fileno(), select.POLLIN)
            self._monitor = monitor

    def wait(self, seconds: float) -> None:
        """Sleep; events that come together count as one."""
        for fd, events in self._poll.poll(max(0.0, seconds) * 1000):
            if fd == self._read:
                with contextlib.suppress(BlockingIOError):
                    os.read(fd, 4096)
            elif events & ~select.POLLIN:
                self._deafen(fd)
            else:
                self._drain(fd)

    def wake(self) -> None:
        """Wake the sleeper, from any thread."""
        with contextlib.suppress(BlockingIOError):
            os.write(self._write, b"!")

    def close(self) -> None:
        """Give the descriptors back; nothing else may be called any more."""
        self._monitor = None
        os.close(self._read)
        os.close(self._write)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _drain(self, fd: int) -> None:
        try:
            while self._monitor.poll(0) is not None:
                pass
        except Exception:  # too many events at once, or libudev gave up
            self._deafen(fd)

    def _deafen(self, fd: int) -> None:
        """Never be woken again and again by a descriptor that is broken."""
        self._poll.unregister(fd)
        self._monitor = None


_FORM = re.compile(r"usb:([0-9A-Fa-f]{4}):([0-9A-Fa-f]{4})(?::(.+))?\Z")


@attrs.frozen
class UsbIdentity:
    """Who a USB device says it is.

    Attributes:
        vendor: Who made it, 0 to 0xFFFF.
        product: Which of the vendor's products it is, 0 to 0xFFFF.
        serial: Which piece of it; empty if it has no number, or any may be meant.
    """

    vendor: int
    product: int
    serial: str = ""

    def fits(self, other: UsbIdentity) -> bool:
        """Return whether another device is the one that is meant by this."""
        return (self.vendor, self.product) == (other.vendor, other.product) and (
            not self.serial or self.serial == other.serial
        )

    def __str__(self) -> str:
        text = f"usb:{self.vendor:04x}:{self.product:04x}"
        return f"{text}:{self.serial}" if self.serial else text


def parse_identity(
    text: str, *, component: str = "discovery", field: str = "identity"
) -> UsbIdentity:
    """Read ``usb:VID:PID`` or ``usb:VID:PID:SERIAL``.

    Raises:
        ConfigError: It is neither; told of a component and its field.
    """
    found = _FORM.match(text)
    if found is None:
        raise ConfigError(
            component,
            field,
            "expected usb:VID:PID or usb:VID:PID:SERIAL, both numbers with four "
            f"hexadecimal digits, not {text!r:.80}",
        )
    vendor, product, serial = found.groups()
    return UsbIdentity(int(vendor, 16), int(product, 16), serial or "")


def usb_device(place: Path, root: Path) -> Path | None:
    """Return the USB device that something in ``/sys`` is a part of.

    Args:
        place: The directory of the part; links are followed.
        root: Where ``/sys`` is; nothing above it is looked at.
    """
    top = (root / "sys").resolve()
    with contextlib.suppress(OSError):  # it is just being unplugged
        place = place.resolve()
    while place != top and top in place.parents:
        if (place / "idVendor").is_file():
            return place
        place = place.parent
    return None


def identity_of(device: Path | None) -> str | None:
    """Return ``usb:VID:PID[:SERIAL]`` of a USB device, by its directory in ``/sys``."""
    if device is None:
        return None
    try:
        vendor = int(read(device / "idVendor"), 16)
        product = int(read(device / "idProduct"), 16)
    except ValueError:  # it is just being unplugged
        return None
    serial = read(device / "serial")
    # A blank memory gives characters that are none, and no two devices differ.
    return str(UsbIdentity(vendor, product, serial if "?" not in serial else ""))


def words_of(device: Path) -> str:
    """Return what a USB device calls itself, with its maker's name once."""
    maker, product = read(device / "manufacturer"), read(device / "product")
    if product.startswith(maker):
        return product
    return f"{maker} {product}".strip()


_GROUP_MAY = 0o060
"""The group may read and write."""


@attrs.frozen
class Device:
    """One thing that is plugged in, as far as it can be known without opening it.

    Attributes:
        kind: The medium, such as ``"serial"`` or ``"can"``; or ``"gpio"``.
        path: Where it is now: a device file, or the name of a CAN interface.
        address: What a robot.toml calls it, so that it is found again after it was
            plugged in elsewhere; the path if nothing better is known.
        description: What it says about itself, in words.
        identity: ``usb:VID:PID`` or ``usb:VID:PID:SERIAL``; None if it is no USB device.
        by_id: Its link in ``/dev/serial/by-id``; None if it has none.
        state: What is known about its state, in words, such as ``"up, 500 kbit/s"`` or
            ``"no permission: join the group dialout"``.
        bitrate: Bits per second of a CAN interface; None if it is not known.
        lines: How many lines a GPIO chip has; None if it is not known.
    """

    kind: str
    path: str
    address: str
    description: str = ""
    identity: str | None = None
    by_id: str | None = None
    state: str = ""
    bitrate: int | None = None
    lines: int | None = None

    @property
    def key(self) -> tuple[str, str, str | None]:
        """What tells it from another device, and from itself elsewhere."""
        return self.kind, self.path, self.identity


def quoted(text: str) -> str:
    """Return a text as TOML writes it."""
    return json.dumps(text, ensure_ascii=False)


def permission(file: Path) -> str:
    """Return in words that this user may not open a device file; empty if he may."""
    if os.access(file, os.R_OK | os.W_OK):
        return ""
    try:
        state = file.stat()
    except OSError:  # it is just being unplugged
        return ""
    return who_may(state.st_mode, state.st_gid)


def who_may(mode: int, group: int) -> str:
    """Return in words who may open it, by its mode and its group's number."""
    if mode & _GROUP_MAY != _GROUP_MAY or group == 0:
        return "no permission"
    return f"no permission: join the group {_name(group)}"


def _name(group: int) -> str:
    try:
        import grp

        return grp.getgrgid(group).gr_name
    except (ImportError, KeyError):  # another system, or a group without a name
        return str(group)


def pick(wanted: str, there: Sequence[Device], noun: str) -> str:
    """Return the path of a device.

    Args:
        wanted: A path, ``usb:VID:PID[:SERIAL]``, the beginning of its name, or nothing
            for the only one that is there.
        there: Those that are there; nobody looks whether a path is one of theirs.
        noun: What they are called, for the error.

    Raises:
        FileNotFoundError: It is not there, or several are.
    """
    if wanted.startswith("/"):
        return wanted
    if wanted.startswith("usb:"):
        identity = parse_identity(wanted)
        fitting = [
            each
            for each in there
            if each.identity and identity.fits(parse_identity(each.identity))
        ]
    else:
        fitting = [each for each in there if each.description.startswith(wanted)]
    if len(fitting) == 1:
        return fitting[0].path
    known = ", ".join(f"{each.description!r} ({each.path})" for each in there) or "none"
    count = f"several {noun}s are" if fitting else f"no {noun} is"
    raise FileNotFoundError(f"{count} {wanted or 'there'!r}; there is {known}")


PERIOD = 0.25
"""How long a device is overlooked that udev says nothing about, in seconds."""


def watch(
    presence: Callable[[], Hashable | None],
    arrived: Callable[[], None],
    *,
    seen: Hashable | None = None,
) -> Callable[[], None]:
    """Have a function called whenever something has come that was not there.

    To be called in an event loop. While anybody waits there is one thread; it looks
    when udev has news and four times a second, and ends when nobody waits.

    Args:
        presence: Says what is there now, None if nothing is; another value is another
            arrival. Called in the thread: it may block, but holds up all others that
            wait. What it raises counts as nothing being there.
        arrived: Called in the event loop.
        seen: What was there before; that it is still there is no arrival.

    Returns:
        How to stop waiting. After that ``arrived`` is not called.
    """
    loop = asyncio.get_running_loop()
    waiting = _Waiting(loop, presence, arrived, seen)
    with _lock:
        watcher = _watchers.get(loop) or _Watcher(loop)
        watcher.add(waiting)

    def forget() -> None:
        waiting.over = True
        with _lock:
            watcher.remove(waiting)

    return forget


@attrs.define(eq=False)
class _Waiting:
    """One thing that is waited for."""

    _loop: asyncio.AbstractEventLoop
    _presence: Callable[[], Hashable | None]
    _arrived: Callable[[], None]
    _seen: Hashable | None
    over: bool = False

    def look(self) -> None:
        """Look whether it has come. In the thread."""
        try:
            now = self._presence()
        except Exception:  # whatever it cannot see is not there
            now = None
        before, self._seen = self._seen, now
        if now is not None and now != before:
            with contextlib.suppress(RuntimeError):  # the loop is closed
                self._loop.call_soon_threadsafe(self._tell)

    def _tell(self) -> None:
        if not self.over:
            self._arrived()


class _Watcher:
    """The thread of one event loop; all but the looking is done under the lock."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._all: list[_Waiting] = []
        self._wakes: Wakes | None = None

    def add(self, waiting: _Waiting) -> None:
        if self._wakes is None:
            self._wakes = Wakes()
            _watchers[self._loop] = self
            try:
                threading.Thread(
                    target=self._work,
                    args=(self._wakes,),
                    name="esair-hotplug",
                    daemon=True,
                ).start()
            except BaseException:  # no more threads: nothing is half made
                self._end()
                raise
        else:
            self._wakes.wake()
        self._all.append(waiting)  # the thread waits for the lock to see it

    def remove(self, waiting: _Waiting) -> None:
        if waiting in self._all:
            self._all.remove(waiting)
        if not self._all and self._wakes is not None:
            self._wakes.wake()

    def _work(self, wakes: Wakes) -> None:
        try:
            wakes.listen()
            while self._has_work():
                for waiting in self._all.copy():
                    if not waiting.over:
                        waiting.look()
                wakes.wait(PERIOD)
        finally:
            with _lock:
                self._end()

    def _has_work(self) -> bool:
        """Return whether anybody waits; if nobody does it is the end, at once."""
        with _lock:
            if not self._all or self._loop.is_closed():
                self._end()
                return False
            return True

    def _end(self) -> None:
        if self._wakes is not None:
            del _watchers[self._loop]
            self._all.clear()
            self._wakes.close()
            self._wakes = None


_lock = threading.Lock()
_watchers: dict[asyncio.AbstractEventLoop, _Watcher] = {}
