"""Serial lines: the bus, the ports it opens, the far end, the fake.

Only ``_port.py`` knows pyserial, and imports it when a port is opened.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from esair.loading import late

if TYPE_CHECKING:
    from esair.buses.serial._bus import SerialBus
    from esair.buses.serial._fake import FakeSerial
    from esair.buses.serial._far_end import MemoryLine, PtyLine
    from esair.buses.serial._line import SerialLink, SerialWire
    from esair.buses.serial._owner import explain
    from esair.buses.serial._place import SerialPlace
    from esair.buses.serial._port import (
        OPEN_TIMEOUT,
        Port,
        close_port,
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

__getattr__, __dir__ = late(
    __name__,
    {
        "_port": "OPEN_TIMEOUT Port close_port open_port reach_port",
        "_fake": "FakeSerial",
        "_far_end": "MemoryLine PtyLine",
        "_bus": "SerialBus",
        "_line": "SerialLink SerialWire",
        "_owner": "explain",
        "_place": "SerialPlace",
        "_ports": "devices find_port serial_identity toml",
    },
)
