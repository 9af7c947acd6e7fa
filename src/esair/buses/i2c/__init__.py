"""I²C buses: the bus, its errors, the adapters, the far end, the fake.

Only ``_kernel.py`` opens smbus2's bus; its messages are made in ``_link.py``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from esair.loading import late

if TYPE_CHECKING:
    from esair.buses.i2c._adapters import devices, toml
    from esair.buses.i2c._bus import SILENT, I2CBus
    from esair.buses.i2c._fake import FakeI2c, Transfer
    from esair.buses.i2c._far_end import Chip, ChipBus, Registers
    from esair.buses.i2c._link import MessageLink, RegisterLink, probe, transfer

__all__ = [
    "SILENT",
    "Chip",
    "ChipBus",
    "FakeI2c",
    "I2CBus",
    "MessageLink",
    "RegisterLink",
    "Registers",
    "Transfer",
    "devices",
    "probe",
    "toml",
    "transfer",
]

__getattr__, __dir__ = late(
    __name__,
    {
        "_far_end": "Chip ChipBus Registers",
        "_fake": "FakeI2c Transfer",
        "_bus": "I2CBus SILENT",
        "_link": "MessageLink RegisterLink probe transfer",
        "_adapters": "devices toml",
    },
)
