"""Everything that is plugged in."""

from __future__ import annotations

from pathlib import Path

from esair.discovery._can import can_interfaces
from esair.discovery._device import Device
from esair.discovery._gpio import gpio_chips
from esair.discovery._i2c import i2c_buses
from esair.discovery._serial import serial_ports

ROOT = Path("/")


def devices(root: Path = ROOT) -> list[Device]:
    """Return what is plugged in: serial, CAN, I²C, GPIO. Blocks for a moment.

    Nothing is opened but GPIO chips, which takes nothing from anybody.

    Args:
        root: Where ``/sys`` and ``/dev`` are.
    """
    return [
        *serial_ports(root),
        *can_interfaces(root),
        *i2c_buses(root),
        *gpio_chips(root),
    ]
