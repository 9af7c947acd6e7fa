"""The bus of the ventilation without its parts: the same registers in memory."""

from esair.drivers.ads1115.fake import FakeAds1115
from esair.drivers.bme280 import Climate
from esair.drivers.bme280.fake import FakeBme280
from esair.testing import FakeI2c


class FakeChips(FakeI2c):
    """Humid air, a full battery, and a motor board that is nothing but registers."""

    def __init__(self, *, name: str) -> None:
        self.air = FakeBme280(Climate(21.0, 0.7, 101_325.0))
        self.battery = FakeAds1115(3.3)
        super().__init__(name, chips={0x76: self.air, 0x48: self.battery, 0x60: b""})
