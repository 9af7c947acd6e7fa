"""Cameras that are plugged in, by what ``/sys`` says of them."""

from __future__ import annotations

from pathlib import Path

from esair.buses.finding import (
    ROOT,
    Device,
    entries,
    identity_of,
    permission,
    pick,
    quoted,
    read,
    usb_device,
)


def devices(root: Path = ROOT) -> list[Device]:
    """Return the cameras that are there, by their numbers.

    Of the files of one camera the first is its pictures; the others are of no use here.
    """
    return [
        _camera(place, root)
        for place in entries(root / "sys/class/video4linux")
        if place.name.removeprefix("video").isdecimal()
        and read(place / "index") in {"", "0"}
    ]


def toml(device: Device, name: str) -> list[str]:
    """Return the lines of a robot.toml for a camera."""
    return [
        f"[sensor.{name}]",
        'driver = "camera"',
        f"device = {quoted(device.address)}",
        "width = 640",
        "height = 480",
    ]


def find_camera(wanted: str, root: Path = ROOT) -> str:
    """Return the path of a camera; what is wanted, and errors, are those of `pick`."""
    return pick(wanted, devices(root), "camera")


def _camera(place: Path, root: Path) -> Device:
    identity = identity_of(usb_device(place / "device", root))
    path = f"/dev/{place.name}"
    name = read(place / "name")
    return Device(
        kind="camera",
        path=path,
        address=identity or name or path,
        description=name,
        identity=identity,
        state=permission(root / path.removeprefix("/")),
    )
