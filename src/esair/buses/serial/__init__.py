"""Serial lines: the bus, the ports it opens, the far ends, the fake.

Only ``_port.py`` knows pyserial, and imports it when a port is opened.
"""

from esair.buses.serial._bus import SerialBus
from esair.buses.serial._fake import FakeSerial, MemoryLine, PtyLine
from esair.buses.serial._line import SerialLink, SerialWire
from esair.buses.serial._port import (
    OPEN_TIMEOUT,
    Port,
    SerialPlace,
    close_port,
    explain,
    open_port,
    reach_port,
)
from esair.buses.serial._ports import devices, find_port, serial_identity, toml

__all__ = [
    "OPEN_TIMEOUT",
    "FakeSerial",
    "MemoryLine",
    "Port",
    "PtyLine",
    "SerialBus",
    "SerialLink",
    "SerialPlace",
    "SerialWire",
    "close_port",
    "devices",
    "explain",
    "find_port",
    "open_port",
    "reach_port",
    "serial_identity",
    "toml",
]
