"""What is plugged in, where a device is now, and when it comes back.

Nothing here opens a device or imports pyserial, pyudev or gpiod before it needs it.
"""

from esair.buses.finding import Device, Wakes, watch
from esair.buses.serial import find_port, serial_identity
from esair.discovery._devices import Plugs, devices, toml

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
