"""Three sensors: one that is asked, one whose driver blocks, one that pushes."""

from collections.abc import AsyncIterator
from pathlib import Path

import esair
from esair.buses import I2CBus, SerialBus


class Thermometer(esair.Sensor[float]):
    """A TMP102 on an I²C bus: the temperature in °C.

    Source: the maker's data sheet, SBOS397.
    """

    bus: I2CBus
    rate = esair.setting(4.0, unit="Hz", min=0.1, max=8.0, doc="how often it is asked")
    address = 0x48

    async def read(self) -> float:
        data = await self.bus.read(self.address, 0x00, 2)
        return (int.from_bytes(data, signed=True) >> 4) * 0.0625


class CpuTemperature(esair.Sensor[float]):
    """The temperature of this computer in °C; reading a file blocks."""

    rate = 1.0
    path = Path("/sys/class/thermal/thermal_zone0/temp")

    def read(self) -> float:
        return int(self.path.read_text()) / 1000


class RangeFinder(esair.Sensor[float]):
    """A board that sends a line ``R 1.250`` for each range, in metres."""

    bus: SerialBus

    async def stream(self) -> AsyncIterator[float]:
        with self.bus.frames(b"R ") as lines:
            async for line in lines:
                yield float(line[2:])
