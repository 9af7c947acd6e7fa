"""The PCA9685: duties, servos, and sixteen actuators that share a chip."""

from __future__ import annotations

import asyncio
import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.drivers.parts import OnChip

import esair
from esair.drivers.pca9685 import (
    MODE2,
    OUTDRV,
    PwmChannel,
    decode_steps,
    encode_steps,
    frequency_of,
    prescale,
)
from esair.drivers.pca9685.fake import FakePca9685
from esair.drivers.pca9685.servo import PwmServo, ServoPosition
from esair.exceptions import ConfigError, DeviceFaultError, DeviceLostError
from esair.testing import ActuatorContract, FakeI2c


def bus_with(chip: FakePca9685 | None = None) -> FakeI2c:
    return FakeI2c(chips={0x40: chip or FakePca9685()})


class TestPwmChannel(OnChip, ActuatorContract):
    """What every actuator must do."""

    def make(self) -> PwmChannel:
        return PwmChannel(channel=3, bus=bus_with())

    def commands(self) -> list[float]:
        return [0.0, 0.5, 1.0, 1e-9]


class TestPwmServo(OnChip, ActuatorContract):
    """What every actuator must do."""

    def make(self) -> PwmServo:
        return PwmServo(channel=15, bus=bus_with())

    def commands(self) -> list[ServoPosition]:
        return [ServoPosition(math.pi / 4), ServoPosition(-math.pi / 4)]


def test_the_prescaler_is_that_of_the_data_sheet() -> None:
    """Section 7.3.5: 200 Hz is 30; and the ends of what fits into the register."""
    assert prescale(200.0) == 30
    assert (prescale(1526.0), prescale(24.0)) == (3, 253)
    assert frequency_of(30) == pytest.approx(196.9, abs=0.1)


@given(steps=st.integers(-1, 5000))
def test_steps_come_back_from_their_registers(steps: int) -> None:
    """All of the time and none of it have a bit of their own."""
    assert decode_steps(encode_steps(steps)) == max(0, min(4096, steps))


async def actuators_on(chip: FakePca9685, *actuators: Any) -> FakeI2c:
    bus = bus_with(chip)
    await bus.open()
    for actuator in actuators:
        actuator.bus = bus
    await asyncio.gather(*(actuator.open() for actuator in actuators))
    return bus


@pytest.mark.virtual_clock
async def test_a_duty_is_a_part_of_the_period() -> None:
    """What is applied is told, for the chip has 4096 steps."""
    chip = FakePca9685()
    lamp = PwmChannel(channel=7)
    bus = await actuators_on(chip, lamp)

    for command, duty in [(0.5, 0.5), (1.0, 1.0), (0.0, 0.0), (0.1, 410 / 4096)]:
        assert await lamp.write(command) == duty
        assert chip.duty(7) == duty

    assert bus.log[-1].written == bytes([0x06 + 4 * 7, 0, 0, 410 & 0xFF, 410 >> 8])
    assert [chip.duty(each) for each in range(16) if each != 7] == [0.0] * 15


@pytest.mark.virtual_clock
async def test_the_chip_is_set_up_once_for_all_its_channels() -> None:
    """Opening one more, or one again, does not stop those that run."""
    chip = FakePca9685()
    channels = [
        PwmChannel(name=f"lamp_{n}", channel=n, frequency=60.0) for n in range(16)
    ]
    await actuators_on(chip, *channels)
    assert chip.stops == 0
    assert chip.frequency == pytest.approx(60.0, rel=0.01)

    await channels[0].write(0.25)
    await channels[1].write(0.75)
    await channels[1].close()
    await channels[1].open()

    assert chip.stops == 0
    assert chip.duty(0) == 0.25
    assert chip.duty(1) == 0.0  # whatever it was, it is off until a fresh command


@pytest.mark.virtual_clock
@pytest.mark.fault("D04")
async def test_a_chip_that_had_no_power_is_set_up_again() -> None:
    """It comes back asleep, with another frequency, and all channels off."""
    chip = FakePca9685()
    lamp = PwmChannel(channel=0, frequency=1000.0)
    await actuators_on(chip, lamp)
    await lamp.write(0.5)

    chip.power_cycle()
    assert chip.duty(0) == 0.0
    await lamp.open()
    await lamp.write(0.5)

    assert chip.duty(0) == 0.5
    assert chip.frequency == pytest.approx(1000.0, rel=0.02)


@pytest.mark.virtual_clock
async def test_a_chip_that_was_left_inverted_is_set_up_anew() -> None:
    """Awake and at the same frequency; all that is off would be on."""
    chip = FakePca9685()
    lamp = PwmChannel(channel=0)
    await actuators_on(chip, lamp)
    chip.write(MODE2, bytes([OUTDRV | 0x10]))

    await lamp.open()

    assert chip.read(MODE2, 1) == bytes([OUTDRV])


@pytest.mark.virtual_clock
@pytest.mark.promise("RES-4")
async def test_who_wakes_a_chip_hides_no_restart_from_its_others() -> None:
    """It is awake again, and the other channel is off, which was told to be on."""
    chip = FakePca9685()
    lamp, fan = (PwmChannel(name=name, channel=n) for n, name in enumerate("ab"))
    await actuators_on(chip, lamp, fan)
    await fan.write(0.5)
    assert await fan.is_set_up()

    chip.power_cycle()
    assert not await lamp.is_set_up()
    await lamp.open()

    assert await lamp.is_set_up()
    assert not await fan.is_set_up()


@pytest.mark.virtual_clock
async def test_a_chip_has_one_frequency() -> None:
    """The second actuator that wants another is refused, and says whose the first is."""
    chip = FakePca9685()
    servo = PwmServo(name="servo", channel=0)
    lamp = PwmChannel(name="lamp", channel=1, frequency=1000.0)
    bus = await actuators_on(chip, servo)
    lamp.bus = bus

    with pytest.raises(ConfigError, match=r"lamp: frequency: expected 50 Hz .*'servo'"):
        await lamp.open()
    assert chip.frequency == pytest.approx(50.0, rel=0.01)

    await servo.close()
    await lamp.open()
    assert chip.frequency == pytest.approx(1000.0, rel=0.02)


@pytest.mark.virtual_clock
async def test_a_channel_has_one_actuator() -> None:
    """Another one gets it only when the first has let it go."""
    first, second = (PwmChannel(name=name, channel=4) for name in ("first", "second"))
    bus = await actuators_on(FakePca9685(), first)
    second.bus = bus

    with pytest.raises(ConfigError, match=r"channel 4 .* is 'first' already"):
        await second.open()

    await first.close()
    await second.open()


@pytest.mark.virtual_clock
async def test_a_servo_gets_its_pulses() -> None:
    """The angle decides their length; without power there are none."""
    chip = FakePca9685()
    servo = PwmServo(
        channel=0, min_angle=-1.0, max_angle=1.0, min_pulse=0.0005, max_pulse=0.0025
    )
    turned = PwmServo(name="turned", channel=1, min_angle=0.5, max_angle=-0.5)
    await actuators_on(chip, servo, turned)

    for angle, pulse in [(-1.0, 0.0005), (0.0, 0.0015), (1.0, 0.0025), (0.5, 0.002)]:
        told = await servo.write(ServoPosition(angle))
        assert told is not None
        assert servo.pulse(told.angle) == pytest.approx(chip.pulse(0))
        assert chip.pulse(0) == pytest.approx(pulse, abs=0.00001)
        assert 0.0005 <= chip.pulse(0) <= 0.0025
    await turned.write(ServoPosition(0.5))
    assert chip.pulse(1) == pytest.approx(0.001, abs=0.00001)

    await servo.write(servo.safe)
    assert chip.pulse(0) == 0.0
    assert turned.limits == {"angle": (-0.5, 0.5)}


@pytest.mark.promise("ROB-2")
@pytest.mark.fault("D01", "D04")
async def test_a_servo_lets_go_at_every_end(fake_i2c) -> None:
    """When nobody writes, after a loss of the bus until a fresh command, and at the stop."""
    chip = FakePca9685()
    bus = fake_i2c(chips={0x40: chip})
    servo = PwmServo(name="arm", channel=2, bus=bus)
    user = esair.Behavior(
        name="user", reads={}, writes={"arm": esair.writes(ServoPosition)}
    )

    async with esair.Robot(resources=[servo], behaviors=[user]):
        assert chip.pulse(2) == 0.0
        await user.arm.write(ServoPosition(0.0))
        assert chip.pulse(2) == pytest.approx(0.0015, abs=0.00001)
        await asyncio.sleep(0.5)
        assert chip.pulse(2) == 0.0

        await user.arm.write(ServoPosition(0.1))
        bus.unplug()
        await asyncio.sleep(1.0)
        bus.plug()
        await asyncio.sleep(5.0)
        assert chip.pulse(2) == 0.0
        await user.arm.write(ServoPosition(0.1))
        assert chip.pulse(2) > 0.0

    assert chip.pulse(2) == 0.0


@pytest.mark.virtual_clock
@pytest.mark.fault("D05")
async def test_another_chip_at_the_address_is_refused() -> None:
    """One that does not keep its frequency is none."""
    bus = FakeI2c(chips={0x40: ReadOnly()})
    await bus.open()

    with pytest.raises(DeviceFaultError, match="no PCA9685 at 0x40"):
        await PwmChannel(channel=0, bus=bus).open()


class ReadOnly:
    """A chip that takes nothing."""

    def read(self, register: int, length: int) -> bytes:
        return bytes(length)

    def write(self, register: int, data: bytes) -> None:
        """Ignore it."""


def test_a_fake_locks_its_frequency_while_it_runs() -> None:
    """As the chip does: it has to sleep first, and that stops every channel."""
    chip = FakePca9685()
    chip.write(0x00, b"\x20")
    chip.write(0x06, encode_steps(2048))
    chip.write(0xFE, b"\x05")
    assert chip.frequency == pytest.approx(196.9, abs=0.1)
    assert chip.duty(0) == 0.5

    chip.write(0x00, b"\x30")
    chip.write(0xFE, b"\x05")
    assert chip.stops == 1
    assert chip.duty(0) == 0.0
    chip.write(0x00, b"\xa0")
    assert chip.frequency == pytest.approx(1017.3, abs=0.1)
    chip.write(0xFA, encode_steps(1024))
    assert [chip.duty(each) for each in range(16)] == [0.25] * 16


@pytest.mark.virtual_clock
async def test_what_was_never_opened_closes() -> None:
    """Also without a bus: it has claimed no channel."""
    await PwmChannel(channel=0).close()


@pytest.mark.virtual_clock
@pytest.mark.promise("RES-4")
async def test_a_write_into_a_chip_that_has_restarted_is_not_done() -> None:
    """Asleep it takes every command, and does none of them."""
    bus = bus_with()
    pwm = PwmChannel(channel=3, bus=bus)
    await bus.open()
    await pwm.open()
    assert await pwm.write(0.5) == 0.5
    bus.chips[0x40].power_cycle()  # type: ignore[union-attr]
    for _ in range(3):
        with pytest.raises(DeviceLostError, match="it has restarted"):
            await pwm.write(0.5)
    await pwm.open()
    assert await pwm.write(0.5) == 0.5
    await bus.close()
