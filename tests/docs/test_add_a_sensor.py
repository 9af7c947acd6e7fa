"""The three sensors of the how-to page."""

import asyncio
import errno
from collections.abc import Sequence

import pytest
from sensors import CpuTemperature, RangeFinder, Thermometer

import esair
from esair.buses import I2CBus, SerialBus, Wire
from esair.buses.serial import MemoryLine

READ = esair.Access.READ


class Tmp102(Wire):
    """The registers of the part, as smbus2 gives them; -25 °C, from its data sheet."""

    def open(self) -> "Tmp102":
        return self

    def read_i2c_block_data(
        self, i2c_addr: int, register: int, length: int
    ) -> list[int]:
        assert (i2c_addr, register, length) == (0x48, 0x00, 2)
        return [0xE7, 0x00]

    def read_byte_data(self, i2c_addr: int, register: int) -> int:
        raise OSError(errno.EREMOTEIO, "it is read two bytes at a time")

    def write_byte_data(self, i2c_addr: int, register: int, value: int) -> None:
        raise OSError(errno.EREMOTEIO, "it is only read")

    def write_i2c_block_data(
        self, i2c_addr: int, register: int, data: Sequence[int]
    ) -> None:
        raise OSError(errno.EREMOTEIO, "it is only read")

    def close(self) -> None:
        return None


class Reader(esair.Behavior):
    """Keeps every value of a sensor, or the error that ended it."""

    def __init__(self, sensor: str) -> None:
        super().__init__()
        self.sensor = sensor
        self.values: list[float] = []

    async def run(self) -> None:
        async for value in await self.register(self.sensor, READ):
            self.values.append(value)


@pytest.mark.virtual_clock
async def test_a_sensor_that_is_asked() -> None:
    """The thermometer is asked at its rate while somebody follows it."""
    bus = I2CBus(name="chips", wire=Tmp102())
    reader = Reader("thermometer")

    async with esair.Robot(resources=[Thermometer(bus=bus)], behaviors=[reader]):
        await asyncio.sleep(2.0)

    assert 7 <= len(reader.values) <= 9
    assert set(reader.values) == {-25.0}


@pytest.mark.virtual_clock
async def test_a_sensor_whose_driver_blocks(tmp_path) -> None:
    """Its plain ``read`` is called on a thread; a file that vanishes is a loss."""
    sensor = CpuTemperature()
    sensor.path = tmp_path / "temp"
    sensor.path.write_text("48312\n")

    async with esair.Robot(resources=[sensor]) as robot:
        right = await robot.resources.register("me", "cpu_temperature", READ)
        assert (await robot.sensors.read(right)).value == 48.312

        sensor.path.unlink()
        await asyncio.sleep(1.5)  # its newest reading is good for 1 s
        with pytest.raises(esair.DeviceLostError):
            await robot.sensors.read(right)


@pytest.mark.virtual_clock
async def test_a_sensor_that_pushes() -> None:
    """Each line that it sends is a reading; unplugged, it comes back by itself."""
    line = MemoryLine("front")
    line.plug()
    bus = SerialBus(name="front", wire=line)
    reader = Reader("range_finder")

    async with esair.Robot(
        resources=[RangeFinder(bus=bus)], behaviors=[reader]
    ) as robot:
        await asyncio.sleep(0.1)
        line.write(b"R 1.250\n")
        await asyncio.sleep(0.1)
        line.unplug()
        await asyncio.sleep(1.0)
        assert robot.resources.query("range_finder").state is esair.ResourceState.LOST
        line.plug()
        await asyncio.sleep(6.0)
        line.write(b"R 0.750\n")
        await asyncio.sleep(0.1)

    assert reader.values == [1.25, 0.75]
