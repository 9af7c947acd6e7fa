"""The bus of the ventilation without its parts: the same registers in memory."""

from esair.drivers.bme280 import Climate
from esair.testing import FakeI2c
from esair.testing.parts.ads1115 import FakeAds1115
from esair.testing.parts.bme280 import FakeBme280


class FakeChips(FakeI2c):
    """Humid air, a full battery, and a motor board that is nothing but registers."""

    def __init__(self, *, name: str) -> None:
        self.air = FakeBme280(Climate(21.0, 0.7, 101_325.0))
        self.battery = FakeAds1115(3.3)
        super().__init__(name, chips={0x76: self.air, 0x48: self.battery, 0x60: b""})
