"""An ODrive axis: its frames, when it is armed, and how it is lost."""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.drivers.parts import OnCan

import esair
from esair.drivers.odrive import (
    AxisError,
    AxisReading,
    AxisState,
    ControlMode,
    FrameError,
    Heartbeat,
    Message,
    OdriveAxis,
    OdriveState,
    decode,
    decode_estimates,
    decode_heartbeat,
    decode_input,
    encode,
    encode_estimates,
    encode_heartbeat,
    encode_input,
    encode_mode,
    frame_id,
)
from esair.drivers.odrive.fake import FakeOdrive
from esair.exceptions import BadValueError, DeviceFaultError, DeviceLostError
from esair.testing import ActuatorContract, FakeCan, SensorContract

pytestmark = pytest.mark.virtual_clock

CLOSED_LOOP, IDLE = AxisState.CLOSED_LOOP_CONTROL, AxisState.IDLE


class Wired(OnCan):
    def axis_on_bus(self) -> Any:
        self.far = FakeOdrive(self.wire, node=3)
        return self.wire

    async def silence(self, _device: Any) -> None:
        self.far.stop()

    async def speak(self, _device: Any) -> None:
        self.far.start()


class TestAxis(Wired, ActuatorContract):
    def make(self) -> OdriveAxis:
        return OdriveAxis(node=3, bus=self.axis_on_bus())

    def commands(self) -> list[Any]:
        return [1.0, -20.0]


class TestAxisThatIdles(Wired, ActuatorContract):
    def make(self) -> OdriveAxis:
        return OdriveAxis(node=3, control="torque", idle=True, bus=self.axis_on_bus())

    def commands(self) -> list[Any]:
        return [0.1, -0.1]


class TestPosition(Wired, ActuatorContract):
    def make(self) -> OdriveAxis:
        return OdriveAxis(node=3, control="position", safe=1.0, bus=self.axis_on_bus())

    def commands(self) -> list[Any]:
        return [0.0, 100.0]


class TestPositionThatStays(Wired, ActuatorContract):
    def make(self) -> OdriveAxis:
        return OdriveAxis(node=3, control="position", bus=self.axis_on_bus())

    def commands(self) -> list[Any]:
        return [0.0, 100.0]


class TestState(Wired, SensorContract):
    keeps_nothing = "it is told nothing"

    def make(self) -> OdriveState:
        return OdriveState(node=3, bus=self.axis_on_bus())


def test_the_frames_are_those_of_the_document() -> None:
    """Little-endian, in turns; the node id is above the five bits of the message."""
    assert frame_id(3, Message.SET_INPUT_VEL) == 0x6D
    assert encode_input(ControlMode.VELOCITY, 2 * math.pi) == (
        Message.SET_INPUT_VEL,
        bytes.fromhex("0000803f00000000"),
    )
    assert encode_input(ControlMode.POSITION, -math.pi) == (
        Message.SET_INPUT_POS,
        bytes.fromhex("000000bf00000000"),
    )
    assert encode_input(ControlMode.TORQUE, 0.5) == (
        Message.SET_INPUT_TORQUE,
        bytes.fromhex("0000003f"),
    )
    assert encode(Message.SET_AXIS_STATE, CLOSED_LOOP) == bytes.fromhex("08000000")
    assert encode_mode(ControlMode.VELOCITY) == bytes.fromhex("0200000001000000")
    assert decode_heartbeat(bytes.fromhex("0002000108000100")) == Heartbeat(
        0x01000200, CLOSED_LOOP, 0, True
    )
    assert decode_heartbeat(bytes.fromhex("0002000108000100")).error_names == (
        "DC_BUS_UNDER_VOLTAGE",
        "WATCHDOG_TIMER_EXPIRED",
    )
    assert Heartbeat(1 << 29, IDLE).error_names == ("0x20000000",)


@given(st.binary(max_size=8), st.floats(-1e4, 1e4), st.floats(-1e4, 1e4))
def test_what_is_packed_is_unpacked_and_no_bytes_break_it(
    data: bytes, one: float, other: float
) -> None:
    """Within the resolution of single floats; too few bytes are a FrameError only."""
    assert decode_estimates(encode_estimates(one, other)) == pytest.approx(
        (one, other), rel=1e-6
    )
    for mode in ControlMode:
        assert decode_input(*encode_input(mode, one)) == pytest.approx(one, rel=1e-6)
        assert decode(Message.SET_CONTROLLER_MODE, encode_mode(mode)) == (mode, 1)
    for message in (Message.HEARTBEAT, Message.SET_AXIS_STATE, Message.SET_INPUT_POS):
        try:
            decode(message, data)
        except FrameError:
            assert len(data) < 8
    known = decode_heartbeat(encode_heartbeat(Heartbeat(5, IDLE, 2, True)))
    assert known == Heartbeat(5, IDLE, 2, True)


def robot_with(axis: OdriveAxis) -> esair.Robot:
    policy = esair.Policy(axis.name, allow={"me": esair.Access.WRITE})
    return esair.Robot(resources=[axis], policies=[policy])


def state_of(robot: esair.Robot) -> esair.ResourceState:
    return robot.resources.query("odrive_axis").state


@pytest.fixture
def rig(fake_can: Callable[..., Any]) -> Callable[..., Any]:
    """Put an axis on a bus: the wire, the fake, the driver."""

    def make(**keywords: Any) -> tuple[Any, FakeOdrive, OdriveAxis]:
        wire = fake_can("drive")
        fake = FakeOdrive(wire, watchdog=keywords.pop("watchdog", None))
        return wire, fake, OdriveAxis(node=0, bus=wire, **keywords)

    return make


async def write(robot: esair.Robot, command: float) -> None:
    right = await robot.resources.register("me", "odrive_axis", esair.Access.WRITE)
    await robot.actuators.write(right, command)
    await asyncio.sleep(0.001)  # until the frames have arrived


@pytest.mark.parametrize("control", ["velocity", "position", "torque"])
async def test_its_watchdog_is_fed_at_rest_and_not_in_motion(
    rig: Any, control: str
) -> None:
    """It would disarm the axis and be an error, each time that nobody moves it."""
    _, fake, axis = rig(watchdog=0.25, control=control)
    axis.own_timeout = 0.25
    async with robot_with(axis) as robot:
        await write(robot, 1.0)
        await asyncio.sleep(5.0)
        assert (fake.is_armed, fake.errors) == (True, 0)
        assert robot.resources.query("odrive_axis").losses == 0

        before = len(fake.inputs)
        await write(robot, 2.0)
        await asyncio.sleep(0.15)
        assert fake.inputs[before:] == pytest.approx([2.0])


async def test_a_beat_that_waits_behind_an_estimate_is_in_time(fake_can: Any) -> None:
    """The event loop was held up until the next beat was due."""
    wire = fake_can("drive")
    state = OdriveState(node=0, heartbeat_timeout=0.5, bus=wire)
    beat = frame_id(0, Message.HEARTBEAT), encode_heartbeat(Heartbeat(0, IDLE))
    await wire.open()
    values: Any = state.stream()
    reading = asyncio.ensure_future(anext(values))
    await asyncio.sleep(0)
    wire.feed(*beat)
    await asyncio.sleep(0.5)
    for id_, data in (
        (frame_id(0, Message.GET_ENCODER_ESTIMATES), encode_estimates(1.0, 2.0)),
        beat,
    ):
        wire.feed(id_, data)

    assert (await reading).position == pytest.approx(1.0)

    await values.aclose()
    await wire.close()


async def test_only_a_command_that_is_not_safe_arms_it(rig: Any) -> None:
    """Neither its opening nor the safe command does."""
    _, fake, axis = rig()
    async with robot_with(axis) as robot:
        await asyncio.sleep(1.0)
        assert fake.mode is ControlMode.VELOCITY
        await write(robot, 0.0)
        assert fake.requests == []
        assert set(fake.inputs) == {0.0}

        await write(robot, 3.0)
        assert fake.requests == [CLOSED_LOOP]
        assert fake.velocity == pytest.approx(3.0)
        await write(robot, 4.0)
        assert fake.requests == [CLOSED_LOOP], "once is enough"
        await asyncio.sleep(0.5)
        assert fake.velocity == 0.0, "nobody wrote for command_timeout"
        assert fake.is_armed
    assert fake.inputs[-1] == 0.0


async def test_idle_takes_its_power_with_the_safe_command(rig: Any) -> None:
    """And the next command arms it again."""
    _, fake, axis = rig(idle=True)
    async with robot_with(axis) as robot:
        await write(robot, 3.0)
        await asyncio.sleep(0.5)
        assert fake.state is IDLE
        assert fake.inputs[-1] == 0.0
        await write(robot, 2.0)
        assert fake.velocity == pytest.approx(2.0)
    assert fake.state is IDLE


async def test_an_arming_that_found_no_room_is_tried_with_the_next_command(
    rig: Any,
) -> None:
    """It is no fault of the axis."""
    wire, fake, axis = rig()
    async with robot_with(axis) as robot:
        wire.full(1000)
        with pytest.raises(OSError, match=r"no frame was sent|did not return"):
            await write(robot, 3.0)
        wire.full(0)
        assert not axis.is_armed

        await write(robot, 3.0)
        assert fake.requests == [CLOSED_LOOP]
        assert fake.velocity == pytest.approx(3.0)
        await asyncio.sleep(1.0)
        assert state_of(robot) is esair.ResourceState.READY


async def test_one_that_was_left_armed_gets_its_safe_command_first(rig: Any) -> None:
    """The program before this one was killed while the motor turned."""
    _, fake, axis = rig()
    fake.state, fake.velocity = CLOSED_LOOP, 5.0
    async with robot_with(axis) as robot:
        await asyncio.sleep(0.2)
        assert state_of(robot) is esair.ResourceState.READY
        assert fake.velocity == 0.0
        assert fake.requests == []


async def test_an_error_is_told_by_name_at_once(
    rig: Any, caplog: pytest.LogCaptureFixture
) -> None:
    """It is opened again, cleared, and not armed until a fresh command."""
    _, fake, axis = rig()
    async with robot_with(axis) as robot:
        await write(robot, 3.0)
        await asyncio.sleep(0.15)
        fake.fail(AxisError.SPINOUT_DETECTED | AxisError.DRV_FAULT)
        await asyncio.sleep(0.1)
        assert "DRV_FAULT, SPINOUT_DETECTED" in caplog.text

        await asyncio.sleep(2.0)
        assert state_of(robot) is esair.ResourceState.READY
        assert fake.cleared == 1
        assert not fake.is_armed
        assert fake.requests == [CLOSED_LOOP]
        await write(robot, 1.0)
        assert fake.is_armed


async def test_errors_that_remain_are_a_fault(rig: Any) -> None:
    """The restart budget decides how often it is tried."""
    _, fake, axis = rig()
    fake.fail(AxisError.BAD_CONFIG, permanent=True)
    await axis.bus.open()
    with pytest.raises(DeviceFaultError, match="errors remain: BAD_CONFIG"):
        await axis.open()
    await axis.bus.close()

    async with robot_with(axis) as robot:
        await asyncio.sleep(30.0)
        assert state_of(robot) is esair.ResourceState.FAILED


@pytest.mark.parametrize("how", ["refuses", "leaves"])
async def test_closed_loop_that_does_not_come_or_stay_is_a_fault(
    rig: Any, how: str, caplog: pytest.LogCaptureFixture
) -> None:
    """Whoever moves it must not believe that it moves."""
    _, fake, axis = rig()
    fake.refuses_to_arm = how == "refuses"
    async with robot_with(axis) as robot:
        await write(robot, 3.0)
        await asyncio.sleep(0.25)
        assert axis.is_armed
        fake.state = IDLE
        await asyncio.sleep(0.5)
        told = {"refuses": "not armed in 0.5 s", "leaves": "has left closed loop"}[how]
        assert told in caplog.text
        assert not axis.is_armed


@pytest.mark.promise("RES-3", "RES-4")
async def test_an_axis_that_restarts_again_and_again_is_never_given_up(
    rig: Any,
) -> None:
    """More quickly than its silence is noticed: that it says nothing wrong is enough."""
    _, fake, axis = rig()
    fake.boot_time = 0.2
    async with robot_with(axis) as robot:
        for _ in range(10):
            with contextlib.suppress(DeviceLostError, DeviceFaultError):
                await write(robot, 3.0)
            await asyncio.sleep(1.0)
            fake.power_cycle()
            await asyncio.sleep(0.5)
            assert not fake.is_armed
            assert state_of(robot) is not esair.ResourceState.FAILED
        await asyncio.sleep(10.0)
        assert state_of(robot) is esair.ResourceState.READY
        assert not fake.is_armed


@pytest.mark.fault("D04")
async def test_no_heartbeat_is_a_loss_and_its_return_does_not_arm_it(rig: Any) -> None:
    """Power that fails and comes back: found again, safe, at rest."""
    _, fake, axis = rig(watchdog=0.3)
    async with robot_with(axis) as robot:
        await write(robot, 3.0)
        fake.stop()
        await asyncio.sleep(0.7)
        assert state_of(robot) is not esair.ResourceState.READY
        with pytest.raises(DeviceLostError, match=r"no heartbeat of node 0 for 0\.5 s"):
            await write(robot, 3.0)

        fake.state, fake.velocity = IDLE, 0.0
        fake.start()
        await asyncio.sleep(7.0)
        assert state_of(robot) is esair.ResourceState.READY
        assert not fake.is_armed
        assert fake.inputs[-1] == 0.0


async def test_an_axis_that_is_not_there_is_lost(rig: Any) -> None:
    """Its opening says so in time; so does that of the sensor."""
    wire, fake, axis = rig()
    fake.stop()
    await wire.open()
    for device in (axis, OdriveState(node=0, bus=wire)):
        with pytest.raises(DeviceLostError, match="no heartbeat of node 0"):
            await device.open()
    await wire.close()


async def test_the_sensor_gives_estimates_with_state_and_errors(rig: Any) -> None:
    """An error is data: the sensor goes on. Short frames are counted."""
    wire, fake, _ = rig()
    await wire.open()
    sensor = OdriveState(node=0, bus=wire)
    stream = sensor.stream()
    assert await anext(stream) == AxisReading(0.0, 0.0, IDLE, ())
    fake.state, fake.velocity = CLOSED_LOOP, 2.0
    await asyncio.sleep(0.2)
    for _ in range(40):
        reading = await anext(stream)
    assert reading.state is CLOSED_LOOP
    assert reading.velocity == pytest.approx(2.0)
    assert reading.position > 0.1
    fake.fail(AxisError.ESTOP_REQUESTED)
    wire.feed(frame_id(0, Message.GET_ENCODER_ESTIMATES), b"\0" * 7)
    for _ in range(40):
        reading = await anext(stream)
    assert (reading.state, reading.errors) == (IDLE, ("ESTOP_REQUESTED",))
    assert sensor.bad_frames == 1
    fake.stop("heartbeat")
    with pytest.raises(DeviceLostError, match="no heartbeat"):
        [_ async for _ in stream]
    await wire.close()


@pytest.mark.promise("PRO-12")
@pytest.mark.parametrize("safe", [None, 0.5])
async def test_an_axis_that_is_protected_stays_where_it_is(
    fake_can: Callable[..., Any], safe: float | None
) -> None:
    """`esair.HOLD` sends it nowhere, and the next position is the next that it goes to."""
    wire = fake_can()
    fake = FakeOdrive(wire, node=0)
    axis = OdriveAxis(node=0, bus=wire, control="position", safe=safe)
    await wire.open()
    await axis.open()
    await axis.write(2.0)
    await asyncio.sleep(0.05)
    assert fake.position == pytest.approx(2.0)
    fake.position = 1.7  # it is on its way
    await axis.write(esair.HOLD)
    await asyncio.sleep(0.05)
    assert (fake.mode, fake.velocity) == (ControlMode.VELOCITY, 0.0)
    assert fake.position == 1.7
    await axis.write(3.0)
    await asyncio.sleep(0.05)
    assert fake.mode is ControlMode.POSITION
    assert fake.position == pytest.approx(3.0)
    assert axis.safe_moves is (safe is not None)
    await axis.close()
    await wire.close()


class Spin(esair.Behavior):
    """Turns the axis for a second."""

    axis = esair.writes(float)

    async def run(self) -> None:
        for _ in range(20):
            await self.axis.write(0.5)
            await asyncio.sleep(0.05)
        await asyncio.sleep(1e6)


@pytest.mark.promise("BUS-4", "AC-2", "CALL-2")
async def test_an_axis_that_missed_to_be_idle_is_told_again() -> None:
    """Its plug was loose for a moment; its heartbeat says that it is armed."""
    wire = FakeCan("wire")
    far = FakeOdrive(wire, node=3)
    axis = OdriveAxis(name="axis", bus=wire, node=3, control="torque", idle=True)
    async with esair.Robot(resources=[axis], behaviors=[Spin()]) as robot:
        await asyncio.sleep(0.93 + axis.command_timeout)  # just before safe is due
        assert far.state is CLOSED_LOOP
        wire.silence()
        await asyncio.sleep(0.03)
        wire.speak()
        await asyncio.sleep(4.0)
        assert far.state is IDLE
        assert robot.resources.query("axis").state is esair.ResourceState.READY


async def test_a_command_that_no_frame_can_hold_is_no_fault_of_the_axis() -> None:
    """The writer hears of it; the axis stays as it is."""
    wire = FakeCan("wire")
    FakeOdrive(wire, node=3)
    axis = OdriveAxis(name="axis", bus=wire, node=3)
    policy = esair.Policy("axis", allow={"user": esair.Access.WRITE})
    async with esair.Robot(resources=[axis], policies=[policy]) as robot:
        user = await robot.resources.register("user", "axis", esair.Access.WRITE)
        await asyncio.sleep(1.0)
        with pytest.raises(BadValueError, match="single float"):
            await robot.actuators.write(user, -1e300)
        assert robot.resources.query("axis").state is esair.ResourceState.READY
