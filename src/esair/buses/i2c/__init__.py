"""I²C buses: the bus, its errors, the adapters, the far end, the fake.

Only ``_kernel.py`` knows smbus2, and imports it when a bus is opened.
"""

from esair.buses.i2c._bus import SILENT, I2CBus
from esair.buses.i2c._fake import Chip, ChipBus, FakeI2c, Registers, Transfer
from esair.buses.i2c._kernel import (
    MessageLink,
    RegisterLink,
    devices,
    probe,
    toml,
    transfer,
)

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
