"""CAN interfaces of the kernel, and what they are set to."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from pathlib import Path
from typing import Any

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


def devices(root: Path = ROOT) -> list[Device]:
    """Return the CAN interfaces that are there, by their names."""
    places = [
        place
        for place in entries(root / "sys/class/net")
        if read(place / "type") == ARPHRD_CAN
    ]
    settings = _settings() if places and root == ROOT else {}
    return [_interface(place, root, settings.get(place.name, {})) for place in places]


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


def _interface(place: Path, root: Path, data: dict[str, Any]) -> Device:
    usb = usb_device(place / "device", root)
    identity = None if usb is None else identity_of(usb)
    if usb is not None:
        words = words_of(usb) or "USB CAN adapter"
    elif (place / "device").exists():
        driver = os.path.basename(os.path.realpath(place / "device/driver"))
        words = f"controller of the computer ({driver})"
    else:
        words = VIRTUAL
    bitrate = data.get("bittiming", {}).get("bitrate")
    return Device(
        kind="can",
        path=place.name,
        address=place.name,
        description=words,
        identity=None if identity is None else str(identity),
        state=_state(place, bitrate, data.get("state")),
        bitrate=bitrate,
    )


def _state(place: Path, bitrate: int | None, state: str | None) -> str:
    try:
        up = bool(int(read(place / "flags"), 16) & IFF_UP)
    except ValueError:
        return ""
    words = ["up" if up else "down"]
    if bitrate is not None:
        words.append(f"{bitrate / 1000:g} kbit/s")
    if up and state is not None:
        words.append(state.lower())
    return ", ".join(words)


def _settings() -> dict[str, dict[str, Any]]:
    """Ask iproute2 for what only the kernel's netlink knows; nothing if it cannot."""
    program = shutil.which("ip", path=f"{os.environ.get('PATH', '')}:/usr/sbin:/sbin")
    if program is None:
        return {}
    try:
        answer = subprocess.run(
            [program, "-details", "-json", "link", "show"],
            capture_output=True,
            timeout=2.0,
            check=True,
        ).stdout
        return {
            link["ifname"]: link.get("linkinfo", {}).get("info_data", {})
            for link in json.loads(answer)
            if link.get("link_type") == "can"
        }
    except (OSError, subprocess.SubprocessError, ValueError, LookupError):
        return {}
