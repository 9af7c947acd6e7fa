"""SPI buses: the bus, the device files, the far end, the fake.

Only ``_kernel.py`` knows spidev, and imports it when a bus is opened.
"""

from esair.buses.spi._bus import SpiBus
from esair.buses.spi._fake import Exchange, FakeSpi, SpiChip, SpiChips, SpiRegisters
from esair.buses.spi._kernel import SpiLink, devices, toml

__all__ = [
    "Exchange",
    "FakeSpi",
    "SpiBus",
    "SpiChip",
    "SpiChips",
    "SpiLink",
    "SpiRegisters",
    "devices",
    "toml",
]
