"""CAN interfaces of the kernel, and what they are set to."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
from typing import Final

from esair.buses.can._errors import CanState
from esair.buses.can._interface import Interface, look_up
from esair.buses.finding import (
    ROOT,
    Device,
    entries,
    identity_of,
    quoted,
    read,
    usb_device,
    words_of,
)

ARPHRD_CAN = "280"  # linux/if_arp.h
IFF_UP = 1

VIRTUAL = "virtual CAN"
"""What an interface is called that has no wire, and so no bit rate."""


_WORDS: Final = {
    CanState.ACTIVE: "error-active",
    CanState.WARNING: "error-warning",
    CanState.PASSIVE: "error-passive",
    CanState.BUS_OFF: "bus-off",
}


def devices(root: Path = ROOT) -> list[Device]:
    """Return the CAN interfaces that are there, by their names."""
    places = [
        place
        for place in entries(root / "sys/class/net")
        if read(place / "type") == ARPHRD_CAN
    ]
    return [_interface(place, root) for place in places]


def toml(device: Device, name: str) -> list[str]:
    """Return the lines of a robot.toml for an interface, and how to start it."""
    start = []
    if device.state.startswith("down"):
        is_set = device.bitrate is not None or device.description == VIRTUAL
        kind = "" if is_set else " type can bitrate 500000"
        start = [f"# it is down: sudo ip link set {device.path} up{kind}"]
    return [
        *start,
        f"[bus.{name}]",
        'type = "can"',
        'interface = "socketcan"',
        f"channel = {quoted(device.address)}",
    ]


def _interface(place: Path, root: Path) -> Device:
    usb = usb_device(place / "device", root)
    if usb is not None:
        words = words_of(usb) or "USB CAN adapter"
    elif (place / "device").exists():
        driver = os.path.basename(os.path.realpath(place / "device/driver"))
        words = f"controller of the computer ({driver})"
    else:
        words = VIRTUAL
    found = None
    if root == ROOT:  # what only the kernel knows: its files do not tell
        with contextlib.suppress(OSError):
            found = look_up(place.name)
    return Device(
        kind="can",
        path=place.name,
        address=place.name,
        description=words,
        identity=identity_of(usb),
        state=_state(place, found),
        bitrate=None if found is None else found.bitrate,
    )


def _state(place: Path, found: Interface | None) -> str:
    try:
        up = bool(int(read(place / "flags"), 16) & IFF_UP)
    except ValueError:
        return ""
    words = ["up" if up else "down"]
    if found is not None and found.bitrate is not None:
        words.append(f"{found.bitrate / 1000:g} kbit/s")
    if up and found is not None and found.has_controller:
        words.append(_WORDS[found.state])
    return ", ".join(words)
