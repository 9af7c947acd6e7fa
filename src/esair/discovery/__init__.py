"""What is plugged in, where a device is now, its table in a robot.toml, what has changed.

Nothing here opens a device or imports pyserial, pyudev or gpiod before it needs it.
"""

from __future__ import annotations

import importlib
import re
from pathlib import Path
from typing import Any, Final

from esair.buses import MEDIA
from esair.buses.finding import ROOT, Device, Wakes, watch
from esair.buses.serial import find_port, serial_identity

__all__ = [
    "Device",
    "Plugs",
    "Wakes",
    "devices",
    "find_port",
    "serial_identity",
    "toml",
    "watch",
]


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


class Plugs:
    """Compares what is plugged in with what was.

    Args:
        root: Where ``/sys`` and ``/dev`` are.

    Attributes:
        there: What was there at the last look.
    """

    def __init__(self, root: Path = ROOT) -> None:
        self._root = root
        self.there: list[Device] = devices(root)

    def look(self) -> tuple[list[Device], list[Device]]:
        """Look again; returns what has come and what has gone. Blocks for a moment.

        One that was renumbered has gone and come.
        """
        before, self.there = self.there, devices(self._root)
        return _without(self.there, before), _without(before, self.there)


def _without(those: list[Device], others: list[Device]) -> list[Device]:
    keys = {other.key for other in others}
    return [each for each in those if each.key not in keys]
