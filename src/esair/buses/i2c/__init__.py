"""I²C buses: the bus, its errors, the adapters, the far end, the fake.

Only ``_kernel.py`` opens smbus2's bus; its messages are made in ``_link.py``.
"""

from esair.buses.i2c._bus import SILENT, I2CBus
from esair.buses.i2c._fake import Chip, ChipBus, FakeI2c, Registers, Transfer
from esair.buses.i2c._kernel import devices, toml
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
