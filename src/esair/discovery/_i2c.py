"""I²C adapters that programs may use."""

from __future__ import annotations

from pathlib import Path

from esair.discovery import _usb
from esair.discovery._device import Device
from esair.discovery._permission import permission
from esair.discovery._sysfs import entries, read

ROOT = Path("/")

_WHERE = " at bus "
"""What begins the part of a USB adapter's name that changes with every plugging."""


def i2c_buses(root: Path = ROOT) -> list[Device]:
    """Return the I²C buses that are there, by their numbers."""
    places = sorted(
        (
            place
            for place in entries(root / "sys/class/i2c-dev")
            if place.name.removeprefix("i2c-").isdecimal()
            and (root / "dev" / place.name).exists()
        ),
        key=lambda place: int(place.name.removeprefix("i2c-")),
    )
    names = {place.name: read(place / "name") for place in places}
    return [_bus(place, root, names) for place in places]


def _bus(place: Path, root: Path, names: dict[str, str]) -> Device:
    name = names[place.name]
    usb = _usb.usb_device(place / "device", root)
    identity = None if usb is None else _usb.identity_of(usb)
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
        identity=None if identity is None else str(identity),
        state=permission(root / "dev" / place.name),
    )
