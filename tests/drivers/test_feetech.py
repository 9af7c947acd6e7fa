"""Servos of Feetech: the same devices as for Dynamixel, on another bus."""

from __future__ import annotations

import asyncio
import contextlib
import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.drivers.parts import OnServos
from tests.drivers.test_servo import Captured

from esair.buses import Wire
from esair.drivers.servo import Goal, Mode, Servo, ServoPosition, to_angle
from esair.drivers.servo._bus import Entry
from esair.drivers.servo.fake import SYNC_READ, SYNC_WRITE
from esair.drivers.servo.fake_feetech import FakeFeetechServos
from esair.drivers.servo.feetech import FeetechBus
from esair.drivers.servo.turning import ServoCurrent, ServoVelocity
from esair.exceptions import ConfigError, DeviceFaultError
from esair.testing import ActuatorContract, BusContract, SensorContract

pytestmark = pytest.mark.virtual_clock

RELEASE = Goal(mode=Mode.RELEASE)


class OnLine(OnServos):
    def make_bus(self) -> FeetechBus:
        self.fakes = FakeFeetechServos([1, 2])
        return FeetechBus(name="arm", wire=self.fakes)


class TestFeetechBus(OnLine, BusContract):
    def make(self) -> FeetechBus:
        return self.make_bus()

    async def use(self, bus: Any) -> None:
        assert await bus.ping(1) == 777

    async def ask(self, bus: Any, number: int) -> int:
        self.fakes.feetech[1].table[:62] = bytes(range(62))
        with contextlib.suppress(DeviceFaultError):
            return int(await bus.read(1, number, 1))
        return number  # it was told that there was no answer

    async def delay(self, bus: Any, seconds: float) -> None:
        self.fakes.delay = 0.2 * seconds


class TestPosition(OnLine, SensorContract):
    keeps_nothing = "each request says all that the servo needs"

    def make(self) -> ServoPosition:
        return ServoPosition(id=2, bus=self.make_bus())


class TestFeetechServo(OnLine, ActuatorContract):
    def make(self) -> Any:
        bus = self.make_bus()
        return Servo(id=2, safe=RELEASE, limits=(-1.0, 1.0), speed=1.0, bus=bus)

    def commands(self) -> list[Any]:
        return [Goal(0.5), Goal(-1.0), Goal(mode=Mode.HOLD), RELEASE]


class TestFeetechVelocity(OnLine, ActuatorContract):
    def make(self) -> Any:
        return ServoVelocity(id=2, bus=self.make_bus())

    def commands(self) -> list[Any]:
        return [1.0, -5.0]

    async def power_cycle(self, device: Any) -> None:
        await device.write(1.0)
        self.fakes.feetech[2].power_cycle()


class TestFeetechCurrent(OnLine, ActuatorContract):
    """Of the HLS series, which has that mode."""

    def make(self) -> Any:
        self.fakes = FakeFeetechServos([1, 2])
        bus = FeetechBus(name="arm", series="hls", wire=self.fakes)
        return ServoCurrent(id=2, bus=bus)

    def commands(self) -> list[Any]:
        return [0.1, -0.5]

    async def power_cycle(self, device: Any) -> None:
        await device.write(0.1)
        self.fakes.power_cycle()


async def test_a_goal_beyond_its_own_limits_is_cut_off() -> None:
    """It would stop there without a word; what it was told instead is returned."""
    fakes = FakeFeetechServos([1])
    elbow = Servo(safe=RELEASE, bus=FeetechBus(name="arm", wire=fakes))
    fakes.feetech[1].put(11, 3000)
    await elbow.bus.open()
    await elbow.open()

    assert await elbow.write(Goal(0.5)) is None
    assert await elbow.write(Goal(2.5)) == Goal(to_angle(3000))
    assert await elbow.bus.read(1, 56, 2) == 3000


async def test_a_current_is_in_its_units_with_a_bit_for_its_sign() -> None:
    """6.5 mA each, in mode 2; STS has no such mode, and says so at once."""
    fakes = FakeFeetechServos([1])
    bus = FeetechBus(name="arm", series="hls", wire=fakes)
    grip = ServoCurrent(name="grip", bus=bus)
    await bus.open()
    await grip.open()
    await grip.write(-0.065)
    assert fakes.feetech[1].table[33] == 2
    assert fakes.feetech[1].get(44) == 0x8000 | 10
    assert fakes.feetech[1].torque
    await bus.close()

    with pytest.raises(ConfigError, match="no current mode"):
        ServoCurrent(bus=FeetechBus(name="arm", wire=fakes))
    with pytest.raises(ConfigError, match="series: expected 'sts' or 'hls'"):
        FeetechBus(name="arm", series="scs", wire=fakes)  # type: ignore[arg-type]


async def test_no_limit_of_the_speed_is_another_number_for_each_series() -> None:
    """0 would stop those of HLS."""
    for series, units in (("sts", 0), ("hls", 0x7FFF)):
        fakes = FakeFeetechServos([1])
        bus = FeetechBus(name="arm", series=series, wire=fakes)  # type: ignore[arg-type]
        servo = Servo(safe=RELEASE, bus=bus)
        await bus.open()
        await servo.apply(speed=0.0)
        assert fakes.feetech[1].get(46) == units
        await bus.close()


async def test_goals_and_places_are_those_of_its_table() -> None:
    """4096 steps a turn, two bytes, the middle at 2048; several as one request."""
    fakes = FakeFeetechServos([1, 2])
    bus = FeetechBus(name="arm", wire=fakes)
    servos = [Servo(name=f"s{n}", id=n, safe=RELEASE, bus=bus) for n in (1, 2)]
    places = [ServoPosition(name=f"p{n}", id=n, bus=bus) for n in (1, 2)]
    await bus.open()
    for each in servos:
        await each.open()
        await each.write(Goal(0.0))
    fakes.written.clear()
    await asyncio.gather(*(each.write(Goal(math.pi / 2)) for each in servos))
    found = await asyncio.gather(*(each.read() for each in places))

    assert fakes.feetech[1].get(42) == 3072
    assert found == pytest.approx([math.pi / 2] * 2)
    assert [kind for _, kind, _ in fakes.written] == [SYNC_READ, SYNC_WRITE, SYNC_READ]
    await bus.close()


async def test_it_turns_both_ways_and_its_mode_is_unlocked() -> None:
    """Backwards is a sign, not a complement; the mode is locked again."""
    fakes = FakeFeetechServos([1])
    bus = FeetechBus(name="arm", wire=fakes)
    wheel = ServoVelocity(id=1, bus=bus)
    await bus.open()
    await wheel.open()
    assert (fakes.feetech[1].table[33], fakes.feetech[1].table[55]) == (1, 1)
    await wheel.write(-math.tau / 4)
    assert fakes.feetech[1].get(46) == 0x8000 | 1024
    assert fakes.feetech[1].torque
    for frame in wheel.safe_frames().frames:
        fakes.heard(frame)
    assert fakes.feetech[1].get(46) == 0
    await bus.close()


async def test_what_is_wrong_with_it_is_told() -> None:
    """Each answer says it, by bits."""
    fakes = FakeFeetechServos([1])
    bus = FeetechBus(name="arm", wire=fakes)
    await bus.open()
    fakes.feetech[1].faults = 0x24
    with pytest.raises(DeviceFaultError, match="overheating, overload"):
        await bus.read(1, 56, 2)
    await bus.close()


def test_the_packets_are_those_of_the_makers_package() -> None:
    """Id, length, instruction, parameters, the inverted sum."""
    sdk = pytest.importorskip("scservo_sdk", reason="its SDK is not installed")
    port = Captured()
    sdk.PacketHandler(0).syncWriteTxOnly(port, 42, 2, [7, 1, 8], 3)
    assert port.written == FeetechBus(name="arm", wire=Wire()).packet(7, 42, 0x801, 2)


@given(st.integers(-32767, 32767), st.booleans(), st.sampled_from([2, 4]))
def test_a_number_goes_there_and_back(number: int, sign: bool, size: int) -> None:
    """With a sign bit and as a two's complement."""
    entry = Entry(0, size, sign)
    assert entry.unpack(entry.pack(number)) == number
