"""What shipped drivers declare for the watchdog is what their safe command sends."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import esair
from esair.buses.can import Frame
from esair.drivers.canopen import CanopenActuator
from esair.drivers.dbc import DbcActuator
from esair.drivers.gpio import DigitalOutput
from esair.drivers.line import LineActuator
from esair.drivers.modbus import ModbusActuator
from esair.drivers.odrive import OdriveAxis
from esair.drivers.pca9685 import PwmChannel
from esair.drivers.pca9685.fake import FakePca9685
from esair.drivers.servo import Goal, Mode, Servo, ServoBus
from esair.drivers.servo.fake import FakeServos
from esair.drivers.servo.fake_feetech import FakeFeetechServos
from esair.drivers.servo.feetech import FeetechBus
from esair.testing import FakeCan, FakeI2c, FakeSerial
from esair.watchdog import can_frame

pytestmark = [pytest.mark.virtual_clock, pytest.mark.promise("GRD-2")]

DRIVERS = Path(__file__).parents[1] / "drivers"


def as_bytes(frame: Frame) -> bytes:
    return can_frame(frame.id, frame.data, extended=frame.extended)


async def told(actuator: esair.Actuator[Any]) -> None:
    """Open a driver, and have it send its safe command alone."""
    if actuator.bus is not None:
        await actuator.bus.open()
    opened: Any = actuator.open()
    if opened is not None:
        await opened


async def test_a_message_of_a_dbc_file() -> None:
    """The frame with the safe values, for each number that the node may expect."""
    bus = FakeCan("drive")
    wheels = DbcActuator(
        bus=bus,
        database=DRIVERS / "rover.dbc",
        message="WheelCommand",
        safe={"left": 0.0, "right": 0.0},
        fixed={"gear": "low"},
        sequence="count",
    )
    await told(wheels)
    frames = wheels.safe_frames().frames
    bus.sent.clear()
    for _ in frames:
        await wheels.write(wheels.safe)
    await asyncio.sleep(0.1)
    assert len(frames) > 3
    assert list(map(as_bytes, bus.sent)) == list(frames)
    await bus.close()


async def test_an_axis_of_an_odrive() -> None:
    """The safe input, and no power if that is asked for."""
    bus = FakeCan("drive")
    axis = OdriveAxis(bus=bus, node=3, idle=True)
    await bus.open()
    await axis.write(0.0)
    await asyncio.sleep(0.1)
    assert list(map(as_bytes, bus.sent)) == list(axis.safe_frames().frames)
    await bus.close()


async def test_a_number_on_a_line() -> None:
    """The line with the safe number, after what ends one that was cut."""
    bus = FakeSerial("front")
    motor = LineActuator(bus=bus, safe=0.0, key="speed")
    await bus.open()
    await motor.write(0.0)
    heard = await bus.until(lambda message: message.startswith(b"speed"))
    frames = motor.safe_frames()
    assert frames.resync == b"\n"
    assert frames.frames == (bus.framing.encode(heard),)
    await bus.close()


async def test_a_channel_of_a_pca9685() -> None:
    """The registers of the channel, off."""
    bus = FakeI2c(chips={0x40: FakePca9685()})
    channel = PwmChannel(bus=bus, channel=3)
    await told(channel)
    await channel.write(0.0)
    frames = channel.safe_frames()
    assert frames is not None
    assert frames.address == 0x40
    assert bus.log[-1].written == frames.frames[0]
    await bus.close()


@pytest.mark.parametrize("make", [ServoBus, FeetechBus])
def test_a_servo_that_lets_go(make: Any) -> None:
    """Nobody answers: that would hit the packet of the next servo on their one wire."""
    fakes: Any = (FakeServos if make is ServoBus else FakeFeetechServos)([1])
    bus = make(name="arm", wire=fakes)
    fakes.heard(bus.packet(1, bus.table.torque, 1))
    far = fakes.servos[1] if make is ServoBus else fakes.feetech[1]
    assert far.torque
    frames = Servo(bus=bus, safe=Goal(mode=Mode.RELEASE)).safe_frames()
    assert frames is not None
    assert fakes.heard(frames.frames[0]) == b""
    assert not far.torque


def strictly(data: bytes) -> Iterator[bytes]:
    """Yield packets as a servo takes them that looks at no byte twice."""
    while (begin := data.find(b"\xff\xff\xfd\0")) >= 0:
        length = int.from_bytes(data[begin + 5 : begin + 7], "little")
        end = begin + 7 + (length if length < 1024 else 0)
        yield data[begin:end]
        data = data[end:]


@pytest.mark.promise("GRD-2")
@pytest.mark.parametrize("left", range(1, 16))
def test_a_packet_that_was_cut_in_half_takes_no_safe_one_with_it(left: int) -> None:
    """The servo takes the next bytes for its rest, whoever sends them."""
    bus = ServoBus(name="arm", wire=FakeServos([1]))
    frames = Servo(bus=bus, safe=Goal(mode=Mode.RELEASE)).safe_frames()
    assert frames is not None
    motion = bus.packet(1, 116, 3000, 4)
    sent = motion[:left] + b"".join(frames.frames * frames.repeat)
    assert frames.frames[0] in strictly(sent)


def test_a_register_of_a_modbus_unit() -> None:
    """On a serial line silence ends a message: as long as a frame takes, and more."""
    bus = FakeSerial("plc", framing="modbus-rtu", baudrate=9600)
    valve = ModbusActuator(bus=bus, register=3, safe=0.0)
    frames = valve.safe_frames()
    assert frames.frames == (bytes.fromhex("010600030000") + b"\x79\xca",)
    assert frames.repeat == 3
    assert frames.gap > (8 + 3.5) * 10 / 9600


def test_a_servo_that_has_to_hold_is_not_watched() -> None:
    """Its place must be asked first."""
    bus = ServoBus(name="arm", wire=FakeServos([1]))
    assert Servo(bus=bus, safe=Goal(mode=Mode.HOLD)).safe_frames() is None


@pytest.mark.parametrize("safe", [False, True])
def test_a_digital_line(safe: bool) -> None:
    """Values and mask of its only line, as the kernel takes them."""
    line = DigitalOutput(chip="gpiochip0", line=4, safe=safe, name="lamp")
    assert line.safe_frames().frames == (bytes([safe]) + bytes(7) + b"\1" + bytes(7),)


def test_an_object_of_a_canopen_node() -> None:
    """An abort of what was cut, then an expedited download."""
    brake = CanopenActuator(
        bus=FakeCan("drive"),
        node=5,
        eds=DRIVERS / "motor.eds",
        object="Target velocity",
        safe=0,
    )
    frames = brake.safe_frames()
    assert frames is not None
    abort, download = frames.frames
    assert abort[:5] == b"\x05\x06\0\0\x08"
    assert abort[8] == 0x80
    assert download[8:12] == bytes([0x23]) + b"\xff\x60\0"
