"""Gamepads that are plugged in, by what ``/sys`` says of them."""

from __future__ import annotations

from pathlib import Path

from esair.buses import finding
from esair.buses.finding import ROOT, Device

_GAMEPAD, _JOYSTICK = 0x130, 0x120
"""A pad has the first of these buttons, and a joystick the second."""


def devices(root: Path = ROOT) -> list[Device]:
    """Return the pads that are there, by the numbers of their events."""
    return [
        _pad(place, root)
        for place in finding.entries(root / "sys/class/input")
        if place.name.removeprefix("event").isdecimal() and _is_pad(place)
    ]


def toml(device: Device, name: str) -> list[str]:
    """Return the lines of a robot.toml for a pad."""
    return [
        f"[sensor.{name}]",
        'driver = "gamepad"',
        f"device = {finding.quoted(device.address)}",
        'dead_man = "tl"',
    ]


def find_pad(wanted: str, root: Path = ROOT) -> str:
    """Return the path of a pad; what is wanted, and errors, are those of `pick`."""
    return finding.pick(wanted, devices(root), "pad")


def _is_pad(place: Path) -> bool:
    # The bits of the buttons, the highest word first, in hexadecimal.
    bits, size = 0, 64
    for word in finding.read(place / "device/capabilities/key").split():
        try:
            bits = bits << size | int(word, 16)
        except ValueError:
            return False
    return bool(bits >> _GAMEPAD & 1 or bits >> _JOYSTICK & 1)


def _pad(place: Path, root: Path) -> Device:
    path = f"/dev/input/{place.name}"
    name = finding.read(place / "device/name")
    identity = None
    if finding.read(place / "device/id/bustype") == "0003":  # USB
        try:
            found = finding.UsbIdentity(
                int(finding.read(place / "device/id/vendor"), 16),
                int(finding.read(place / "device/id/product"), 16),
                finding.read(place / "device/uniq"),
            )
            identity = str(found)
        except ValueError:  # it is just being unplugged
            identity = None
    return Device(
        kind="gamepad",
        path=path,
        address=identity or name or path,
        description=name,
        identity=identity,
        state=finding.permission(root / path.removeprefix("/")),
    )
