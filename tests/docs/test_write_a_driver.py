"""The drivers of the how-to page, under the contracts that all drivers keep."""

import asyncio
import inspect
import re
from pathlib import Path
from typing import Any

import parts
import pytest
from bus_servo import MOVE, POSITION, BusServo
from hypothesis import given
from hypothesis import strategies as st
from parts import Mcp4725, Mcp9808, decode_temperature
from scale import Scale, Weigh, weights

import esair
from esair import buses, testing
from esair.testing import ActuatorContract, FakeI2c, FakeSerial, SensorContract


class Words:
    """The far end: registers of two bytes."""

    def __init__(self, **registers: str) -> None:
        self.registers = {
            int(name[1:], 16): bytes.fromhex(value) for name, value in registers.items()
        }

    def read(self, register: int, length: int) -> bytes:
        assert length == 2
        return self.registers[register]

    def write(self, register: int, data: bytes) -> None:
        raise AssertionError("the driver writes nothing")


class TestMcp9808(SensorContract):
    keeps_nothing = "it is told nothing"

    def make(self) -> Mcp9808:
        return Mcp9808(bus=FakeI2c(chips={0x18: Words(r05="c194", r06="0054")}))


class TestMcp4725(ActuatorContract):
    keeps_nothing = "each command says all that it needs"

    def make(self) -> Mcp4725:
        return Mcp4725(bus=FakeI2c(chips={0x60: Dac()}))

    def commands(self) -> list[float]:
        return [1.0, 0.123]


class Dac:
    """The far end: two bytes are four bits of nothing and twelve of the voltage."""

    def __init__(self) -> None:
        self.count = 0

    power_cycle = __init__

    def read(self, register: int, length: int) -> bytes:
        raise AssertionError("the driver reads nothing")

    def write(self, register: int, data: bytes) -> None:
        assert len(data) == 1
        self.count = register << 8 | data[0]


FRAMING = {
    "type": "length-crc",
    "sync": "55 55",
    "header": 1,
    "counted": 2,
    "crc": "sum-8/inverted",
}


class FarServo:
    """The far end: one servo with the number 3."""

    def __init__(self, line: FakeSerial) -> None:
        self.count = 500
        self.has_power = True
        line.on_frame = self.answer

    def answer(self, message: bytes) -> bytes | None:
        if message[0] != 3 or not self.has_power:
            return None
        if message[1] == POSITION:
            return message + self.count.to_bytes(2, "little", signed=True)
        assert message[1] == MOVE
        self.count = int.from_bytes(message[2:4], "little")
        return None


class TestBusServo(ActuatorContract):
    keeps_nothing = "each command says all that it needs"

    def make(self) -> BusServo:
        line = FakeSerial(framing=FRAMING, echo=True)
        self.far = FarServo(line)
        return BusServo(number=3, bus=line)

    def commands(self) -> list[float]:
        return [120.0, 0.0, 240.0]

    async def silence(self, device: BusServo) -> None:
        self.far.has_power = False

    async def speak(self, device: BusServo) -> None:
        self.far.has_power = True

    async def power_cycle(self, device: BusServo) -> None:
        self.far.has_power = True  # it keeps nothing that it would lose


@pytest.mark.virtual_clock
@pytest.mark.parametrize(("count", "held"), [(-2, 0), (1003, 1000)])
async def test_the_servo_holds_at_the_ends_of_its_way(count: int, held: int) -> None:
    """There it tells angles that it takes no more."""
    made = TestBusServo()
    servo = made.make()
    made.far.count = count
    await servo.bus.open()
    await servo.write(esair.HOLD)
    await asyncio.sleep(0.01)
    assert made.far.count == held
    await servo.bus.close()


@pytest.mark.virtual_clock
async def test_the_safe_frames_of_the_servo_are_framed() -> None:
    """Head, number, length, command, checksum: as in the protocol's table."""
    servo = TestBusServo().make()

    assert servo.safe_frames().frames == (bytes.fromhex("55 55 03 03 0C ED"),)


@pytest.mark.parametrize("number", [-1, 254, "3"])
def test_a_keyword_that_is_wrong_names_the_part_and_the_field(number: Any) -> None:
    """As each mistake in a robot.toml does."""
    with pytest.raises(esair.ConfigError, match="bus_servo: number: expected 0 to 253"):
        BusServo(number=number)


def test_what_the_page_says_of_a_bus_is_there() -> None:
    """Each class and each call in the table, with its parameters."""
    page = Path(__file__).parents[2] / "docs" / "how-to" / "write-a-driver.md"
    rows = re.findall(r"^\| `(\w+)` \| (.*) \| (.*) \|$", page.read_text(), re.M)
    assert [name for name, *_ in rows] == [
        f"{kind}Bus" for kind in ("I2C", "Spi", "Serial", "Can", "Mqtt")
    ]
    for name, calls, fake in rows:
        made = re.match(r"`(Fake\w+)\(", fake)
        assert made
        thing = getattr(testing, made[1])
        assert issubclass(thing, getattr(buses, name))
        for call, taken in re.findall(
            r"`(?:with (?:await )?bus\.)?(\w+)\(([^)]*)\)", calls
        ):
            known = list(inspect.signature(getattr(thing, call)).parameters)
            words = re.findall(r"(\w+)=", taken)
            assert set(words) <= set(known)
            assert taken.count(",") < len(known)
        for call in re.findall(r"`fake\.(\w+)\(", fake):
            assert callable(getattr(thing, call))


@pytest.mark.parametrize(
    ("data", "celsius"),
    [("c194", 25.25), ("1ff0", -1.0), ("0000", 0.0), ("07d0", 125.0), ("1d80", -40.0)],
)
def test_the_temperature_is_that_of_the_data_sheet(data: str, celsius: float) -> None:
    """The three bits above it are alarms."""
    assert decode_temperature(bytes.fromhex(data)) == celsius


@given(st.binary(min_size=2, max_size=2))
def test_every_value_of_the_register_is_a_temperature(data: bytes) -> None:
    """Whatever the alarms are."""
    assert -256.0 <= decode_temperature(data) < 256.0


@pytest.mark.virtual_clock
async def test_the_voltage_reaches_the_part_and_ends_at_zero() -> None:
    """What is written is what was really applied."""
    dac = Dac()
    part = Mcp4725(name="dac", bus=FakeI2c(chips={0x60: dac}))
    policy = esair.Policy("dac", allow={"me": esair.Access.WRITE})
    async with esair.Robot(resources=[part], policies=[policy]) as robot:
        right = await robot.resources.register("me", "dac", esair.Access.WRITE)
        written: Any = await robot.actuators.write(right, 0.5)
        assert dac.count == 2048
        assert written.command == 2048 / 4095
    assert dac.count == 0


@pytest.mark.virtual_clock
async def test_the_thermometer_gives_its_temperature() -> None:
    """25.25 °C, with one of the alarms."""
    part = Mcp9808(bus=FakeI2c(chips={0x18: Words(r05="c194", r06="0054")}))
    await part.bus.open()
    await part.open()
    assert await part.read() == 25.25
    await part.bus.close()


@pytest.mark.virtual_clock
async def test_another_chip_is_refused() -> None:
    """Its manufacturer's number tells."""
    part = Mcp9808(bus=FakeI2c(chips={0x18: Words(r05="0000", r06="0055")}))
    await part.bus.open()
    with pytest.raises(esair.DeviceFaultError, match="no MCP9808"):
        await part.open()
    await part.bus.close()


@pytest.mark.virtual_clock
async def test_the_scale_is_tared_by_its_operation() -> None:
    """What lay on it before weighs nothing; what is added is told."""
    chip = Load()
    part = Scale(bus=FakeI2c(chips={0x2A: chip}))
    weigh = Weigh()
    async with esair.Robot(resources=[part], behaviors=[weigh]) as robot:
        assert weights(robot) == ["tare(samples: int = 4)"]
        await asyncio.sleep(1.0)
        assert part.zero == 1.5
        chip.count = 50_000
        await asyncio.sleep(1.0)
        assert await robot.behaviors.get(sender="weigh", receiver="user") == 1.0


class Load:
    """The far end: three bytes that count what lies on the scale."""

    count = 30_000

    def read(self, register: int, length: int) -> bytes:
        assert (register, length) == (0x12, 3)
        return self.count.to_bytes(3, signed=True)

    def write(self, register: int, data: bytes) -> None:
        raise AssertionError("the driver writes nothing")


def test_a_driver_has_no_more_than_20_lines() -> None:
    """As the page says: without its docstring and its empty lines."""
    source = inspect.getsource(parts)
    begin = source.index("def decode_temperature")
    lines = source[begin : source.index("class Mcp4725")].splitlines()
    assert len([line for line in lines if line.strip()]) <= 20
