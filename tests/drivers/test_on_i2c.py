"""What all drivers of parts on an I²C bus do alike."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import re

import pytest

import esair
from esair import config
from esair.drivers.ads1115 import Ads1115
from esair.drivers.ads1115.fake import FakeAds1115
from esair.drivers.bme280 import Bme280
from esair.drivers.bme280.fake import FakeBme280
from esair.drivers.mpu6050 import Mpu6050
from esair.drivers.mpu6050.fake import FakeMpu6050
from esair.drivers.pca9685 import PwmChannel
from esair.drivers.pca9685.servo import PwmServo
from esair.exceptions import ConfigError, DeviceFaultError, DeviceLostError
from esair.testing import FakeI2c

PARTS = [
    (Mpu6050, {}),
    (Bme280, {}),
    (Ads1115, {}),
    (PwmChannel, {"channel": 0}),
    (PwmServo, {"channel": 0}),
]


@pytest.mark.virtual_clock
@pytest.mark.parametrize(("part", "options"), PARTS)
@pytest.mark.fault("I01")
async def test_a_part_that_does_not_answer_is_waited_for(part, options) -> None:
    """It is lost, not at fault: it comes when it comes."""
    bus = FakeI2c()
    await bus.open()

    with pytest.raises(DeviceLostError, match=r"no chip answers at 0x\d\d"):
        await part(bus=bus, **options).open()


@pytest.mark.virtual_clock
@pytest.mark.parametrize(("part", "options"), PARTS)
@pytest.mark.fault("I02")
async def test_a_part_that_answers_wrongly_is_at_fault(part, options) -> None:
    """Waiting alone does not help there."""
    device = part(bus=FakeI2c(), **options)
    await device.bus.open()
    device.bus.fail(errno.EIO, times=None)

    with pytest.raises(DeviceFaultError):
        await device.open()


class Look(esair.Behavior):
    """Reads the chip, whatever it answers."""

    chip = esair.reads(object)

    async def run(self) -> None:
        async for _ in esair.every(0.02):
            with contextlib.suppress(DeviceFaultError, DeviceLostError):
                await self.chip.read()


@pytest.mark.virtual_clock
@pytest.mark.promise("RES-3", "RES-4")
@pytest.mark.parametrize(
    ("part", "fake"),
    [(Mpu6050, FakeMpu6050), (Bme280, FakeBme280), (Ads1115, FakeAds1115)],
)
async def test_a_chip_that_restarts_while_it_is_read_is_soon_back(part, fake) -> None:
    """However often: that is no wrong answer, of which few are forgiven."""
    chip = fake()
    bus = FakeI2c(chips={part.addresses[0]: chip})
    device = part(name="chip", bus=bus, rate=20.0)
    async with esair.Robot(resources=[device], behaviors=[Look()]) as robot:
        for _ in range(5):
            await asyncio.sleep(7.3)
            chip.power_cycle()
        await asyncio.sleep(1.0)
        seen = robot.resources.query("chip")
        assert (seen.state, seen.faults) == (esair.ResourceState.READY, 0)


@pytest.mark.parametrize(("part", "options"), PARTS)
@pytest.mark.parametrize("address", [0x03, 0x78, "0x40", 1.0, None])
def test_a_part_has_one_of_its_addresses(part, options, address) -> None:
    """Those that its pins can give."""
    with pytest.raises(ConfigError, match="address: expected 0x"):
        part(address=address, **options)


def test_parts_are_described_in_a_file(tmp_path) -> None:
    """With their addresses, settings and channels; nothing is opened for that."""
    path = tmp_path / "robot.toml"
    path.write_text(
        """
        [bus.chips]
        type = "i2c"
        bus = "name:i2c-tiny-usb"
        timeout = 0.5

        [sensor.imu]
        driver = "esair.drivers.mpu6050:Mpu6050"
        bus = "chips"
        address = 0x69
        gyro_range = 1000

        [sensor.air]
        driver = "esair.drivers.bme280:Bme280"
        bus = "chips"
        rate = 0.5
        oversampling = 4

        [sensor.battery]
        driver = "esair.drivers.ads1115:Ads1115"
        bus = "chips"
        channel = "0-1"
        full_scale = 2.048

        [sensor.room]
        driver = "esair.drivers.adafruit:AdafruitSensor"
        bus = "chips"
        library = "adafruit_bme280.basic:Adafruit_BME280_I2C"
        address = 0x77
        value = ["temperature", "pressure"]

        [actuator.lamp]
        driver = "esair.drivers.pca9685:PwmChannel"
        bus = "chips"
        channel = 3

        [actuator.arm]
        driver = "esair.drivers.pca9685.servo:PwmServo"
        bus = "chips"
        channel = 4
        max_angle = 1.5
        command_timeout = 0.5

        [actuator.dac]
        driver = "esair.drivers.adafruit:AdafruitActuator"
        bus = "chips"
        library = "adafruit_bme280.basic:Adafruit_BME280_I2C"
        attribute = "sea_level_pressure"
        safe = 1013.25
        limits = [900.0, 1100.0]
        """
    )

    parts = config.load(path).resources

    assert parts["imu"].address == 0x69
    assert parts["imu"].settings["gyro_range"] == 1000
    assert parts["air"].settings["oversampling"] == 4
    assert parts["battery"].channel == "0-1"
    assert parts["battery"].settings["full_scale"] == 2.048
    assert parts["arm"].limits["angle"][1] == 1.5
    assert parts["arm"].command_timeout == 0.5
    assert parts["lamp"].bus is parts["room"].bus
    assert parts["lamp"].bus.place == "name:i2c-tiny-usb"
    assert parts["dac"].limits == (900.0, 1100.0)


@pytest.mark.parametrize(
    "table",
    [
        '[sensor.part]\ndriver = "mpu6050"\n',
        '[sensor.part]\ndriver = "bme280"\n',
        '[sensor.part]\ndriver = "ads1115"\n',
        '[actuator.part]\ndriver = "pca9685"\nchannel = 0\n',
        '[actuator.part]\ndriver = "esair.drivers.pca9685.servo:PwmServo"\nchannel = 0\n',
        '[sensor.part]\ndriver = "adafruit"\nlibrary = "io:BytesIO"\nvalue = "x"\n',
        '[actuator.part]\ndriver = "adafruit"\nlibrary = "io:BytesIO"\nattribute = "x"\n'
        "safe = 0\n",
    ],
)
def test_a_file_that_gives_a_part_no_i2c_bus_is_refused(tmp_path, table) -> None:
    """Before anything is opened: no bus, or one of another kind."""
    file = tmp_path / "robot.toml"
    file.write_text(table)
    (none,) = (each for each in config.check(file).findings if each.severity == "error")
    assert "'bus' is missing" in none.message
    assert "I2CBus" in none.message

    file.write_text(f'[bus.c]\ntype = "can"\nchannel = "can0"\n{table}bus = "c"\n')
    (other,) = (
        each for each in config.check(file).findings if each.severity == "error"
    )
    assert re.search(r"I2CBus( or SpiBus)?, but 'c' is a CanBus", other.message)
