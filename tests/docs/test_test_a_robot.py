"""The tests of the how-to page: devices on fake wires, and fake parts."""

import asyncio
import errno

import pytest
from gripper import Force, Hold, LetGo, Motor
from sensors import RangeFinder, Thermometer

import esair
from esair.buses import CanState
from esair.drivers.mpu6050 import Motion, Mpu6050
from esair.drivers.mpu6050.fake import AT_REST, FakeMpu6050
from esair.testing import ActuatorContract, FakeCan

READ = esair.Access.READ
FORCE = 0x181


def newtons(force: float) -> bytes:
    return round(force * 100).to_bytes(2)


async def test_holds_what_it_has(fake_can) -> None:
    """It closes until it feels 5 N; the last frame on the bus is the safe command."""
    can = fake_can("arm")

    async with esair.Robot(
        resources=[Motor(bus=can), Force(bus=can)], behaviors=[Hold()]
    ):
        can.feed(FORCE, newtons(0.1))
        await can.until(lambda frame: frame.data == b"\x40")
        can.feed(FORCE, newtons(6.0))
        await can.until(lambda frame: frame.data == b"\x00")
        can.feed(FORCE, newtons(0.1))
        await can.until(lambda frame: frame.data == b"\x40")

    assert can.sent[-1].data == b"\x00"


async def test_is_safe_first_when_the_bus_is_back(fake_can) -> None:
    """Bus-off is a loss like a pulled cable."""
    can = fake_can("arm")
    motor = Motor(bus=can)

    async with esair.Robot(resources=[motor, Force(bus=can)], behaviors=[Hold()]):
        can.feed(FORCE, newtons(0.1))
        await can.until(lambda frame: frame.data == b"\x40")
        can.bus_off()
        await asyncio.sleep(1.0)
        assert can.state is CanState.BUS_OFF
        can.sent.clear()
        can.restart()
        await asyncio.sleep(0.1)
        can.feed(FORCE, newtons(0.1))
        await can.until(lambda frame: frame.data == b"\x40")

    assert can.sent[0].data == b"\x00"


async def test_ranges_in_pieces_between_garbage(fake_serial) -> None:
    """Whatever the line does to the bytes, a range is whole or is not there."""
    line = fake_serial("front")

    async with esair.Robot(resources=[RangeFinder(bus=line)]) as robot:
        right = await robot.resources.register("me", "range_finder", READ)
        await asyncio.sleep(0.1)
        line.split(1)
        line.garbage(seed=7, count=200)
        line.say(b"")  # an end of line: what was before it is over
        line.say(b"R 1.250")
        await asyncio.sleep(0.1)
        assert (await robot.sensors.read(right)).value == 1.25


async def test_a_chip_that_is_not_heard_once(fake_i2c) -> None:
    """A read is tried again; a clock that is held low too long is told."""
    chips = fake_i2c("chips", chips={0x48: {0x00: b"\x19\x00"}})

    async with esair.Robot(resources=[Thermometer(bus=chips)]) as robot:
        right = await robot.resources.register("me", "thermometer", READ)
        chips.fail(errno.EREMOTEIO, times=2, address=0x48)
        reading = await robot.sensors.read(right, fresh=True)
        assert reading.value == 25.0
        assert chips.stats.retries == 2

        chips.stretch(0.5)
        with pytest.raises(esair.DriverStuckError, match="chip 0x48"):
            await robot.sensors.read(right, fresh=True)


async def test_opens_when_it_is_upside_down(fake_can, fake_i2c) -> None:
    """The driver of the IMU is the real one; only its chip is not."""
    can, imu = fake_can("arm"), FakeMpu6050()
    attitude = Mpu6050(name="attitude", bus=fake_i2c("chips", chips={0x68: imu}))

    async with esair.Robot(
        resources=[Motor(bus=can), Force(bus=can), attitude],
        behaviors=[Hold(), LetGo()],
    ):
        can.feed(FORCE, newtons(0.1))
        await can.until(lambda frame: frame.data == b"\x40")
        imu.motion = Motion((0.0, 0.0, -9.81), (0.0, 0.0, 0.0), 25.0)
        await can.until(lambda frame: frame.data == b"\x81")
        imu.motion = AT_REST


class TestMotor(ActuatorContract):
    is_heard = False
    keeps_nothing = "each frame says all that it needs"

    def make(self) -> Motor:
        return Motor(bus=FakeCan("arm"))

    def commands(self) -> list[float]:
        return [1.0, -1.0]
