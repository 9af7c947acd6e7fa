"""The MPU-6050: registers to SI units, and what it is told at its opening."""

from __future__ import annotations

import asyncio
import math
from typing import Any

import pytest
from tests.drivers.parts import OnChip

from esair.drivers.mpu6050 import (
    GRAVITY,
    GYRO_CONFIG,
    PWR_MGMT_1,
    SMPLRT_DIV,
    Motion,
    Mpu6050,
    decode_motion,
    encode_motion,
)
from esair.drivers.mpu6050.fake import AT_REST, FakeMpu6050
from esair.exceptions import DeviceFaultError, DeviceLostError
from esair.testing import FakeI2c, SensorContract


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


async def sensor_on(chip: FakeMpu6050, **settings: Any) -> Mpu6050:
    """Make a sensor on a bus with one chip."""
    bus = FakeI2c(chips={0x68: chip})
    await bus.open()
    return Mpu6050(bus=bus, **settings)


class TestMpu6050(OnChip, SensorContract):
    """What every sensor must do."""

    def make(self) -> Mpu6050:
        return Mpu6050(bus=FakeI2c(chips={0x68: FakeMpu6050()}))


@pytest.mark.virtual_clock
async def test_opening_wakes_the_chip_and_sets_its_ranges() -> None:
    """After power-up it sleeps, and measures nothing."""
    chip = FakeMpu6050()
    assert chip.asleep
    assert chip.read(0x3B, 14) == bytes(14)
    imu = await sensor_on(chip, gyro_range=1000, accel_range=8)

    await imu.open()
    motion = await imu.read()

    assert chip.read(PWR_MGMT_1, 1)[0] & 0x40 == 0
    assert chip.read(GYRO_CONFIG, 2) == bytes([2 << 3, 2 << 3])
    assert motion.acceleration[2] == pytest.approx(GRAVITY, abs=0.003)


@pytest.mark.virtual_clock
async def test_what_another_program_has_left_in_the_chip_is_gone() -> None:
    """Its axes rest, or it samples four times a second: readings would be old."""
    chip = FakeMpu6050()
    chip.write(SMPLRT_DIV, b"\xff\x06")
    chip.write(PWR_MGMT_1, b"\x01\x3f")
    imu = await sensor_on(chip)

    await imu.open()

    assert chip.read(SMPLRT_DIV, 2) == bytes(2)
    assert chip.read(PWR_MGMT_1, 2) == b"\x01\x00"


@pytest.mark.virtual_clock
async def test_a_changed_range_changes_the_scale_too() -> None:
    """The same motion is read the same before and after."""
    felt = Motion((1.0, -2.0, 9.5), (0.5, -1.0, 2.0), 30.0)
    imu = await sensor_on(FakeMpu6050(felt))
    await imu.open()
    before = await imu.read()

    await imu.apply(gyro_range=2000, accel_range=16)
    after = await imu.read()

    assert before.turn_rate == pytest.approx(felt.turn_rate, abs=0.001)
    assert after.turn_rate == pytest.approx(felt.turn_rate, abs=0.002)
    assert after.acceleration == pytest.approx(felt.acceleration, abs=0.003)


class Slow(FakeMpu6050):
    """Measures once a millisecond, as the chip does, and not when it is told a range."""

    def _measure(self) -> None:
        asyncio.get_running_loop().call_later(0.001, super()._measure)


@pytest.mark.virtual_clock
@pytest.mark.promise("RS-4")
async def test_no_sample_of_one_range_is_read_in_another() -> None:
    """Who reads while the range changes waits until there is a new sample."""
    imu = await sensor_on(Slow())
    await imu.open()

    for accel_range in (16, 2):
        change = asyncio.create_task(imu.apply(accel_range=accel_range))
        await asyncio.sleep(0)
        motion = await imu.read()
        assert motion.acceleration[2] == pytest.approx(GRAVITY, abs=0.003)
        await change


@pytest.mark.virtual_clock
async def test_a_chip_that_has_lost_its_power_is_lost() -> None:
    """It sleeps and gives zeros, which would look like free fall at rest."""
    chip = FakeMpu6050()
    imu = await sensor_on(chip)
    await imu.open()
    await imu.read()

    chip.write(PWR_MGMT_1, b"\x80")
    with pytest.raises(DeviceLostError, match="lost its power"):
        await imu.read()

    await imu.open()
    assert (await imu.read()).temperature == pytest.approx(25.0, abs=0.01)


@pytest.mark.virtual_clock
async def test_a_wire_that_nobody_pulls_down_is_no_motion(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The chip went amid the transfer: -1 on each axis would look like free fall, too."""
    chip = FakeMpu6050()
    imu = await sensor_on(chip)
    await imu.open()
    monkeypatch.setattr(chip, "read", lambda _register, length: b"\xff" * length)
    with pytest.raises(DeviceLostError, match="every byte is 0xff"):
        await imu.read()


@pytest.mark.virtual_clock
@pytest.mark.fault("D05")
async def test_another_chip_at_the_address_is_refused() -> None:
    """WHO_AM_I tells, the error says what was found, and nothing is written to it."""
    bus = FakeI2c(chips={0x68: {0x75: 0x71}})
    await bus.open()

    with pytest.raises(DeviceFaultError, match="0x71"):
        await Mpu6050(bus=bus).open()

    assert [each.written for each in bus.log] == [b"\x75"]


def test_a_reset_puts_the_chip_to_sleep_again() -> None:
    """DEVICE_RESET clears every register but the identity."""
    chip = FakeMpu6050()
    chip.write(GYRO_CONFIG, b"\x18")
    chip.write(0x75, b"\x00")

    chip.write(PWR_MGMT_1, b"\x80")

    assert chip.read(GYRO_CONFIG, 1) == b"\x00"
    assert chip.read(PWR_MGMT_1, 1) == b"\x40"
    assert chip.read(0x75, 1) == b"\x68"


def test_a_fake_that_is_awake_measures_what_it_is_told() -> None:
    """And at the range that it is set to."""
    chip = FakeMpu6050()
    chip.write(PWR_MGMT_1, b"\x01")
    assert decode_motion(chip.read(0x3B, 14)).acceleration[2] == pytest.approx(GRAVITY)

    chip.write(GYRO_CONFIG, b"\x18\x18")
    chip.motion = Motion((50.0, 0.0, 0.0), (20.0, 0.0, 0.0), 25.0)

    motion = decode_motion(chip.read(0x3B, 14), 3, 3)
    assert motion.acceleration[0] == pytest.approx(50.0, abs=0.01)
    assert motion.turn_rate[0] == pytest.approx(20.0, abs=0.01)
    assert chip.motion is not AT_REST
