"""Modbus units, by RTU and TCP: codec, framing, sensor, actuator."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import random
import socket
import threading
import time
from collections.abc import Iterator
from typing import Any

import hypothesis
import pytest
from hypothesis import strategies as st

import esair
from esair.buses import SerialBus
from esair.exceptions import (
    ConfigError,
    DeviceFaultError,
    DeviceLostError,
    DriverStuckError,
)
from esair.framing import ModbusRtu, ModbusTcp
from esair.messages import ResourceState
from esair.plan import examine
from esair.testing import (
    ActuatorContract,
    BusContract,
    FakeSerial,
    GatewayContract,
    SensorContract,
)

pytest.importorskip("pymodbus", reason="the extra 'modbus' is not installed")

from tests.drivers.parts import Powered

from esair.drivers.modbus import ModbusActuator, ModbusSensor
from esair.drivers.modbus.fake import FakeModbus

RTU, TCP = "modbus-rtu", "modbus-tcp"

pytestmark = pytest.mark.virtual_clock


def make(framing: str = RTU) -> tuple[FakeSerial, FakeModbus]:
    line = FakeSerial("plc", framing=framing)
    unit = FakeModbus(
        line,
        {8: 0, 9: 0, 20: 0x4148, 21: 0},
        inputs={0: 0xFFFE},
        coils={3: False},
        discretes={4: True},
        unit=3,
    )
    return line, unit


class OnUnit(Powered, GatewayContract):
    framing = RTU

    def wire(self) -> FakeSerial:
        line, self.far = make(self.framing)
        return line

    async def silence_by_proxy(self, _device: Any) -> None:
        """A gateway answers: no way to it, no answer of it, busy, in turn."""
        codes = itertools.cycle((11, 10, 5, 6))
        self.far.refuse = lambda _function, _address: next(codes)

    async def speak(self, device: Any) -> None:
        await super().speak(device)
        self.far.refuse = lambda _function, _address: 0

    keeps_nothing = "each request says all that the unit needs"


class TestSensor(OnUnit, SensorContract):
    def make(self) -> Any:
        return ModbusSensor(unit=3, register=20, type="float32", bus=self.wire())


class TestBit(OnUnit, SensorContract):
    framing = TCP

    def make(self) -> Any:
        return ModbusSensor(unit=3, register=4, table="discrete", bus=self.wire())


class TestActuator(OnUnit, ActuatorContract):
    def make(self) -> Any:
        return ModbusActuator(
            unit=3, register=8, type="int32", factor=0.1, safe=0.0, bus=self.wire()
        )

    def commands(self) -> list[Any]:
        return [12.5, -1000.0]


class TestCoil(OnUnit, ActuatorContract):
    framing = TCP

    def make(self) -> Any:
        return ModbusActuator(
            unit=3, register=3, table="coil", safe=False, bus=self.wire()
        )

    def commands(self) -> list[Any]:
        return [True]


class TestReadBack(OnUnit, ActuatorContract):
    keeps_nothing = ""

    def make(self) -> Any:
        device = ModbusActuator(
            unit=3, register=8, safe=5.0, reads_back=True, bus=self.wire()
        )
        device.set_up_period = 0.1  # before what is safe is told again
        return device

    def commands(self) -> list[Any]:
        return [12.0, -1000.0]


class TestCoilReadBack(TestReadBack):
    framing = TCP

    def make(self) -> Any:
        device = ModbusActuator(
            unit=3,
            register=3,
            table="coil",
            safe=True,
            reads_back=True,
            bus=self.wire(),
        )
        device.set_up_period = 0.1
        return device

    def commands(self) -> list[Any]:
        return [False, True]


@pytest.mark.promise("BUS-4", "RES-4")
@pytest.mark.parametrize("is_silent", [False, True])
async def test_what_is_read_back_is_noticed_without_a_command(is_silent: bool) -> None:
    """One that restarted with its output on is made safe; one that is silent is lost."""
    line, unit = make()
    device = ModbusActuator(
        name="pump", unit=3, register=8, safe=0.0, reads_back=True, bus=line
    )
    async with esair.Robot(resources=[device]) as robot:
        await asyncio.sleep(3.0)
        assert robot.resources.query("pump").losses == 0
        unit.holding[8], unit.silent = 77, is_silent
        await asyncio.sleep(3.0)
        status = robot.resources.query("pump")
        assert status.losses == 1
        assert (status.state is ResourceState.READY) is not is_silent
        assert unit.holding[8] == (77 if is_silent else 0)


@pytest.mark.promise("AC-1")
@pytest.mark.parametrize(
    ("factor", "command", "sent"),
    [
        (10.0, 14.0, 10.0), (10.0, 20.0, None), (10.0, 26.0, 20.0), (10.0, -26.0, -20.0),
        (-10.0, 26.0, 20.0), (-10.0, -14.0, -10.0), (0.1, 0.3, None), (0.1, 0.26, 0.3),
    ],
)  # fmt: skip
async def test_what_was_really_told_is_returned(
    factor: float, command: float, sent: float | None
) -> None:
    """In the units of the register; rounding goes beyond no limit."""
    line, unit = make()
    pump = ModbusActuator(
        unit=3, register=8, safe=0.0, factor=factor, limits=(-26.0, 26.0), bus=line
    )
    await line.open()
    told = await pump.write(command)
    assert told == (None if sent is None else pytest.approx(sent))
    raw = unit.holding[8] - (unit.holding[8] >> 15 << 16)
    assert raw * factor == pytest.approx(command if sent is None else sent)
    await line.close()


class TestLine(BusContract):
    """Whose an answer is: two reads of one function cannot be told apart on RTU."""

    framing = RTU

    def make(self) -> FakeSerial:
        line, self.far = make(self.framing)
        line.late_limit = 0.2
        self.far.inputs = {n: n for n in range(256)}
        return line

    async def use(self, bus: Any) -> None:
        assert await self.ask(bus, 7) == 7

    async def ask(self, bus: Any, number: int) -> int:
        device = ModbusSensor(
            unit=3, register=number, table="input", bus=bus, timeout=1.0
        )
        return int(await device.read())

    async def delay(self, bus: Any, seconds: float) -> None:
        loop = asyncio.get_running_loop()

        def answer(message: bytes) -> None:
            said = self.far.hear(message)
            assert said is not None
            loop.call_later(seconds, bus.say, said)

        bus.on_frame = answer


class TestTcpLine(TestLine):
    framing = TCP


@pytest.mark.parametrize("framing", [RTU, TCP])
async def test_values_are_read_and_told_in_their_type(framing: str) -> None:
    """Each table, one register or several, in both orders of the words."""
    line, unit = make(framing)
    await line.open()
    read = lambda **options: ModbusSensor(unit=3, bus=line, **options).read()  # noqa: E731
    assert await read(register=20, type="float32") == 12.5
    assert await read(register=0, table="input") == -2
    assert await read(register=0, table="input", type="uint16") == 65534
    assert await read(register=0, table="input", factor=0.5) == -1.0
    assert await read(register=4, table="discrete") is True
    assert await read(register=3, table="coil") is False
    tell = ModbusActuator(
        unit=3, register=8, type="int32", word_order="little", safe=0, bus=line
    )
    await tell.write(-2.0)
    assert (unit.holding[8], unit.holding[9]) == (0xFFFE, 0xFFFF)
    one = ModbusActuator(unit=3, register=9, safe=0, factor=0.1, bus=line)
    await one.write(1.25)
    assert unit.holding[9] == 12
    assert [request[0] for request in unit.heard[-2:]] == [16, 6]
    await line.close()


@pytest.mark.promise("AC-1")
@pytest.mark.parametrize("kind", ["int16", "uint32", "int64", "uint64", "float32"])
@pytest.mark.parametrize("factor", [1.0, 0.1, -3.0])
async def test_both_ends_of_its_limits_can_be_told(kind: Any, factor: float) -> None:
    """Of 64 bits no float is the greatest number: the next one is more."""
    line = FakeSerial("plc", framing=RTU)
    FakeModbus(line, dict.fromkeys(range(4), 0))
    device = ModbusActuator(register=0, type=kind, factor=factor, safe=0, bus=line)
    await line.open()
    for end in device.limits:
        await device.write(end)
    await line.close()


@pytest.mark.fault("D26")
@pytest.mark.parametrize(
    ("baudrate", "least"), [(9600, 3.5 * 11 / 9600), (115200, 0.00175)]
)
async def test_silence_separates_a_request_from_the_answer_before(
    baudrate: int, least: float
) -> None:
    """By the standard a unit takes what comes sooner for the rest of that answer."""
    line = FakeSerial("plc", framing=RTU, baudrate=baudrate)
    FakeModbus(line, {8: 80, 9: 90}, unit=3)
    hear, times = line.on_frame, []

    def heard(message: bytes) -> bytes | None:
        times.append(asyncio.get_running_loop().time())
        return hear(message) if hear is not None else None

    line.on_frame = heard
    flows = [ModbusSensor(name=f"f{n}", unit=3, register=n, bus=line) for n in (8, 9)]
    await line.open()
    assert await asyncio.gather(*(flow.read() for flow in flows)) == [80.0, 90.0]
    assert times[1] - times[0] >= least
    await line.close()


async def test_a_refusal_is_a_fault_and_a_stranger_is_no_answer() -> None:
    """In words; another unit's answer, or one of the wrong size, is not taken."""
    line, unit = make()
    await line.open()
    device = ModbusSensor(unit=3, register=99, bus=line)
    with pytest.raises(DeviceFaultError, match="holding 99: it has no such register"):
        await device.read()
    unit.refuse = lambda _function, _address: 4
    with pytest.raises(DeviceFaultError, match="it has failed"):
        await device.read()
    unit.refuse = lambda _function, _address: 6
    with pytest.raises(DeviceLostError, match="holding 99: it is busy"):
        await device.read()
    line.on_frame = lambda _message: b"\x04\x03\x02\x00\x07"
    with pytest.raises(DriverStuckError):
        await device.read()
    line.on_frame = lambda _message: b"\x03\x03\x04\x00\x07\x00\x08"
    await asyncio.sleep(1.0)
    with pytest.raises(DeviceFaultError, match="2 registers, not 1"):
        await device.read()
    await line.close()


async def test_the_watchdogs_bytes_make_it_safe() -> None:
    """On a serial line."""
    line, unit = make()
    device = ModbusActuator(unit=3, register=8, safe=5.0, bus=line)
    (frame,) = device.safe_frames().frames
    assert ModbusRtu().feed(frame) == [b"\x03\x06\x00\x08\x00\x05"]
    assert unit.hear(b"\x03\x06\x00\x08\x00\x05") == b"\x03\x06\x00\x08\x00\x05"


@hypothesis.given(st.lists(st.binary(max_size=12), max_size=6), st.data())
@pytest.mark.fault("D08", "D09")
def test_a_message_is_found_behind_some_garbage(
    garbage: list[bytes], data: st.DataObject
) -> None:
    """However it is cut, once a request has been sent; no bytes break the search."""
    for framing, message in [
        (ModbusRtu(), b"\x03\x03\x04\x00\x07\x00\x08"),
        (ModbusTcp(), b"\x00\x01\x03\x03\x04\x00\x07\x00\x08"),
    ]:
        for each in garbage:
            framing.feed(each)
        wire = framing.encode(message)
        framing.reset()
        cut = data.draw(st.integers(0, len(wire)))
        assert framing.feed(wire[:cut]) + framing.feed(wire[cut:]) == [message]


NOISE = bytes(range(0x30, 0x50))


@hypothesis.given(st.lists(st.one_of(st.binary(max_size=40), st.none()), max_size=8))
@hypothesis.example([NOISE, None])
@pytest.mark.fault("D08", "D09")
def test_the_same_comes_out_however_it_is_cut(
    parts: list[bytes | None],
) -> None:
    """An answer behind more noise than it is long, in one piece with it, is found."""
    for framing, message in [
        (ModbusRtu(), b"\x03\x03\x04\x00\x07\x00\x08"),
        (ModbusTcp(), b"\x00\x01\x03\x03\x04\x00\x07\x00\x08"),
    ]:
        frame = framing.encode(message)
        wire = b"".join(frame if part is None else part for part in parts)
        whole, single = framing.fresh(), framing.fresh()
        found = whole.feed(wire)
        assert found == [message] or parts != [NOISE, None]
        assert [got for at in wire for got in single.feed(bytes([at]))] == found
        assert single.discarded == whole.discarded
        assert single.bad_frames == whole.bad_frames


@pytest.mark.fault("D08", "D09")
@pytest.mark.parametrize("piece", [1, 2, 3, 5, 8, 12])
def test_a_stray_byte_costs_one_answer_of_tcp(piece: int) -> None:
    """Also when it comes in pieces: the rest of a message is not taken for the next."""
    framing = ModbusTcp()
    answers = [number.to_bytes(2, "big") + b"\x03\x05\0\3\0\0" for number in (257, 258)]
    wire = b"\x11" + b"".join(map(framing.encode, answers))

    found = [framing.feed(wire[at : at + piece]) for at in range(0, len(wire), piece)]

    assert list(itertools.chain(*found)) in (answers, answers[1:])
    assert framing.bad_frames == 1


def test_garbage_costs_little() -> None:
    """50 ms of CPU for a megabyte, in chunks as a line brings them."""
    for chunk in (bytes([3, 3, 250]) * 85, bytes(range(256)), b"\xff" * 64):
        for framing in (ModbusRtu(), ModbusTcp()):
            begin = time.process_time()
            for _ in range(200_000 // len(chunk)):
                framing.feed(chunk)
            assert time.process_time() - begin < 0.2 * 0.05 * 5, "five times a bad day"


class Server:
    """A unit that listens on this computer, for one client after the other."""

    def __init__(self) -> None:
        self.socket = socket.create_server(("127.0.0.1", 0))
        self.port = self.socket.getsockname()[1]
        _, self.far = make(TCP)
        threading.Thread(target=self.serve, daemon=True).start()

    def serve(self) -> None:
        while True:
            try:
                connection, _ = self.socket.accept()
            except OSError:
                return
            framing = ModbusTcp()
            while data := connection.recv(4096):
                for message in framing.feed(data):
                    answer = self.far.hear(message)
                    assert answer is not None
                    connection.sendall(framing.encode(answer))
            connection.close()


@pytest.fixture
def server() -> Iterator[Server]:
    server = Server()
    yield server
    server.socket.shutdown(socket.SHUT_RDWR)
    server.socket.close()


@pytest.mark.real_clock
async def test_it_works_by_tcp(server: Server) -> None:
    """Through pyserial's own way to a socket."""
    line = SerialBus(
        name="plc", port=f"socket://127.0.0.1:{server.port}", framing="modbus-tcp"
    )
    await line.open()
    sensor = ModbusSensor(unit=3, register=20, type="float32", bus=line, timeout=5.0)
    assert await sensor.read() == 12.5
    await line.close()


@pytest.mark.promise("BUS-3")
@pytest.mark.parametrize(
    ("register", "type_", "answer"),
    [
        (8, "int16", b"\x03\x06\x00\x09\x00\x05"),
        (8, "int16", b"\x03\x06\x00\x08\x00\x07"),
        (8, "int32", b"\x03\x10\x00\x08\x00\x01"),
    ],
)
async def test_what_was_not_told_is_not_confirmed(
    register: int, type_: Any, answer: bytes
) -> None:
    """An answer names its register and value: that of another request is no answer."""
    line, _ = make()
    device = ModbusActuator(unit=3, register=register, type=type_, safe=0, bus=line)
    await line.open()
    await device.open()
    line.on_frame = lambda _request: answer

    with pytest.raises(DeviceFaultError, match="it confirms what it was not told"):
        await device.write(5)
    await line.close()


class Pump(esair.Behavior):
    """Uses both, whatever comes of it."""

    level = esair.reads(float)
    valve = esair.writes(float)

    async def run(self) -> None:
        """Ask and tell ten times a second."""
        async for _ in esair.every(0.1):
            with contextlib.suppress(esair.EsairError):
                await self.level.read(fresh=True)
            with contextlib.suppress(esair.EsairError):
                await self.valve.write(12.5)


@pytest.mark.soak
@pytest.mark.promise("RES-3")
@pytest.mark.parametrize("framing", [RTU, TCP])
async def test_a_unit_behind_a_gateway_is_there_soon_after_its_power(
    framing: str,
) -> None:
    """A hundred outages from none to ten minutes: READY within 10 s of power, each time."""
    chance = random.Random(28)
    line, far = make(framing)
    sensor = ModbusSensor(name="level", unit=3, register=20, type="float32", bus=line)
    valve = ModbusActuator(
        name="valve", unit=3, register=8, type="int32", factor=0.1, safe=0.0, bus=line
    )
    codes = itertools.cycle((11, 10, 5, 6))
    delays: list[float] = []
    far.refuse = lambda _function, _address: next(codes)  # from the start on

    async with esair.Robot(resources=[sensor, valve], behaviors=[Pump()]) as robot:

        def states() -> set[ResourceState]:
            return {robot.resources.query(name).state for name in ("level", "valve")}

        for _ in range(100):
            await asyncio.sleep(
                chance.choice((0.3, 5.0, 60.0, 600.0)) * chance.random()
            )
            assert ResourceState.FAILED not in states()
            far.refuse = lambda _function, _address: 0
            since = esair.now()
            while states() != {ResourceState.READY}:
                assert esair.now() - since <= 10.0
                await asyncio.sleep(0.02)
            delays.append(esair.now() - since)
            far.refuse = lambda _function, _address: next(codes)
            while ResourceState.READY in states():  # noqa: ASYNC110
                await asyncio.sleep(0.02)
    assert len(delays) == 100


def test_nobody_answers_for_all_units_of_a_line() -> None:
    """Behind a gateway 0 is a unit as any other."""
    ModbusSensor(unit=0, register=0, bus=FakeSerial("cabinet", framing=TCP))
    with pytest.raises(ConfigError, match="unit: expected 1 to 255, not 0"):
        ModbusSensor(unit=0, register=0, bus=FakeSerial("plc", framing=RTU))


@pytest.mark.promise("BUS-5")
@pytest.mark.parametrize(("framing", "is_found"), [(RTU, True), (TCP, False)])
def test_a_request_its_answer_and_their_silence_take_their_time(
    framing: str, is_found: bool
) -> None:
    """Ten registers at 5 Hz are more than 9600 bits a second carry."""
    line = SerialBus(name="plc", port="/dev/ttyS9", baudrate=9600, framing=framing)
    sensors = [
        ModbusSensor(name=f"s{n}", unit=3, register=n, rate=5.0, bus=line)
        for n in range(10)
    ]
    found = examine(esair.Robot(resources=sensors).plan)
    assert any(each.rule == "load" for each in found) is is_found
