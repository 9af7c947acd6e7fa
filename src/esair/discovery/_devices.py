"""Everything that is plugged in, and its tables in a robot.toml."""

from __future__ import annotations

import importlib
import re
from pathlib import Path
from typing import Any, Final

from esair.buses import MEDIA
from esair.buses.finding import ROOT, Device

_ROOMS: Final = {
    **{kind: medium.package for kind, medium in MEDIA.items()},
    "gpio": "esair.drivers.gpio",
    "gamepad": "esair.drivers.gamepad",
    "camera": "esair.drivers.camera",
}
"""Who finds what: packages with ``devices(root)`` and ``toml(device, name)``."""


def devices(root: Path = ROOT) -> list[Device]:
    """Return what is plugged in, of all media. Blocks for a moment.

    Nothing is opened but GPIO chips, which takes nothing from anybody.

    Args:
        root: Where ``/sys`` and ``/dev`` are.
    """
    return [device for kind in _ROOMS for device in _room(kind).devices(root)]


def toml(device: Device) -> str:
    """Return the table of a robot.toml for a device, ready to be pasted.

    What only the user can know, such as a bit rate, is the usual value; for GPIO it
    is an input on the first line.
    """
    name = re.sub("[^a-z0-9]+", "_", device.path.rpartition("/")[2].lower())
    head = f"# {device.description or device.kind}"
    if device.address not in {device.path, device.path.rpartition("-")[2]}:
        head += f", now {device.path}"
    return "\n".join((head, *_room(device.kind).toml(device, name))) + "\n"


def _room(kind: str) -> Any:
    return importlib.import_module(_ROOMS[kind])
