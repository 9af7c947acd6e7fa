"""Dynamixel servos: the bus, the sensor, the actuator, in memory and on a terminal."""

from __future__ import annotations

import asyncio
import collections
import contextlib
import fcntl
import math
import os
import pty
import struct
import termios
import threading
import tty
from collections.abc import AsyncIterator, Iterator
from typing import Any

import pytest
from dynamixel_sdk import Protocol2PacketHandler  # type: ignore[import-untyped]
from tests.drivers.parts import OnServos

import esair
from esair.drivers.servo import (
    CENTER,
    GOAL_CURRENT,
    GOAL_POSITION,
    GOAL_VELOCITY,
    OPERATING_MODE,
    PRESENT_POSITION,
    PROFILE_VELOCITY,
    TORQUE_ENABLE,
    Goal,
    Mode,
    Servo,
    ServoBus,
    ServoPosition,
    hardware_errors,
    to_angle,
    to_steps,
)
from esair.drivers.servo._bus import Packets
from esair.drivers.servo.fake import (
    FASTEST,
    GREATEST,
    LEAST,
    PING,
    READ,
    STRONGEST,
    SYNC_READ,
    SYNC_WRITE,
    WRITE,
    FakeServo,
    FakeServos,
    packet,
)
from esair.drivers.servo.turning import ServoCurrent, ServoVelocity
from esair.exceptions import (
    DeviceFaultError,
    DeviceLostError,
    DriverStuckError,
)
from esair.loop import SAFE, Urgency, urgency, waits_in_line
from esair.plan import examine
from esair.testing import ActuatorContract, BusContract, SensorContract

RELEASE = Goal(mode=Mode.RELEASE)
HOLD = Goal(mode=Mode.HOLD)


class Memory(OnServos):
    """What the suites need to reach the fakes behind a bus."""

    def make_bus(self) -> ServoBus:
        self.fakes = FakeServos([1, 2])
        return ServoBus(name="arm", wire=self.fakes)


class TestServoBus(Memory, BusContract):
    def make(self) -> ServoBus:
        return self.make_bus()

    async def use(self, bus: Any) -> None:
        assert await bus.ping(1) == 1060

    async def ask(self, bus: Any, number: int) -> int:
        self.fakes.servos[1].table[:62] = bytes(range(62))
        with contextlib.suppress(DeviceFaultError):
            return int(await bus.read(1, number, 1))
        return number  # it was told that there was no answer

    async def delay(self, bus: Any, seconds: float) -> None:
        self.fakes.delay = 0.2 * seconds


class TestServoPosition(Memory, SensorContract):
    def make(self) -> ServoPosition:
        return ServoPosition(id=2, bus=self.make_bus())

    keeps_nothing = "an answer of one that has restarted says so, and it is lost"


class TestServo(Memory, ActuatorContract):
    safe = RELEASE

    def make(self) -> Servo:
        return Servo(id=2, safe=self.safe, limits=(-1.0, 1.0), bus=self.make_bus())

    def commands(self) -> list[Goal]:
        return [Goal(0.5), Goal(-1.0), HOLD, RELEASE]


class TestServoThatHolds(TestServo):
    safe = HOLD


class TestServoWithAShorterTable(TestServo):
    """An XL330 or XC330: what the others tell in one block is elsewhere there."""

    def make_bus(self) -> ServoBus:
        self.fakes = FakeServos({1: FakeServo(), 2: FakeServo(model=1200)})
        return ServoBus(name="arm", wire=self.fakes)


class TestServoVelocity(TestServo):
    def make(self) -> Any:
        return ServoVelocity(id=2, bus=self.make_bus())

    def commands(self) -> list[Any]:
        return [1.0, -6.0]


class TestServoCurrent(TestServoVelocity):
    def make(self) -> Any:
        return ServoCurrent(id=2, limits=(-6.0, 6.0), bus=self.make_bus())


@pytest.fixture
def fakes() -> FakeServos:
    return FakeServos([1, 2])


@pytest.fixture
async def bus(fakes: FakeServos) -> AsyncIterator[ServoBus]:
    made = ServoBus(name="arm", wire=fakes)
    yield made
    await made.close()


# Together.


SIX = range(1, 7)


class AtTheirPace(FakeServos):
    """Each answer takes its time at 57600 bits per second, and 0.5 ms before it."""

    def _answer(self, data: bytes) -> None:
        answers, line = self.heard(data), self._line
        loop = asyncio.get_running_loop()
        for n, begin in enumerate(range(0, len(answers), 21), 1):
            piece = answers[begin : begin + 21]
            assert line is not None
            loop.call_later(
                (begin + len(piece)) * 10 / 57600 + n * 0.0005, line.write, piece
            )


@pytest.mark.virtual_clock
async def test_twenty_servos_at_their_own_rate_are_asked_in_one_turn() -> None:
    """Their answers take more than the time that one servo has for its own."""
    numbers = range(1, 21)
    fakes = AtTheirPace({n: FakeServo(steps=CENTER + n) for n in numbers})
    bus = ServoBus(name="arm", wire=fakes)
    places = [ServoPosition(name=f"p{n}", id=n, bus=bus) for n in numbers]
    await bus.open()
    for place in places:
        await place.open()
    del fakes.written[:]

    angles = await asyncio.gather(*(place.read() for place in places))

    assert [to_steps(angle) - CENTER for angle in angles] == [*numbers]
    assert [instruction for _, instruction, _ in fakes.written] == [SYNC_READ]
    await bus.close()


@pytest.mark.virtual_clock
async def test_servos_of_both_kinds_of_table_are_on_one_line() -> None:
    """Each tells its own position, whoever else is asked at the same moment."""
    models = {1: 1060, 2: 1200, 3: 1020, 4: 1220}
    fakes = FakeServos(
        {n: FakeServo(model=models[n], steps=CENTER + 100 * n) for n in models}
    )
    bus = ServoBus(name="arm", wire=fakes)
    places = [ServoPosition(name=f"p{n}", id=n, bus=bus) for n in models]
    await bus.open()
    try:
        await asyncio.gather(*(each.open() for each in places))
        told = await asyncio.gather(*(each.read() for each in places))
    finally:
        await bus.close()
    assert [to_steps(angle) - CENTER for angle in told] == [100, 200, 300, 400]


async def six(fakes: FakeServos) -> tuple[ServoBus, list[Servo], list[ServoPosition]]:
    """Six servos with torque on one line, each with its position."""
    bus = ServoBus(name="arm", wire=fakes)
    servos = [Servo(name=f"s{n}", id=n, safe=RELEASE, bus=bus) for n in SIX]
    places = [ServoPosition(name=f"p{n}", id=n, bus=bus) for n in SIX]
    await bus.open()
    await asyncio.gather(*(each.open() for each in servos))
    await asyncio.gather(*(each.open() for each in places))
    await asyncio.gather(*(each.write(Goal(0.1)) for each in servos))
    fakes.written.clear()
    fakes.turns = 0
    return bus, servos, places


@pytest.mark.virtual_clock
async def test_six_servos_take_one_turn_of_the_wire() -> None:
    """Goals need none; where all are, and whether they are set up, is one question."""
    fakes = FakeServos(SIX)
    bus, servos, places = await six(fakes)
    await asyncio.gather(*(each.read() for each in places))
    for step in range(1, 11):
        told = [each.write(Goal(0.1 * step)) for each in servos]
        asked = [each.read() for each in places]
        found = (await asyncio.gather(*asked, *told))[:6]
        assert found == pytest.approx([0.1 * step] * 6, abs=1e-3)

    kinds = [kind for _, kind, _ in fakes.written]
    assert kinds == [SYNC_READ, *[SYNC_WRITE, SYNC_READ] * 10]
    assert fakes.turns == 11
    await bus.close()


@pytest.mark.virtual_clock
@pytest.mark.parametrize("rate", [50.0, None])
@pytest.mark.parametrize("latency", [0.016, 0.001])
@pytest.mark.long
async def test_six_servos_at_50_hz_within_the_latency_of_the_adapter(
    latency: float, rate: float | None
) -> None:
    """Asked and told in a rhythm, or told what follows from where they are."""
    fakes = FakeServos(SIX)
    fakes.delay = latency
    bus = ServoBus(name="arm", wire=fakes)
    names = [f"s{n}" for n in SIX]
    ports: dict[str, Any] = {name: esair.writes(Goal) for name in names}
    ports |= {f"p{n}": esair.reads(float) for n in SIX}

    def react(self: esair.Reaction, **places: float) -> dict[str, Goal]:
        return dict.fromkeys(names, Goal(0.3 * math.sin(0.001 * self.now_ms)))

    wave = type("Wave", (esair.Reaction,), {"rate": rate, "react": react, **ports})
    servos = [Servo(name=f"s{n}", id=n, safe=RELEASE, bus=bus) for n in SIX]
    places = [ServoPosition(name=f"p{n}", id=n, bus=bus) for n in SIX]
    async with esair.Robot(resources=[*servos, *places], behaviors=[wave()]):
        await asyncio.sleep(2.0)
        fakes.written.clear()
        fakes.turns = 0
        await asyncio.sleep(4.0)
        counted = collections.Counter(
            (kind, len(data)) for _, kind, data in fakes.written
        )

    all_told, all_asked = (SYNC_WRITE, 4 + 6 * 5), (SYNC_READ, 4 + 6)
    assert counted.keys() == {all_told, all_asked}
    assert counted[all_told] >= 199
    assert 199 <= fakes.turns <= 205


@pytest.mark.virtual_clock
async def test_a_silent_servo_costs_the_others_nothing_but_time() -> None:
    """Those behind it on the wire are asked alone; it is told by itself."""
    fakes = FakeServos(range(1, 4))
    bus = ServoBus(name="arm", wire=fakes)
    await bus.open()
    fakes.servos.pop(2)
    found = await asyncio.gather(
        *(bus.read(n, PRESENT_POSITION, 4) for n in (1, 2, 3)), return_exceptions=True
    )

    assert found[0] == found[2] == CENTER
    assert isinstance(found[1], DeviceFaultError)
    await bus.close()


@pytest.mark.virtual_clock
async def test_a_goal_that_is_given_up_in_the_line_is_not_sent() -> None:
    """Of one servo the newest counts."""
    fakes = FakeServos([1, 2])
    bus = ServoBus(name="arm", wire=fakes)
    await bus.open()
    writes = [
        asyncio.ensure_future(bus.write(n, GOAL_POSITION, 4, value))
        for n, value in [(1, 100), (2, 200), (1, 300)]
    ]
    await asyncio.sleep(0)
    writes[1].cancel()
    await asyncio.gather(*writes, return_exceptions=True)

    assert fakes.servos[1].get(GOAL_POSITION) == 300
    assert fakes.servos[2].get(GOAL_POSITION) == CENTER
    await bus.close()


@pytest.mark.virtual_clock
@pytest.mark.promise("BUS-5")
@pytest.mark.parametrize("servos", [(1,), (2, 3)])
async def test_what_is_given_up_for_a_silent_servo_is_not_sent(
    servos: tuple[int, ...],
) -> None:
    """It has not begun before its turn; it would come after what makes safe."""
    fakes = FakeServos([1, 2, 3])
    bus = ServoBus(name="arm", wire=fakes)
    await bus.open()
    fakes.stall()
    asked = [bus.read(1, PRESENT_POSITION, 4), bus.read(1, GOAL_POSITION, 4)]
    reads = asyncio.gather(*asked, return_exceptions=True)
    await asyncio.sleep(0.02)
    writes = [asyncio.ensure_future(bus.write(n, TORQUE_ENABLE, 1, 1)) for n in servos]
    await asyncio.sleep(0.02)
    fakes.resume()
    assert [waits_in_line(each) for each in writes] == [True] * len(writes)
    writes[0].cancel()
    urgency.set(urgent := Urgency())
    with urgent.raised(SAFE):
        await bus.write(servos[0], TORQUE_ENABLE, 1, 0)

    await asyncio.gather(reads, *writes, return_exceptions=True)
    await asyncio.sleep(1.0)
    assert not fakes.servos[servos[0]].torque
    assert all(fakes.servos[n].torque for n in servos[1:])
    await bus.close()


@pytest.mark.virtual_clock
@pytest.mark.promise("BUS-5")
async def test_no_servo_gets_its_torque_after_a_halt() -> None:
    """Not even if that waits, because the servo did not answer another request."""

    class Silent(FakeServos):
        """Does not answer what it is asked while it is told its goal."""

        lost: asyncio.Task[int] | None = None

        def _status(self, number: int, instruction: int, parameters: bytes) -> bytes:
            if parameters[:1] == bytes([GOAL_POSITION]) and self.lost is None:
                reading = bus.read(1, GOAL_CURRENT, 2)
                self.lost = asyncio.get_running_loop().create_task(reading)
            told = super()._status(number, instruction, parameters)
            return b"" if parameters[:1] == bytes([GOAL_CURRENT]) else told

    class Wave(esair.Behavior):
        joint = esair.writes(Goal)

        async def run(self) -> None:
            assert not await self.joint.write(Goal(0.5))

    fakes = Silent([1])
    fakes.delay = 0.004
    bus = ServoBus(name="arm", wire=fakes)
    joint = Servo(name="joint", id=1, bus=bus, safe=RELEASE)
    async with esair.Robot(resources=[joint], behaviors=[Wave()]) as robot:
        await asyncio.sleep(0.1)  # that was given up, and is owed for as long
        await robot.halt("enough")
        await asyncio.sleep(1.0)
    assert fakes.lost is not None
    assert isinstance(fakes.lost.exception(), DeviceFaultError)
    assert (1, WRITE, bytes([TORQUE_ENABLE, 0, 1])) not in fakes.written


@pytest.mark.virtual_clock
async def test_a_servo_turns_and_pushes_in_its_mode() -> None:
    """The mode is set without torque, kept over power, and at rest when it is safe."""
    fakes = FakeServos([1, 2])
    bus = ServoBus(name="arm", wire=fakes)
    wheel = ServoVelocity(name="wheel", id=1, bus=bus)
    grip = ServoCurrent(name="grip", id=2, bus=bus)
    await bus.open()
    fakes.servos[1].table[TORQUE_ENABLE] = 1
    await wheel.open()
    await grip.open()
    assert [each.table[OPERATING_MODE] for each in fakes.servos.values()] == [1, 0]
    assert not fakes.servos[1].torque

    await wheel.write(-math.tau / 60 * 22.9)
    await grip.write(0.269)
    assert fakes.servos[1].torque
    assert fakes.servos[1].get(GOAL_VELOCITY) == -100
    assert fakes.servos[2].get(GOAL_CURRENT) & 0xFFFF == 100
    for device, address in ((wheel, GOAL_VELOCITY), (grip, GOAL_CURRENT)):
        for packet_ in device.safe_frames().frames:
            fakes.heard(packet_)
        assert fakes.servos[device.id].get(address) & 0xFFFF == 0
    await bus.close()


@pytest.mark.virtual_clock
@pytest.mark.parametrize(
    ("model", "unit", "units"),
    [(1020, None, 100), (1200, None, 269), (1050, None, 201), (1200, 0.00269, 100)],
)
async def test_a_current_is_in_the_units_of_the_model(
    model: int, unit: float | None, units: int
) -> None:
    """XM430, XL330 and XH430-V210 have three of them, by the maker's tables."""
    fakes = FakeServos({1: FakeServo(model=model)})
    bus = ServoBus(name="arm", wire=fakes)
    grip = ServoCurrent(name="grip", unit=unit, bus=bus)
    await bus.open()
    await grip.open()
    await grip.write(0.269)
    assert fakes.servos[1].get(GOAL_CURRENT) & 0xFFFF == units
    await bus.close()


@pytest.mark.virtual_clock
@pytest.mark.promise("ROB-3")
async def test_a_servo_without_power_blinds_nobody_else(fake_actuator: Any) -> None:
    """It is asked again and again whether it is there, on the wire of the others."""
    bus = ServoBus(name="arm", wire=FakeServos([1, 2]))
    places = [ServoPosition(name=f"p{n}", id=n, bus=bus) for n in (1, 2, 3)]

    class Hold(esair.Reaction):
        p1 = esair.reads(float)
        p2 = esair.reads(float)
        hand = esair.writes(float)

        def react(self, p1: float, p2: float) -> float:
            return 1.0

    hand = fake_actuator("hand", safe=0.0)
    robot = esair.Robot(resources=[*places, hand], behaviors=[Hold()])
    async with robot:
        await hand.until(1.0, timeout=2.0)
        begun = len(hand.commands)
        await asyncio.sleep(8.0)
        assert bus.stats.errors > 3
        assert 0.0 not in hand.commands[begun:]


@pytest.fixture
def three() -> tuple[FakeServos, ServoBus]:
    fakes = FakeServos([1, 2, 3])
    return fakes, ServoBus(name="arm", wire=fakes)


class Drives(esair.Behavior):
    """Tells three actuators a command again and again, also one that is lost."""

    def __init__(self, command: Any) -> None:
        kind = type(command)
        names = ("w1", "w2", "w3")
        super().__init__(writes={name: esair.writes(kind) for name in names})
        self.command = command

    async def run(self) -> None:
        async for _ in esair.every(0.02):
            for port in (self.w1, self.w2, self.w3):
                with contextlib.suppress(ConnectionError, OSError):
                    await port.write(self.command)


@pytest.mark.virtual_clock
@pytest.mark.fault("D30")
@pytest.mark.parametrize("ago", [0.0, 0.02, 0.1, 0.2])
async def test_one_without_power_does_not_keep_the_others_from_stopping(
    three: tuple[FakeServos, ServoBus], ago: float
) -> None:
    """They wait for one answer that does not come, and not for all that it owes."""
    fakes, bus = three
    places = [ServoPosition(name=f"p{n}", id=n, bus=bus) for n in (1, 2, 3)]
    wheels = [ServoVelocity(name=f"w{n}", id=n, bus=bus) for n in (1, 2, 3)]

    class Look(esair.Reaction):
        p1 = esair.reads(float, optional=True)
        p2 = esair.reads(float, optional=True)
        p3 = esair.reads(float, optional=True)
        w1 = esair.writes(float, blind="release", priority=-1)

        def react(self, **_: Any) -> None: ...

    robot = esair.Robot(resources=[*places, *wheels], behaviors=[Look(), Drives(1.0)])
    async with robot:
        await asyncio.sleep(1.0)
        assert fakes.servos[1].get(GOAL_VELOCITY)
        del fakes.servos[3]
        await asyncio.sleep(ago)
        robot.halt("stop")
        await asyncio.sleep(0.07)
        assert [each.get(GOAL_VELOCITY) for each in fakes.servos.values()] == [0, 0]


@pytest.mark.virtual_clock
@pytest.mark.fault("D30")
@pytest.mark.parametrize("gone", [1, 3])
@pytest.mark.parametrize("ago", [0.0, 0.17])
async def test_nor_from_holding_where_they_are(
    three: tuple[FakeServos, ServoBus], gone: int, ago: float
) -> None:
    """For that they are asked where they are, together; those behind it in the line too."""
    fakes, bus = three
    places = [ServoPosition(name=f"p{n}", id=n, bus=bus) for n in (1, 2, 3)]
    safe = Goal(mode=Mode.HOLD)
    wheels = [Servo(name=f"w{n}", id=n, bus=bus, safe=safe) for n in (1, 2, 3)]

    class Look(esair.Reaction):
        p1 = esair.reads(float, optional=True)
        p2 = esair.reads(float, optional=True)
        p3 = esair.reads(float, optional=True)
        w1 = esair.writes(Goal, blind="release", priority=-1)

        def react(self, **_: Any) -> None: ...

    robot = esair.Robot(
        resources=[*places, *wheels], behaviors=[Look(), Drives(Goal(0.5))]
    )
    async with robot:
        await asyncio.sleep(1.0)
        del fakes.servos[gone]
        await asyncio.sleep(ago)
        before = len(fakes.written)
        robot.halt("stop")
        await asyncio.sleep(0.07)
        told: set[int] = set()
        for servo, instruction, data in fakes.written[before:]:
            if instruction in {WRITE, SYNC_WRITE} and data[0] == GOAL_POSITION:
                told |= {servo} if instruction == WRITE else {*data[4::5]}
        assert told >= {1, 2, 3} - {gone}


@pytest.mark.virtual_clock
@pytest.mark.fault("D29")
@pytest.mark.parametrize("kind", [Servo, ServoVelocity])
async def test_one_that_does_not_answer_is_not_said_to_be_safe(
    three: tuple[FakeServos, ServoBus], kind: Any
) -> None:
    """What several are told in one packet none of them confirms: they are asked."""
    fakes, bus = three
    more, command = ({"safe": RELEASE}, Goal(0.5)) if kind is Servo else ({}, 1.0)
    wheels = [kind(name=f"w{n}", id=n, bus=bus, **more) for n in (1, 2, 3)]
    async with esair.Robot(resources=wheels, behaviors=[Drives(command)]) as robot:
        await asyncio.sleep(1.0)
        del fakes.servos[3]
        told = await robot.halt("stop")
        assert [each.answered for each in told] == [True, True, False]


# The codec.


@pytest.mark.parametrize(
    ("angle", "steps"),
    [(0.0, 2048), (math.pi / 2, 3072), (-math.pi, 0), (math.tau, 6144), (-9.0, -3819)],
)
def test_angles_are_steps_from_the_middle(angle: float, steps: int) -> None:
    """4096 for a turn; below zero after more than half a turn back."""
    assert to_steps(angle) == steps
    assert to_angle(steps & 0xFFFF_FFFF) == pytest.approx(angle, abs=math.tau / 8192)


def test_the_packets_are_those_of_the_document() -> None:
    """The e-manual's example: ping servo 1, and its answer."""
    assert packet(1, PING, b"") == bytes.fromhex("FFFFFD00010300 01 194E")
    assert packet(1, 0x55, bytes.fromhex("00060426")) == bytes.fromhex(
        "FFFFFD00010700 55 00060426 655D"
    )


class Captured:
    """A port of a maker's package that keeps what is written."""

    is_using = False

    def writePort(self, data: list[int]) -> int:  # noqa: N802 - the package's
        self.written = bytes(data)
        return len(data)

    def clearPort(self) -> None:  # noqa: N802
        """There is nothing in it."""


def test_the_packets_are_those_of_the_makers_package() -> None:
    """Told to several at once."""
    port, ids = Captured(), [3, 1, 2, 3, 4, 4, 1, 2, 3, 4]
    Protocol2PacketHandler().syncWriteTxOnly(port, 116, 4, ids, len(ids))
    assert port.written == packet(0xFE, SYNC_WRITE, bytes([116, 0, 4, 0, *ids]))


def test_a_header_within_a_packet_is_stuffed() -> None:
    """Its length says so; the maker's package sends it as it is, and no servo obeys."""
    value = b"\xff\xff\xfd\0"
    told = packet(1, WRITE, b"\x74\0" + value)
    assert told[5:7] + told[10:15] == b"\x0a\0\xff\xff\xfd\xfd\0"
    assert Packets().feed(told) == [bytes([1, WRITE, 0x74, 0]) + value]


def test_bits_of_an_error_have_names() -> None:
    """What the servo says about itself is said in words."""
    assert hardware_errors(0x24) == "overheating, overload"
    assert hardware_errors(0x40) == "code 0x40"


# The bus.


@pytest.mark.virtual_clock
async def test_a_table_is_read_and_written(bus: ServoBus, fakes: FakeServos) -> None:
    """Entries of one, two and four bytes; below zero too."""
    await bus.open()

    for address, size, value in ((64, 1, 1), (100, 2, 885), (104, 4, -5)):
        await bus.write(1, address, size, value)
        found = await bus.read(1, address, size)
        assert found == value & (1 << 8 * size) - 1

    assert fakes.servos[1].get(GOAL_VELOCITY) == -5
    assert fakes.servos[2].get(GOAL_VELOCITY) == 0
    assert len(fakes.written) == 6


@pytest.mark.virtual_clock
@pytest.mark.fault("D14")
async def test_a_servo_that_is_not_there(bus: ServoBus) -> None:
    """The error names it; the others go on."""
    await bus.open()

    with pytest.raises(DeviceFaultError, match="servo 9, ping: There is no status"):
        await bus.ping(9)

    assert await bus.ping(1) == 1060
    assert bus.stats.errors == 1


@pytest.mark.virtual_clock
@pytest.mark.fault("D10")
async def test_a_damaged_answer_is_a_fault(bus: ServoBus, fakes: FakeServos) -> None:
    """Its value is never used."""
    await bus.open()
    fakes.garble()

    with pytest.raises(DeviceFaultError, match="servo 1, read 132"):
        await bus.read(1, 132, 4)

    assert bus.stats.bad_frames == 1
    assert await bus.read(1, 132, 4) == CENTER


@pytest.mark.virtual_clock
@pytest.mark.fault("D26")
@pytest.mark.parametrize("size", [0, 3, 20])
async def test_an_answer_of_another_length_is_a_fault(size: int) -> None:
    """It is no position, and costs the others on the line nothing."""

    class Strange(FakeServo):
        def obey(self, instruction: int, parameters: bytes) -> bytes:
            told = super().obey(instruction, parameters)
            return told[:1] + bytes(size) if instruction == READ else told

    bus = ServoBus(name="arm", wire=FakeServos({1: Strange(), 2: FakeServo()}))
    await bus.open()
    await bus.set_up(1)
    await bus.set_up(2)

    for asked in ([1], [1, 2]):
        found: list[Any] = await asyncio.gather(
            *(bus.snapshot(servo) for servo in asked), return_exceptions=True
        )
        assert isinstance(found[0], DeviceFaultError)
        assert f"servo 1, read 224: it has told {size} bytes" in str(found[0])
        assert [each.position for each in found[1:]] == [CENTER] * (len(asked) - 1)
    await bus.close()


@pytest.mark.virtual_clock
@pytest.mark.fault("D26")
async def test_what_a_servo_refuses_is_told_in_its_words(bus: ServoBus) -> None:
    """There is no such entry in its table."""
    await bus.open()

    with pytest.raises(DeviceFaultError, match="not available to target address"):
        await bus.write(1, 251, 4, 0)


@pytest.mark.virtual_clock
async def test_a_servo_that_has_shut_down_says_why(
    bus: ServoBus, fakes: FakeServos
) -> None:
    """Its own protection has taken the torque away."""
    await bus.open()
    fakes.servos[1].shut_down = 0x20

    with pytest.raises(DeviceFaultError, match="servo 1 has shut down: overload"):
        await bus.read(1, 132, 4)


@pytest.mark.virtual_clock
@pytest.mark.fault("I05")
@pytest.mark.promise("BUS-1")
async def test_requests_of_many_never_overlap(bus: ServoBus) -> None:
    """One wire, one question at a time, each answer to its own asker."""
    await bus.open()

    await asyncio.gather(
        *(bus.write(servo, GOAL_POSITION, 4, 1000 + servo) for servo in (1, 2))
    )
    found = await asyncio.gather(
        *(bus.read(servo, GOAL_POSITION, 4) for servo in (1, 2) * 10)
    )

    assert found == [1001, 1002] * 10


# The actuator.


@pytest.mark.virtual_clock
async def test_a_goal_goes_before_the_torque(bus: ServoBus, fakes: FakeServos) -> None:
    """With torque first it would jump to the goal that it had before."""
    servo = Servo(safe=RELEASE, bus=bus)
    await bus.open()
    await servo.open()
    fakes.written.clear()

    await servo.write(Goal(math.pi / 2))
    await servo.write(Goal(0.0))

    writes = [
        (int.from_bytes(data[:2], "little"), int.from_bytes(data[2:], "little"))
        for _, instruction, data in fakes.written
        if instruction == WRITE
    ]
    assert writes[:2] == [(GOAL_POSITION, 3072), (TORQUE_ENABLE, 1)]
    assert fakes.servos[1].get(GOAL_POSITION) == CENTER
    assert [address for address, _ in writes].count(TORQUE_ENABLE) == 1


@pytest.mark.virtual_clock
async def test_hold_and_release(bus: ServoBus, fakes: FakeServos) -> None:
    """It holds where it is, not where it was sent; released it can be moved by hand."""
    servo = Servo(safe=RELEASE, bus=bus)
    await bus.open()
    await servo.open()
    await servo.write(Goal(1.0))
    await servo.write(RELEASE)
    assert not fakes.servos[1].torque
    fakes.servos[1].put(132, 2500)

    await servo.write(HOLD)

    assert fakes.servos[1].torque
    assert fakes.servos[1].get(GOAL_POSITION) == 2500


@pytest.mark.virtual_clock
async def test_it_holds_at_the_end_of_its_way(bus: ServoBus, fakes: FakeServos) -> None:
    """It sags by some steps beyond its least goal, which it would not take."""
    servo = Servo(safe=HOLD, bus=bus)
    fakes.servos[1].put(LEAST, 100)
    await bus.open()
    await servo.open()
    await servo.write(Goal(to_angle(100)))
    fakes.servos[1].put(PRESENT_POSITION, 97)

    await servo.write(HOLD)

    assert fakes.servos[1].get(GOAL_POSITION) == 100


@pytest.mark.virtual_clock
@pytest.mark.parametrize(("turned", "held"), [(-3, 4093), (4100, 4), (9000, 808)])
async def test_it_holds_where_it_was_turned_to_by_hand(
    bus: ServoBus, fakes: FakeServos, turned: int, held: int
) -> None:
    """Without torque it counts the turns, which it forgets as the torque comes."""
    servo = Servo(safe=HOLD, bus=bus)
    fakes.servos[1].put(PRESENT_POSITION, turned)
    await bus.open()
    await servo.open()

    await servo.write(HOLD)

    assert fakes.servos[1].torque
    assert fakes.servos[1].get(PRESENT_POSITION) == held


@pytest.mark.virtual_clock
async def test_a_goal_beyond_its_own_limits_is_cut_off(
    bus: ServoBus, fakes: FakeServos
) -> None:
    """It would stay where it is without a word; what it was told instead is returned."""
    servo = Servo(safe=RELEASE, bus=bus)
    fakes.servos[1].put(GREATEST, 3000)
    await bus.open()
    await servo.open()

    assert await servo.write(Goal(0.5)) is None
    assert await servo.write(Goal(2.5)) == Goal(to_angle(3000))
    await servo.bus.read(1, PRESENT_POSITION, 4)

    assert fakes.servos[1].get(PRESENT_POSITION) == 3000


@pytest.mark.virtual_clock
@pytest.mark.parametrize(
    ("kind", "limit", "goal", "taken"),
    [
        (ServoVelocity, FASTEST, GOAL_VELOCITY, 200),
        (ServoCurrent, STRONGEST, GOAL_CURRENT, 100),
    ],
)
@pytest.mark.parametrize("sign", [1, -1])
async def test_what_is_more_than_it_takes_is_cut_off(
    bus: ServoBus,
    fakes: FakeServos,
    kind: Any,
    limit: int,
    goal: int,
    taken: int,
    sign: int,
) -> None:
    """A velocity or a current, as a goal: it would not change without a word."""
    servo = kind(bus=bus)
    fakes.servos[1].put(limit, taken)
    most = taken * (bus.table.velocity_unit if kind is ServoVelocity else 0.00269)
    await bus.open()
    await servo.open()

    assert await servo.write(sign * most) is None
    assert await servo.write(sign * servo.limits[1]) == pytest.approx(sign * most)
    await bus.read(1, PRESENT_POSITION, 4)

    size = 4 if kind is ServoVelocity else 2
    data = fakes.servos[1].table[goal : goal + size]
    assert int.from_bytes(data, "little", signed=True) == sign * taken


@pytest.mark.virtual_clock
async def test_its_speed_is_a_setting(bus: ServoBus, fakes: FakeServos) -> None:
    """In rad/s; the unit of the table is 0.229 turns per minute."""
    servo = Servo(safe=RELEASE, bus=bus)
    await bus.open()

    for speed, units in ((0.0, 0), (0.001, 1), (1.0, 42)):
        await servo.apply(speed=speed)
        assert fakes.servos[1].get(PROFILE_VELOCITY) == units


@pytest.mark.virtual_clock
async def test_a_speed_that_would_be_a_time_is_not_told(
    fakes: FakeServos, bus: ServoBus
) -> None:
    """Another program has left the drive mode so: 1 rad/s would be 42 ms for any way."""
    servo = Servo(id=1, safe=RELEASE, bus=bus)
    fakes.servos[1].table[10] = 4
    await bus.open()
    await servo.open()
    with pytest.raises(DeviceFaultError, match="takes a speed for a time"):
        await servo.apply(speed=1.0)
    assert fakes.servos[1].get(PROFILE_VELOCITY) == 0
    await servo.apply(speed=0.0)


@pytest.mark.virtual_clock
@pytest.mark.promise("ROB-2")
@pytest.mark.parametrize("safe", [RELEASE, HOLD])
async def test_a_robot_leaves_it_safe(
    bus: ServoBus, fakes: FakeServos, safe: Goal
) -> None:
    """As the declaration says: without torque, or holding where it was."""
    servo = Servo(name="elbow", safe=safe, bus=bus)
    position = ServoPosition(name="angle", bus=bus)

    class Wave(esair.Behavior):
        elbow = esair.writes(Goal)
        angle = esair.reads(float)

        async def run(self) -> None:
            await self.elbow.write(Goal(0.8))
            assert await self.angle.read(fresh=True) == pytest.approx(0.8, abs=0.001)
            self.offer(True)
            await asyncio.Event().wait()

    async with esair.Robot(resources=[servo, position], behaviors=[Wave()]) as robot:
        await robot.behaviors.get(sender="wave", receiver="user", interval=9.0)

    assert fakes.servos[1].torque is (safe is HOLD)
    assert to_angle(fakes.servos[1].get(132)) == pytest.approx(0.8, abs=0.001)


# On a terminal.


class Terminal:
    """Servos on a pseudo-terminal, played by a thread."""

    def __init__(self, fakes: FakeServos) -> None:
        self.master, self.slave = pty.openpty()
        tty.setraw(self.slave)
        self.path = os.ttyname(self.slave)
        self.noise = b""
        self._fakes = fakes
        self._thread = threading.Thread(target=self._play)
        self._thread.start()

    def _play(self) -> None:
        while True:
            try:
                data = os.read(self.master, 4096)
            except OSError:
                return
            if data.startswith(b"bye"):
                return
            os.write(self.master, self.noise + self._fakes.heard(data))

    def hang_up(self) -> None:
        if self.master < 0:
            return
        os.write(self.slave, b"bye")
        self._thread.join(5)
        os.close(self.master)
        os.close(self.slave)
        self.master = self.slave = -1


@pytest.fixture
def terminal(fakes: FakeServos) -> Iterator[Terminal]:
    found = Terminal(fakes)
    yield found
    found.hang_up()


@pytest.mark.real_clock
@pytest.mark.fault("D01")
async def test_on_a_terminal(terminal: Terminal, fakes: FakeServos) -> None:
    """The SDK's packets through the kernel; a pulled cable is a loss."""
    bus = ServoBus(name="arm", port=terminal.path, timeout=5.0)
    await bus.open()

    assert await bus.ping(2) == 1060
    await bus.write(2, GOAL_POSITION, 4, 1234)
    assert fakes.servos[2].get(GOAL_POSITION) == 1234
    await asyncio.to_thread(terminal.hang_up)
    with pytest.raises(DeviceLostError, match="'arm'"):
        await bus.ping(2)

    assert not bus.is_open
    with pytest.raises(DeviceLostError):
        await bus.open()
    await bus.close()


@pytest.mark.real_clock
@pytest.mark.fault("D16")
async def test_a_line_that_takes_no_bytes(terminal: Terminal) -> None:
    """The request ends in time, and the next one works."""
    bus = ServoBus(name="arm", port=terminal.path, timeout=5.0)
    await bus.open()
    termios.tcflow(terminal.slave, termios.TCOOFF)

    with pytest.raises(DriverStuckError, match=r"write did not return in 0\.05 s"):
        await bus.ping(1)

    termios.tcflow(terminal.slave, termios.TCOON)
    assert await bus.ping(1) == 1060
    await bus.close()


@pytest.mark.real_clock
async def test_an_adapter_is_told_to_keep_nothing_back(
    terminal: Terminal, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Then that of FTDI passes on in 1 ms what it keeps for 16 ms; others have no such flag."""
    flags, real = 0x1000, fcntl.ioctl

    def ioctl(fd: int, request: int, state: Any = 0, *rest: Any) -> Any:
        nonlocal flags
        if request == termios.TIOCGSERIAL:
            struct.pack_into("=i", state, 16, flags)
        elif request == termios.TIOCSSERIAL:
            (flags,) = struct.unpack_from("=i", state, 16)
        else:
            return real(fd, request, state, *rest)
        return 0

    monkeypatch.setattr(fcntl, "ioctl", ioctl)
    bus = ServoBus(name="arm", port=terminal.path)
    await bus.open()
    assert await bus.ping(1) == 1060
    await bus.close()

    assert flags == 0x1000 | 0x2000, "ASYNC_LOW_LATENCY, and what was there"


def test_its_limits_are_the_angles_that_it_can_reach(bus: ServoBus) -> None:
    """A whole turn is one step less than two π: the servo refuses step 4096."""
    servo = Servo(name="elbow", bus=bus, safe=RELEASE)

    low, high = servo.limits["angle"]  # type: ignore[call-overload, index, misc]

    assert (to_steps(low), to_steps(high)) == (0, 4095)


@pytest.mark.real_clock
@pytest.mark.fault("D09")
async def test_noise_before_an_answer(terminal: Terminal) -> None:
    """The answer behind it is found."""
    bus = ServoBus(name="arm", port=terminal.path, timeout=5.0)
    terminal.noise = b"\xff\xff\x00\x13garbage"
    await bus.open()

    assert await bus.ping(1) == 1060

    await bus.close()


@pytest.mark.real_clock
@pytest.mark.fault("D13", "D20")
async def test_a_line_that_is_never_silent_ends_a_request(terminal: Terminal) -> None:
    """Answers of others, without end, cost the asker its time and nobody else any."""
    bus = ServoBus(name="arm", port=terminal.path, timeout=5.0)
    await bus.open()
    flood = threading.Event()
    other = packet(7, 0x55, struct.pack("<BHB", 0, 1060, 45)) * 20

    def babble() -> None:
        while not flood.is_set():
            with contextlib.suppress(BlockingIOError):  # nobody reads any more
                os.write(terminal.master, other)
            flood.wait(0.001)

    os.set_blocking(terminal.master, False)
    thread = threading.Thread(target=babble)
    thread.start()
    try:
        with pytest.raises(DeviceFaultError, match="servo 9"):
            async with asyncio.timeout(4):
                await bus.ping(9)
    finally:
        flood.set()
        thread.join(5)
    await bus.close()


def test_one_servo_obeys_its_table() -> None:
    """The fake is a servo: without torque it goes nowhere."""
    servo = FakeServo()
    servo.obey(WRITE, struct.pack("<Hi", GOAL_POSITION, 100))
    assert servo.get(132) == CENTER

    servo.obey(WRITE, struct.pack("<HB", TORQUE_ENABLE, 1))

    assert servo.get(132) == 100


@pytest.mark.virtual_clock
@pytest.mark.promise("RES-4")
async def test_a_goal_for_a_servo_that_has_restarted_is_not_done(
    bus: ServoBus, fakes: FakeServos
) -> None:
    """Without torque it takes every goal, and goes to none of them."""
    servo = Servo(safe=RELEASE, bus=bus)
    await bus.open()
    await servo.open()
    await servo.write(Goal(0.5))
    fakes.servos[1].power_cycle()
    for _ in range(3):
        with pytest.raises(DeviceLostError, match="it has restarted"):
            await servo.write(Goal(0.7))
    await servo.open()
    await servo.write(Goal(0.7))
    assert fakes.servos[1].torque


@pytest.mark.virtual_clock
@pytest.mark.promise("BUS-5")
async def test_what_is_urgent_waits_for_no_silent_servos() -> None:
    """Others are asked one by one, as they do not answer: it has the next turn."""
    fakes = FakeServos([1])
    bus = ServoBus(name="arm", wire=fakes)
    await bus.open()
    fakes.servos[1].put(TORQUE_ENABLE, 1)
    silent = [bus.read(number, PRESENT_POSITION, 4) for number in range(2, 8)]
    asking = asyncio.gather(*silent, return_exceptions=True)
    await asyncio.sleep(0.1)
    urgency.set(urgent := Urgency())

    with urgent.raised(SAFE):
        began = esair.now()
        await bus.write(1, TORQUE_ENABLE, 1, 0)

    assert esair.now() - began <= 0.051
    assert not fakes.servos[1].torque
    assert not asking.done()
    await asking
    await bus.close()


@pytest.mark.promise("BUS-5")
@pytest.mark.parametrize(("baudrate", "is_found"), [(57_600, True), (1_000_000, False)])
def test_more_than_the_line_can_carry_is_found(baudrate: int, is_found: bool) -> None:
    """Ten positions at 50 Hz are 110 kbit/s; at the speed that servos come with it is 58."""
    bus = ServoBus(name="arm", port="/dev/ttyS9", baudrate=baudrate)
    places = [ServoPosition(name=f"p{n}", id=n, bus=bus) for n in range(10)]
    found = examine(esair.Robot(resources=places).plan)
    assert any(each.rule == "load" for each in found) is is_found
