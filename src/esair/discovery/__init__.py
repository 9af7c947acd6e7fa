"""What is plugged in, where a device is now, and when it comes back.

Nothing here opens a device or imports pyserial, pyudev or gpiod before it needs it.
"""

from esair.discovery._device import Device, Kind
from esair.discovery._devices import devices
from esair.discovery._plugs import Plugs
from esair.discovery._serial import find_port, serial_identity
from esair.discovery._toml import toml
from esair.discovery._wakes import Wakes
from esair.discovery._watch import watch

__all__ = [
    "Device",
    "Kind",
    "Plugs",
    "Wakes",
    "devices",
    "find_port",
    "serial_identity",
    "toml",
    "watch",
]
