"""The MPU-6050: registers to SI units, and what it is told at its opening."""

from __future__ import annotations

import math
from typing import Any

import pytest

from esair.buses import I2CBus
from esair.drivers.mpu6050 import (
    GRAVITY,
    GYRO_CONFIG,
    PWR_MGMT_1,
    Motion,
    Mpu6050,
    decode_motion,
    encode_motion,
)
from esair.exceptions import ConfigError, DeviceFaultError
from esair.sim import SimMpu6050, World
from esair.wires import ChipBus

pytestmark = pytest.mark.virtual_clock


def test_registers_are_big_endian_counts_of_the_data_sheet() -> None:
    """One g is 16384 counts, 131 counts are a degree a second, 0 is 36.53 °C."""
    block = bytes.fromhex("4000 0000 c000 0000 0083 ff7d 0000".replace(" ", ""))

    motion = decode_motion(block)

    assert motion.acceleration == pytest.approx((GRAVITY, 0.0, -GRAVITY))
    assert motion.turn_rate == pytest.approx((math.radians(1), -math.radians(1), 0.0))
    assert motion.temperature == pytest.approx(36.53)


@pytest.mark.parametrize(("accel_step", "gyro_step"), [(0, 0), (1, 2), (3, 3)])
def test_a_motion_comes_back_within_one_count(accel_step: int, gyro_step: int) -> None:
    """What is encoded at a range is decoded at that range."""
    motion = Motion((1.0, -2.0, 9.8), (0.1, -0.2, 3.0), 25.0)

    again = decode_motion(
        encode_motion(motion, accel_step, gyro_step), accel_step, gyro_step
    )

    assert again.acceleration == pytest.approx(motion.acceleration, abs=0.006)
    assert again.turn_rate == pytest.approx(motion.turn_rate, abs=0.0011)
    assert again.temperature == pytest.approx(motion.temperature, abs=0.002)


def test_a_motion_beyond_the_range_is_cut_off() -> None:
    """It does not wrap around to the other sign."""
    block = encode_motion(Motion((1000.0, -1000.0, 0.0), (0.0, 0.0, 0.0), 25.0))

    assert block[:4] == b"\x7f\xff\x80\x00"


async def sensor_on(chip: SimMpu6050, **settings: Any) -> Mpu6050:
    """Make a sensor on a bus with one chip."""
    bus = I2CBus(name="body", opener=lambda: ChipBus({0x68: chip}), inline=True)
    await bus.open()
    return Mpu6050(bus=bus, **settings)


async def test_opening_wakes_the_chip_and_sets_its_ranges() -> None:
    """After power-up it sleeps, and measures nothing."""
    world = World()
    chip = SimMpu6050(world)
    chip.step()
    assert chip.read(0x3B, 14) == bytes(14)
    imu = await sensor_on(chip, gyro_range=1000, accel_range=8)

    await imu.open()
    world.step(0.01)
    chip.step()
    motion = await imu.read()

    assert chip.read(PWR_MGMT_1, 1)[0] & 0x40 == 0
    assert chip.read(GYRO_CONFIG, 2) == bytes([2 << 3, 2 << 3])
    assert motion.acceleration[2] == pytest.approx(GRAVITY, abs=0.5)


async def test_a_changed_range_changes_the_scale_too() -> None:
    """The same turn is read the same before and after."""
    world = World()
    chip = SimMpu6050(world)
    imu = await sensor_on(chip)
    await imu.open()
    world.target[:] = [-4.0, 4.0]
    for _ in range(100):
        world.step(0.01)
    chip.step()
    chip.step()
    before = (await imu.read()).turn_rate[2]

    await imu.apply(gyro_range=2000)
    chip.step()

    assert before == pytest.approx(world.turn_rate, abs=0.05)
    assert (await imu.read()).turn_rate[2] == pytest.approx(before, abs=0.05)


@pytest.mark.fault("D05")
async def test_another_chip_at_the_address_is_refused() -> None:
    """WHO_AM_I tells, and the error says what was found."""

    class Other:
        def read(self, register: int, length: int) -> bytes:
            return b"\x71" * length

        def write(self, register: int, data: bytes) -> None:
            raise AssertionError("nothing may be written to a chip that is not known")

    bus = I2CBus(name="body", opener=lambda: ChipBus({0x68: Other()}), inline=True)
    await bus.open()

    with pytest.raises(DeviceFaultError, match="0x71"):
        await Mpu6050(bus=bus).open()


async def test_it_needs_an_i2c_bus_and_one_of_its_addresses() -> None:
    """Both mistakes are named before anything is sent."""
    with pytest.raises(ConfigError, match="I2CBus"):
        await Mpu6050().open()
    with pytest.raises(ConfigError, match="0x69"):
        Mpu6050(address=0x50)


def test_a_reset_puts_the_chip_to_sleep_again() -> None:
    """DEVICE_RESET clears every register but the identity."""
    chip = SimMpu6050(World())
    chip.write(GYRO_CONFIG, b"\x18")
    chip.write(0x75, b"\x00")

    chip.write(PWR_MGMT_1, b"\x80")

    assert chip.read(GYRO_CONFIG, 1) == b"\x00"
    assert chip.read(PWR_MGMT_1, 1) == b"\x40"
    assert chip.read(0x75, 1) == b"\x68"
