"""I²C buses of the Linux kernel: found, opened, watched; and any transfer on one.

Only here is smbus2 known.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol, cast

from esair.buses import finding
from esair.buses.finding import ROOT, Device, entries, read
from esair.exceptions import ConfigError

PLAIN_I2C = 0x00000001
"""In ``funcs``: the master makes any transfer, not only those of SMBus."""

QUICK = 0x00010000
"""In ``funcs``: the master can address a chip without a byte (SMBus quick)."""

SMBUS_LIMIT = 32
"""How many bytes a block transfer of SMBus carries."""

LIMIT = 8192
"""How many bytes the kernel moves in one message."""


class RegisterLink(Protocol):
    """An I²C master; ``smbus2.SMBus`` is one.

    This is what registers need. A master that also has the methods of `MessageLink`,
    as ``smbus2.SMBus`` has, makes plain transfers and scans too.
    """

    def read_byte_data(self, i2c_addr: int, register: int) -> int:
        """Read one register."""

    def write_byte_data(self, i2c_addr: int, register: int, value: int) -> None:
        """Write one register."""

    def read_i2c_block_data(
        self, i2c_addr: int, register: int, length: int
    ) -> list[int]:
        """Read several registers in one transfer."""

    def write_i2c_block_data(
        self, i2c_addr: int, register: int, data: Sequence[int]
    ) -> None:
        """Write several registers in one transfer."""

    def close(self) -> None:
        """Let the bus go."""


class MessageLink(RegisterLink, Protocol):
    """An I²C master that makes transfers without registers too."""

    funcs: int
    """What the adapter can do, as the bits of the kernel's ``I2C_FUNC_...``."""

    def i2c_rdwr(self, *messages: Any) -> None:
        """Make ``smbus2.i2c_msg`` transfers with repeated starts in between."""

    def read_byte(self, i2c_addr: int) -> int:
        """Read a byte from where the chip's pointer is."""

    def write_byte(self, i2c_addr: int, value: int) -> None:
        """Write one byte, which most chips take as their pointer."""

    def write_quick(self, i2c_addr: int) -> None:
        """Address a chip and nothing more."""


def message_link(link: RegisterLink) -> MessageLink:
    """Return a link as one with plain transfers."""
    if not hasattr(link, "i2c_rdwr"):
        raise unsupported("its link has the calls for registers only")
    return cast("MessageLink", link)


def unsupported(what: str) -> OSError:
    """Return the error for something that an adapter cannot do."""
    return OSError(errno.EOPNOTSUPP, f"{os.strerror(errno.EOPNOTSUPP)}: {what}")


def transfer(link: RegisterLink, address: int, write: bytes, read: int) -> bytes:
    """Write some bytes, then read some after a repeated start; either may be none.

    An adapter with plain I²C does exactly that. One that has only the calls of SMBus
    gets the call that puts the same bits on the wire, if there is one.

    Raises:
        OSError: The transfer failed, or the adapter has no call for it.
    """
    found = message_link(link)
    if int(found.funcs) & PLAIN_I2C:
        return _by_messages(found, address, write, read)
    return _by_smbus(found, address, write, read)


def _by_messages(link: MessageLink, address: int, write: bytes, read: int) -> bytes:
    if not write and not read:  # many adapters refuse a message without a byte
        link.write_quick(address)
        return b""
    from smbus2 import i2c_msg

    messages = []
    if write:
        messages.append(i2c_msg.write(address, write))
    if read:
        messages.append(i2c_msg.read(address, read))
    link.i2c_rdwr(*messages)
    return bytes(cast("Any", messages[-1])) if read else b""


def _by_smbus(link: MessageLink, address: int, write: bytes, read: int) -> bytes:
    match len(write), read:
        case 0, 0:
            link.write_quick(address)
        case 0, 1:
            return bytes([link.read_byte(address)])
        case 1, 0:
            link.write_byte(address, write[0])
        case 2, 0:
            link.write_byte_data(address, write[0], write[1])
        case count, 0 if count <= SMBUS_LIMIT + 1:
            link.write_i2c_block_data(address, write[0], list(write[1:]))
        case 1, 1:
            return bytes([link.read_byte_data(address, write[0])])
        case 1, count if count <= SMBUS_LIMIT:
            return bytes(link.read_i2c_block_data(address, write[0], count))
        case _:
            raise unsupported(
                f"the adapter has SMBus only, where no call writes {len(write)} "
                f"and reads {read} bytes"
            )
    return b""


def probe(link: RegisterLink, address: int) -> None:
    """Find out whether a chip answers, as ``i2cdetect`` does it.

    A quick write could set the write protection of memories (0x30 to 0x37) and
    destroy some (0x50 to 0x5f): those are read instead. An adapter without quick
    writes reads everywhere.

    Raises:
        OSError: It does not answer.
    """
    found = message_link(link)
    read = 0x30 <= address <= 0x37 or 0x50 <= address <= 0x5F
    if read or not int(found.funcs) & QUICK:
        found.read_byte(address)
    else:
        found.write_quick(address)


NAMED = "name:"
"""How the name of an adapter begins where a bus is given."""

_CLASS = Path("/sys/class/i2c-dev")
_DEVICES = Path("/sys/bus/i2c/devices")


def check_place(component: str, place: object) -> int | str:
    """Return where a bus is: a number, a path, or an adapter's name."""
    if type(place) is int and place >= 0:
        return place
    if isinstance(place, str) and (
        place.startswith("/") or (place.startswith(NAMED) and place != NAMED)
    ):
        return place
    raise ConfigError(
        component,
        "bus",
        "expected a whole number (the N of /dev/i2c-N), a path, or 'name:' and the "
        f"beginning of the adapter's name, not {place!r:.80}",
    )


def adapters(directory: Path = _CLASS) -> dict[int, str]:
    """Return the names of the adapters that are there, by their numbers."""
    return {
        int(number): name
        for place in entries(directory)
        if (number := place.name.removeprefix("i2c-")).isdecimal()
        and (name := read(place / "name"))  # or it is just being unplugged
    }


def find(place: int | str, directory: Path = _CLASS) -> str:
    """Return the path of a bus; an `OSError` if not one adapter has the name."""
    if isinstance(place, int):
        return f"/dev/i2c-{place}"
    if not place.startswith(NAMED):
        return place
    wanted = place.removeprefix(NAMED)
    there = adapters(directory)
    fitting = [number for number, name in there.items() if name.startswith(wanted)]
    if len(fitting) == 1:
        return f"/dev/i2c-{fitting[0]}"
    known = ", ".join(f"{name!r} (i2c-{number})" for number, name in there.items())
    told = f"no adapter's name begins with {wanted!r}; there is {known or 'none'}"
    if fitting:
        told = f"several adapters' names begin with {wanted!r}, say more of it: {known}"
    raise FileNotFoundError(told)


def presence(place: int | str) -> tuple[int, int, int] | None:
    """Look whether a bus is there; another value is another arrival of it."""
    try:
        seen = os.stat(find(place))
    except OSError:
        return None
    return seen.st_rdev, seen.st_ino, seen.st_ctime_ns


def is_removable(path: str, directory: Path = _CLASS) -> bool:
    """Tell whether the adapter of a bus hangs on USB."""
    return "/usb" in os.path.realpath(directory / os.path.basename(path) / "device")


def owner(path: str, address: int, directory: Path = _DEVICES) -> Path | None:
    """Return the driver of the kernel that has a chip, as its place in ``/sys``."""
    number = os.path.realpath(path).rpartition("-")[2]
    driver = directory / f"{number}-{address:04x}" / "driver"
    return driver if driver.exists() else None


def open_bus(path: str, *, pec: bool) -> RegisterLink:
    """Open a bus of the kernel, never with ``force``."""
    import smbus2

    class KernelLink(smbus2.SMBus):
        """A bus that does not reach behind the back of the kernel's own drivers."""

        def i2c_rdwr(self, *messages: Any) -> None:
            # The kernel itself asks who owns a chip only when one is selected.
            for address in {message.addr for message in messages}:
                self._set_address(address)  # type: ignore[attr-defined]
            super().i2c_rdwr(*messages)

    link = KernelLink()
    try:
        link.open(path)
        if pec:
            link.enable_pec(True)
    except OSError:
        link.close()  # smbus2 leaves the descriptor open
        raise
    return cast("RegisterLink", link)


_WHERE = " at bus "
"""What begins the part of a USB adapter's name that changes with every plugging."""


def devices(root: Path = ROOT) -> list[Device]:
    """Return the I²C buses that are there, by their numbers."""
    directory = root / "sys/class/i2c-dev"
    names = adapters(directory)
    return [
        _bus(directory / f"i2c-{number}", root, names)
        for number in names
        if (root / f"dev/i2c-{number}").exists()
    ]


def toml(device: Device, name: str) -> list[str]:
    """Return the lines of a robot.toml for a bus."""
    number = device.address.isdecimal()
    return [
        f"[bus.{name}]",
        'type = "i2c"',
        f"bus = {device.address if number else finding.quoted(device.address)}",
    ]


def _bus(place: Path, root: Path, names: dict[int, str]) -> Device:
    address = place.name.removeprefix("i2c-")
    name = names[int(address)]
    usb = finding.usb_device(place / "device", root)
    if usb is not None:  # its number is whatever was free
        lasting = name.partition(_WHERE)[0]
        if lasting and sum(each.startswith(lasting) for each in names.values()) == 1:
            address = f"name:{lasting}"
    return Device(
        kind="i2c",
        path=f"/dev/{place.name}",
        address=address,
        description=name,
        identity=finding.identity_of(usb),
        state=finding.permission(root / "dev" / place.name),
    )
