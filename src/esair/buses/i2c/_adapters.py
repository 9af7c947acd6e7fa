"""I²C adapters that programs may use."""

from __future__ import annotations

from pathlib import Path

from esair.buses import finding
from esair.buses.finding import ROOT, Device

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
