"""The window on an I²C bus, with chips in memory."""

import asyncio
import errno

import i2c_weather
import pytest

import esair
from esair.drivers.ads1115.fake import FakeAds1115
from esair.drivers.bme280 import Climate
from esair.drivers.bme280.fake import FakeBme280
from esair.drivers.pca9685.fake import FakePca9685

FINE = Climate(temperature=20.0, humidity=0.4, pressure=101_000.0)
HUMID = Climate(temperature=20.0, humidity=0.8, pressure=101_000.0)

SHUT = 0.001
OPEN = 0.0015236


class Chips:
    """The parts, and the bus that they are on."""

    def __init__(self, fake_i2c):
        self.air = FakeBme280(FINE)
        self.battery = FakeAds1115(1.9)
        self.servo = FakePca9685()
        self.bus = fake_i2c(
            "chips", chips={0x76: self.air, 0x48: self.battery, 0x40: self.servo}
        )

    @property
    def pulse(self) -> float:
        """How long the servo's pulses are, in seconds."""
        return self.servo.pulse(0)


@pytest.fixture
def chips(fake_i2c) -> Chips:
    return Chips(fake_i2c)


async def test_opens_while_it_is_humid(chips) -> None:
    """The air decides; at the stop the servo lets go."""
    async with i2c_weather.make_robot(chips.bus):
        await asyncio.sleep(3.0)
        assert chips.pulse == pytest.approx(SHUT, abs=1e-5)
        chips.air.climate = HUMID
        await asyncio.sleep(3.0)
        assert chips.pulse == pytest.approx(OPEN, abs=1e-5)

    assert chips.pulse == 0.0


async def test_shuts_while_there_is_power_left(chips) -> None:
    """The battery has priority over the air."""
    chips.air.climate = HUMID

    async with i2c_weather.make_robot(chips.bus):
        await asyncio.sleep(3.0)
        assert chips.pulse == pytest.approx(OPEN, abs=1e-5)
        chips.battery.inputs[0] = 1.6
        await asyncio.sleep(3.0)
        assert chips.pulse == pytest.approx(SHUT, abs=1e-5)


@pytest.mark.fault("I01")
async def test_lets_go_when_it_knows_nothing(chips) -> None:
    """A chip that does not answer is waited for; then all goes on."""
    async with i2c_weather.make_robot(chips.bus) as robot:
        await asyncio.sleep(3.0)
        chips.bus.silent(0x76)
        chips.bus.fail(errno.EREMOTEIO, times=None, address=0x48)
        await asyncio.sleep(20.0)
        for name in ("air", "battery"):
            assert robot.resources.query(name).state is esair.ResourceState.LOST
        assert chips.pulse == 0.0

        chips.bus.silent(0x76, silent=False)
        chips.bus.link.failures.clear()
        await asyncio.sleep(60.0)
        assert robot.resources.query("air").state is esair.ResourceState.READY
        assert chips.pulse == pytest.approx(SHUT, abs=1e-5)


@pytest.mark.long
@pytest.mark.fault("D01", "D04")
async def test_an_adapter_that_is_pulled_out_and_put_back(chips) -> None:
    """A hundred times; the servo moves again only after a fresh command."""
    async with i2c_weather.make_robot(chips.bus) as robot:
        await asyncio.sleep(3.0)
        for _ in range(100):
            chips.bus.unplug()
            await asyncio.sleep(0.5)
            chips.servo.power_cycle()
            for name in ("air", "battery", "window"):
                assert (
                    robot.resources.query(name).state is not esair.ResourceState.READY
                )
            chips.bus.link.log.clear()
            chips.bus.plug()
            await asyncio.sleep(5.0)
            pulses = [
                each.written[1:]
                for each in chips.bus.log
                if each.address == 0x40 and each.written[:1] == b"\x06"
            ]
            assert pulses[0] == bytes([0, 0, 0, 0x10])
            assert chips.pulse == pytest.approx(SHUT, abs=1e-5)
        assert chips.bus.stats.opened == 101
