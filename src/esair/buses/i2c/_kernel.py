"""I²C buses of the Linux kernel: found, opened, watched. Only here is smbus2 opened."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, cast

from esair.buses import finding
from esair.buses.finding import ROOT, Device, entries, read
from esair.buses.i2c._link import RegisterLink
from esair.exceptions import ConfigError

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
    places = [
        place
        for place in finding.entries(root / "sys/class/i2c-dev")
        if place.name.removeprefix("i2c-").isdecimal()
        and (root / "dev" / place.name).exists()
    ]
    names = {place.name: finding.read(place / "name") for place in places}
    return [_bus(place, root, names) for place in places]


def toml(device: Device, name: str) -> list[str]:
    """Return the lines of a robot.toml for a bus."""
    number = device.address.isdecimal()
    return [
        f"[bus.{name}]",
        'type = "i2c"',
        f"bus = {device.address if number else finding.quoted(device.address)}",
    ]


def _bus(place: Path, root: Path, names: dict[str, str]) -> Device:
    name = names[place.name]
    usb = finding.usb_device(place / "device", root)
    address = place.name.removeprefix("i2c-")
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
