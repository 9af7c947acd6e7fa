"""The microcontroller that speaks in lines: codec, sensor, actuator."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from typing import ClassVar

import hypothesis
import pytest
from hypothesis import strategies as st
from tests.drivers.parts import Powered

import esair
from esair.drivers.line import (
    LineActuator,
    LineError,
    LineSensor,
    decode_value,
    encode_value,
)
from esair.drivers.line.fake import FakeBoard
from esair.exceptions import (
    ConfigError,
    DeviceFaultError,
    DeviceLostError,
    DriverStuckError,
)
from esair.messages import ResourceState
from esair.testing import ActuatorContract, FakeSerial, SensorContract


@pytest.fixture
def line(fake_serial: Callable[..., FakeSerial]) -> FakeSerial:
    return fake_serial("front")


class OnBoard(Powered):
    keeps_nothing: ClassVar[str] = "each line says all that the board needs"


class TestPushed(OnBoard, SensorContract):
    """A sensor whose board tells its value ten times a second."""

    def make(self) -> LineSensor:
        line = FakeSerial("front")
        self.far = FakeBoard(line, {"range": 1.25}, period=0.1)
        return LineSensor(name="range", silent_after=0.5, bus=line)


class TestAsked(OnBoard, SensorContract):
    """A sensor whose board is asked for each value."""

    def make(self) -> LineSensor:
        line = FakeSerial("front")
        self.far = FakeBoard(line, {"range": 1.25})
        return LineSensor(name="range", ask=True, bus=line)


class TestTold(OnBoard, ActuatorContract):
    """An actuator whose board confirms nothing."""

    ack = False
    is_heard = False

    def make(self) -> LineActuator:
        line = FakeSerial("front")
        self.far = FakeBoard(line, commands={"speed": 0.0}, ack=self.ack)
        return LineActuator(
            name="speed", safe=0.0, ack=self.ack, limits=(-1.0, 1.0), bus=line
        )

    def commands(self) -> list[float]:
        return [0.5, -1.0]


class TestConfirmed(TestTold):
    """An actuator whose board confirms each command."""

    ack = is_heard = True


class TestReadBack(TestConfirmed):
    """An actuator whose board is asked what it has, each second."""

    keeps_nothing: ClassVar[str] = ""

    def make(self) -> LineActuator:
        line = FakeSerial("front")
        self.far = FakeBoard(line, commands={"speed": 0.0}, ack=True)
        device = LineActuator(
            name="speed", safe=0.25, ack=True, reads_back=True, bus=line
        )
        device.set_up_period = 0.1  # before what is safe is told again
        return device


@pytest.mark.promise("BUS-4", "RES-4")
@pytest.mark.parametrize("is_silent", [False, True])
async def test_what_is_read_back_is_noticed_without_a_command(
    line: FakeSerial, is_silent: bool
) -> None:
    """One that restarted with its motor on is made safe; one that is silent is lost."""
    board = FakeBoard(line, commands={"speed": 0.7}, ack=True)
    device = LineActuator(name="speed", safe=0.0, ack=True, reads_back=True, bus=line)
    async with esair.Robot(resources=[device]) as robot:
        await asyncio.sleep(3.0)
        assert robot.resources.query("speed").losses == 0
        board.power_cycle()
        board.silent = is_silent
        await asyncio.sleep(3.0)
        status = robot.resources.query("speed")
        assert status.losses == 1
        assert (status.state is ResourceState.READY) is not is_silent
        assert board.commands["speed"] == (0.7 if is_silent else 0.0)


def test_what_is_not_confirmed_is_not_read_back(line: FakeSerial) -> None:
    """A board rounds, and what it has would be another number each time."""
    with pytest.raises(ConfigError, match="reads_back: expected ack = true"):
        LineActuator(name="speed", safe=0.0, reads_back=True, bus=line)


@pytest.mark.real_clock
@pytest.mark.long
class TestConfirmedOnATerminal(TestConfirmed):
    """The same, through the kernel."""

    silent_for = 1.0


# The codec.


@hypothesis.given(st.floats(allow_nan=False, allow_infinity=False))
def test_a_value_goes_there_and_back(value: float) -> None:
    """What is decoded is what was encoded."""
    assert decode_value(encode_value("speed", value)) == ("speed", value)


@pytest.mark.promise("AC-1")
@pytest.mark.parametrize(
    ("value", "digits"),
    [(1234567890123, b"1234567890123"), (4e9, b"4000000000"), (0.0, b"0"),
     (True, b"1"), (123456.789012, b"123456.789012"), (0.1, b"0.1")],
)  # fmt: skip
def test_a_number_goes_out_with_all_its_digits(value: float, digits: bytes) -> None:
    """What the board is told is what is told as written; whole numbers have no point."""
    assert encode_value("speed", value) == b"speed=" + digits


@pytest.mark.fault("D12", "D26")
@hypothesis.given(st.binary(max_size=40))
def test_any_line_is_a_value_or_an_error(line: bytes) -> None:
    """No line raises anything else, and no value is not finite."""
    try:
        _, value = decode_value(line)
    except LineError:
        return
    assert math.isfinite(value)


@pytest.mark.fault("D26")
@pytest.mark.parametrize(
    "line",
    [b"", b"=", b"range", b"range=", b"range=nan", b"range=inf", b"range=1e999",
     b"range=1_0", b"range=0x10", b"range=1,5", b"=5", b"1=5", b"r\xe4nge=5"],
)  # fmt: skip
def test_what_is_no_value(line: bytes) -> None:
    """Python's own idea of a number is wider than the protocol's."""
    with pytest.raises(LineError):
        decode_value(line)


@pytest.mark.fault("V01")
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_no_command_is_not_finite(value: float) -> None:
    """The codec refuses what the connection would have refused before."""
    with pytest.raises(LineError):
        encode_value("speed", value)


# The sensor.


async def test_only_its_own_values_are_its_business(line: FakeSerial) -> None:
    """Several sensors share a board, and what is damaged is counted."""
    FakeBoard(line, {"left": 1.0, "leftmost": 3.0}, period=0.1)
    sensor = LineSensor(name="left", bus=line)
    await line.open()
    values = sensor.stream()

    assert await anext(values) == 1.0
    line.feed(b"left=12.3.4\r\nleft=2\r\n")
    assert await anext(values) == 2.0

    assert sensor.bad_lines == 1
    await values.aclose()
    await line.close()


async def test_its_key_may_differ_from_its_name(line: FakeSerial) -> None:
    """A name on the wire is the firmware's, one in the robot is the robot's."""
    board = FakeBoard(line, {"R1": 1.0})
    sensor = LineSensor(name="sonar", key="R1", ask=True, bus=line)
    await line.open()

    board.values["R1"] = 0.75

    assert await sensor.read() == 0.75
    await line.close()


@pytest.mark.fault("D26")
async def test_an_answer_that_is_no_number_is_a_fault(line: FakeSerial) -> None:
    """It is counted, and the next one is taken."""
    line.answer(b"range?", b"range=far")
    sensor = LineSensor(name="range", ask=True, bus=line)
    await line.open()

    with pytest.raises(DeviceFaultError, match=r"'range'.*number"):
        await sensor.read()

    assert sensor.bad_lines == 1
    line.answer(b"range?", b"range=4")
    assert await sensor.read() == 4.0
    await line.close()


@pytest.mark.fault("D14")
async def test_a_board_without_the_value_is_silent(line: FakeSerial) -> None:
    """The reader gets an error in time, not never."""
    FakeBoard(line, {"left": 1.0})
    sensor = LineSensor(name="right", ask=True, bus=line)
    await line.open()

    with pytest.raises(DriverStuckError, match=r"right\?"):
        await sensor.read()

    await line.close()


# The actuator.


async def test_a_confirmation_tells_what_was_applied(line: FakeSerial) -> None:
    """The board may know limits of its own."""
    line.answer(b"speed=0.9", b"speed:0.5")
    actuator = LineActuator(name="speed", safe=0.0, ack=True, bus=line)
    await line.open()

    assert await actuator.write(0.9) == 0.5

    await line.close()


async def test_a_refusal_tells_why(line: FakeSerial) -> None:
    """The board's own words are in the error."""
    board = FakeBoard(line, commands={"speed": 0.0}, ack=True)
    board.refuse = lambda _key, value: "too fast" if value > 0.5 else None
    actuator = LineActuator(name="speed", safe=0.0, ack=True, bus=line)
    await line.open()

    assert await actuator.write(0.4) == 0.4
    with pytest.raises(DeviceFaultError, match="too fast"):
        await actuator.write(0.9)

    assert board.commands == {"speed": 0.4}
    await line.close()


@pytest.mark.fault("D26")
async def test_a_confirmation_that_is_nonsense_is_a_fault(line: FakeSerial) -> None:
    """Nobody knows what was applied then."""
    line.answer(b"speed=0.5", b"speed:lots")
    actuator = LineActuator(name="speed", safe=0.0, ack=True, bus=line)
    await line.open()

    with pytest.raises(DeviceFaultError, match=r"'speed'.*number"):
        await actuator.write(0.5)

    await line.close()


@pytest.mark.fault("D05")
async def test_another_board_in_its_place_is_not_obeyed(line: FakeSerial) -> None:
    """With an identity declared, only the board of that name comes up."""
    board = FakeBoard(line, {"range": 1.0}, name="gripper", period=0.1)
    sensor = LineSensor(name="range", identity="bumper", bus=line)

    async with esair.Robot(resources=[sensor]) as robot:
        await asyncio.sleep(1.0)
        assert robot.resources.query("range").state is not esair.ResourceState.READY
        board.name = "bumper"
        await asyncio.sleep(20.0)
        assert robot.resources.query("range").state is esair.ResourceState.READY


@pytest.mark.fault("D04")
@pytest.mark.promise("RES-2")
async def test_after_a_loss_the_safe_command_is_the_first(line: FakeSerial) -> None:
    """What was told before is not told again by itself."""
    FakeBoard(line, commands={"speed": 0.0})
    actuator = LineActuator(name="speed", safe=0.0, bus=line)

    class Drive(esair.Behavior):
        speed = esair.writes(float)

        async def run(self) -> None:
            await self.speed.write(0.7)
            await asyncio.Event().wait()

    async with esair.Robot(resources=[actuator], behaviors=[Drive()]):
        await line.until(b"speed=0.7")
        line.unplug()
        await asyncio.sleep(1.0)
        line.sent.clear()
        line.plug()
        await line.until(lambda _: True, timeout=20.0)

    assert set(line.sent) == {b"speed=0"}


@pytest.mark.virtual_clock
@pytest.mark.promise("SC-3")
@pytest.mark.fault("D10", "D26")
async def test_a_board_that_tells_no_number_any_more_is_at_fault(
    line: FakeSerial,
) -> None:
    """It may be silent for ever, and is not: its last number does not stay current."""
    sensor = LineSensor(name="range", bus=line)
    user = esair.Behavior(name="user", reads={"range": esair.reads(float)}, writes={})
    said = [b"range=2.5\n"]
    line.repeat(lambda: said[0], 0.1)
    async with esair.Robot(resources=[sensor], behaviors=[user]) as robot:
        await asyncio.sleep(0.5)
        for _ in range(5):  # noise among numbers is left out
            said[0] = b"range=2.x\n"
            await asyncio.sleep(0.2)
            said[0] = b"range=2.5\n"
            await asyncio.sleep(0.1)
        assert robot.resources.query("range").faults == 0
        said[0] = b"range=nan\n"
        await asyncio.sleep(1.0)
        with pytest.raises((DeviceFaultError, DeviceLostError), match="no number"):
            await user.range.read()
        said[0] = b"range=1.5\n"
        await asyncio.sleep(1.0)
        assert await user.range.read() == 1.5


async def test_what_is_no_number_keeps_no_value_current(line: FakeSerial) -> None:
    """A board that goes on speaking, of nothing, has been silent about its value."""
    sensor = LineSensor(name="range", silent_after=0.5, bus=line)
    user = esair.Behavior(name="user", reads={"range": esair.reads(float)}, writes={})
    said = [b"range=2.5\n"]
    line.repeat(lambda: said[0], 0.1)
    async with esair.Robot(resources=[sensor], behaviors=[user]) as robot:
        await asyncio.sleep(0.5)
        assert await user.range.read() == 2.5
        said[0] = b"range=nothing\n"
        await asyncio.sleep(1.0)
        with pytest.raises(esair.StaleReadingError):
            await user.range.read()
        assert robot.resources.query("range").losses == 0
