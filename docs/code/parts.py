"""Two drivers: a thermometer and a voltage, both over I²C."""

import esair
from esair.buses import I2CBus


def decode_temperature(data: bytes) -> float:
    """Turn the register T_A into °C: 13 bits, two's complement, 1/16 °C each."""
    count = int.from_bytes(data) & 0x1FFF
    return (count - 0x2000 if count & 0x1000 else count) / 16


class Mcp9808(esair.Sensor[float]):
    """The temperature in °C. Source: Microchip DS25095."""

    bus: I2CBus
    rate = esair.setting(4.0, unit="Hz", min=0.1, max=4.0, doc="how often it is asked")
    address = 0x18

    async def open(self) -> None:
        if await self.bus.read(self.address, 0x06, 2) != b"\x00\x54":
            raise esair.DeviceFaultError(self.name, "it is no MCP9808")

    async def read(self) -> float:
        return decode_temperature(await self.bus.read(self.address, 0x05, 2))


class Mcp4725(esair.Actuator[float]):
    """A voltage, as a part of its supply. Source: Microchip DS22039, fast mode."""

    bus: I2CBus
    safe = 0.0
    limits = (0.0, 1.0)
    address = 0x60

    async def write(self, command: float) -> float:
        count = round(command * 4095)
        await self.bus.write(self.address, count >> 8, bytes([count & 0xFF]))
        return count / 4095
