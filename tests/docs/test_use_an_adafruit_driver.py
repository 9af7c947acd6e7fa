"""The ventilation of the how-to page: CircuitPython drivers in a robot.toml."""

import asyncio
import subprocess
import sys
from pathlib import Path

import fake_chips
import pytest
from ventilation import Fan

import esair
from esair import config
from esair.drivers.adafruit import AdafruitActuator, AdafruitSensor
from esair.drivers.bme280 import Climate
from esair.testing import ActuatorContract, FakeI2c, SensorContract

ROBOT = Path(fake_chips.__file__).with_name("ventilation.toml")


class TestFan(ActuatorContract):
    keeps_nothing = "each command says all that it needs"

    def make(self) -> AdafruitActuator:
        return AdafruitActuator(
            library=Fan,
            attribute="speed",
            safe=0,
            limits=(0, 255),
            bus=FakeI2c(chips={0x60: b""}),
        )

    def commands(self) -> list[int]:
        return [1, 255]


class TestAir(SensorContract):
    keeps_nothing = "the driver sets its mode before each reading"

    def make(self) -> AdafruitSensor:
        return AdafruitSensor(
            library="adafruit_bme280.basic:Adafruit_BME280_I2C",
            address=0x76,
            value=["temperature", "relative_humidity"],
            bus=fake_chips.FakeChips(name="chips"),
        )


def speed(chips: fake_chips.FakeChips) -> int:
    """What the motor board was told."""
    return chips.chips[0x60].read(0x00, 1)[0]


@pytest.mark.virtual_clock
async def test_the_fan_turns_while_it_is_humid_and_the_battery_lasts() -> None:
    """Three drivers of Adafruit's kind on one bus; at the end the fan stands."""
    described = config.load(ROBOT, simulated=True)
    chips = described.buses["chips"]
    assert isinstance(chips, fake_chips.FakeChips)

    async with config.build(described):
        await asyncio.sleep(3.0)
        assert speed(chips) == 200
        chips.battery.inputs[0] = 2.9
        await asyncio.sleep(3.0)
        assert speed(chips) == 0
        chips.battery.inputs[0] = 3.3
        await asyncio.sleep(3.0)
        assert speed(chips) == 200
        chips.air.climate = Climate(21.0, 0.4, 101_325.0)
        await asyncio.sleep(3.0)
        assert speed(chips) == 0
        chips.air.climate = Climate(21.0, 0.7, 101_325.0)
        await asyncio.sleep(3.0)

    assert speed(chips) == 0


@pytest.mark.long
@pytest.mark.virtual_clock
async def test_a_part_that_falls_silent_stops_the_fan() -> None:
    """And when it answers again all goes on."""
    described = config.load(ROBOT, simulated=True)
    chips = described.buses["chips"]
    assert isinstance(chips, fake_chips.FakeChips)

    async with config.build(described) as robot:
        await asyncio.sleep(3.0)
        chips.silent(0x76)
        await asyncio.sleep(20.0)
        assert robot.resources.query("air").state is esair.ResourceState.LOST
        assert speed(chips) == 0
        chips.silent(0x76, silent=False)
        await asyncio.sleep(60.0)
        assert robot.resources.query("air").state is esair.ResourceState.READY
        assert speed(chips) == 200


@pytest.mark.long
def test_the_file_is_right_as_it_stands(tmp_path: Path) -> None:
    """For the real bus too; its parts are found in its own folder."""
    done = subprocess.run(
        [sys.executable, "-m", "esair", "check", "--strict", ROBOT],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )

    assert done.returncode == 0, done.stdout + done.stderr
    assert "real and simulated" in done.stdout
