"""Control units by UDS over ISO-TP: long answers, sessions, and who is absent."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import itertools
import threading
import weakref
from collections.abc import Callable
from typing import Any

import pytest
from tests.drivers.parts import OnCan, opened

pytest.importorskip("udsoncan", reason="pip install 'esair[uds]'")
pytest.importorskip("isotp", reason="pip install 'esair[uds]'")

import isotp

import esair
from esair.buses import CanBus, Frame
from esair.buses.can import FakeCan
from esair.drivers.uds import IsoTp, UdsActuator, UdsSensor
from esair.drivers.uds.fake import FakeUnit
from esair.exceptions import (
    BadValueError,
    ConfigError,
    DeviceFaultError,
    DeviceLostError,
    DriverStuckError,
)
from esair.testing import ActuatorContract, GatewayContract, SensorContract

pytestmark = pytest.mark.virtual_clock

VALUES = {0xF405: b"\x7b", 0x0123: b"\x00", 0xF190: b"WVWZZZ1JZXW000001"}


class OnUnit(OnCan):
    def unit(self) -> FakeCan:
        self.far = FakeUnit(self.wire, VALUES)
        wire: FakeCan = self.wire
        return wire

    async def silence_by_proxy(self, _device: Any) -> None:
        self.far.refuse = 0x25

    async def speak(self, _device: Any) -> None:
        self.far.silent, self.far.refuse = False, 0


class TestSensor(OnUnit, GatewayContract, SensorContract):
    keeps_nothing = "it is told nothing"

    def make(self) -> UdsSensor:
        return UdsSensor(identifier=0xF405, layout="B", offset=-40.0, bus=self.unit())


class TestText(OnUnit, SensorContract):
    keeps_nothing = "it is told nothing"

    def make(self) -> UdsSensor:
        return UdsSensor(identifier=0xF190, layout="17s", bus=self.unit())


class TestControl(OnUnit, GatewayContract, ActuatorContract):
    def make(self) -> UdsActuator:
        return UdsActuator(
            identifier=0x0123, layout="B", scale=0.01, safe=0.0, bus=self.unit()
        )

    def commands(self) -> list[Any]:
        return [0.5, 1.0]


class TestWrite(TestControl):
    def make(self) -> UdsActuator:
        return UdsActuator(
            identifier=0x0123, layout="B", safe=1.0, by="write", bus=self.unit()
        )


async def test_what_is_read_is_in_its_unit() -> None:
    """A number is scaled; a text comes in several frames."""
    can = FakeCan()
    FakeUnit(can, VALUES)
    warm = UdsSensor(identifier=0xF405, layout="B", offset=-40.0, name="w", bus=can)
    text = UdsSensor(identifier=0xF190, layout="17s", name="t", bus=can)
    async with opened(warm, text):
        read = await asyncio.gather(warm.read(), text.read(), warm.read())
        assert list(read) == [83.0, "WVWZZZ1JZXW000001", 83.0]


async def test_an_output_comes_back_by_itself() -> None:
    """The session lives while its tester does; the unit takes its output at its end."""
    can = FakeCan()
    unit = FakeUnit(can, VALUES)
    fan = UdsActuator(identifier=0x0123, layout="B", scale=0.01, safe=0.0, bus=can)
    async with opened(fan):
        await fan.write(0.25)
        assert unit.controlled == {0x0123: bytes([25])}
        await asyncio.sleep(20.0)
        assert await fan.is_set_up()
        unit.silent = True
        await asyncio.sleep(6.0)
        unit.silent = False
        assert not await fan.is_set_up()
        assert unit.controlled == {}
        await fan.open()
        await fan.write(1.0)
    assert unit.controlled == {}


async def test_a_full_bus_ends_no_session() -> None:
    """A sign of life that finds no room is left out; the next one is said."""
    can = FakeCan()
    unit = FakeUnit(can, VALUES)
    fan = UdsActuator(identifier=0x0123, layout="B", scale=0.01, safe=0.0, bus=can)
    async with opened(fan):
        await fan.write(0.25)
        can.full(10_000)
        await asyncio.sleep(2.5)
        can.full(0)
        await asyncio.sleep(20.0)
        assert unit.controlled == {0x0123: bytes([25])}
        assert await fan.is_set_up()


async def test_who_leaves_a_unit_takes_no_answer_of_another() -> None:
    """The last device is closed in the moment in which the next one is opened."""
    can = FakeCan()
    FakeUnit(can, VALUES)
    one, two = (UdsSensor(name=n, identifier=0xF405, layout="B", bus=can) for n in "ab")
    await can.open()
    await one.open()
    await asyncio.gather(one.close(), two.open())
    assert await two.read() == 123.0
    await two.close()
    await can.close()


@pytest.mark.promise("RES-4")
async def test_all_outputs_of_a_unit_notice_that_it_has_restarted() -> None:
    """The first one to notice opens the session again, which the others look at."""
    can = FakeCan()
    unit = FakeUnit(can, {1: b"\0", 2: b"\0"})
    fan, lamp = (
        UdsActuator(name=name, identifier=n, layout="B", safe=0.0, bus=can)
        for n, name in enumerate(("fan", "lamp"), 1)
    )
    async with esair.Robot(resources=[fan]) as robot:
        await asyncio.sleep(0.5)
        await robot.resources.add(lamp)
        await asyncio.sleep(3.2)
        unit.power_cycle()
        await asyncio.sleep(3.0)
        assert [robot.resources.query(n).losses for n in ("fan", "lamp")] == [1, 1]
        assert unit.controlled == {1: b"\0", 2: b"\0"}


class Fan(esair.Behavior):
    """Has the fan turn, whatever it answers."""

    fan = esair.writes(float)

    async def run(self) -> None:
        async for _ in esair.every(0.05):
            with contextlib.suppress(DeviceFaultError, DeviceLostError):
                await self.fan.write(10.0)


@pytest.mark.promise("RES-3", "RES-4")
async def test_a_unit_that_restarts_amid_commands_is_lost_and_not_at_fault() -> None:
    """It refuses them without its session: however often, it is soon there again."""
    can = FakeCan()
    unit = FakeUnit(can, {1: b"\0"})
    fan = UdsActuator(name="fan", identifier=1, layout="B", safe=0.0, bus=can)
    async with esair.Robot(resources=[fan], behaviors=[Fan()]) as robot:
        for _ in range(5):
            await asyncio.sleep(7.3)
            unit.power_cycle()
        await asyncio.sleep(1.0)
        seen = robot.resources.query("fan")
        assert (seen.losses, seen.faults) == (5, 0)
        assert unit.controlled == {1: b"\x0a"}


@pytest.mark.promise("PRO-13")
@pytest.mark.parametrize(
    ("by", "session", "wanted"),
    [("control", 3, 5.0), ("control", 1, None), ("write", 3, None)],
)
def test_only_a_control_ends_with_its_session(
    by: Any, session: int, wanted: float | None
) -> None:
    """What was written stays when this computer dies, and ``check`` has to say so."""
    part = UdsActuator(identifier=1, safe=0.0, by=by, session=session, bus=FakeCan())
    assert part.own_timeout == wanted


async def test_a_unit_has_one_session() -> None:
    """Two devices that want different ones would take it from each other for ever."""
    can = FakeCan()
    FakeUnit(can, {2: b"\0", 3: b"\0"})
    parts = [
        UdsActuator(name=f"s{n}", identifier=n, layout="B", safe=0, session=n, bus=can)
        for n in (2, 3)
    ]
    for part in parts:
        part.required = False
    async with esair.Robot(resources=parts) as robot:
        await asyncio.sleep(60.0)
        found = [robot.resources.query(part.name) for part in parts]
        assert sorted(each.state.name for each in found) == ["FAILED", "READY"]
        assert any("a unit has one" in str(each.error) for each in found)


@pytest.mark.promise("BUS-3")
async def test_an_answer_that_takes_longer_is_nobody_elses() -> None:
    """Whoever asked for it has gone meanwhile: what comes then is old."""
    can = FakeCan()
    sensor = UdsSensor(identifier=0xF405, layout="B", bus=can)

    def answers(data: str) -> Callable[[], None]:
        return can.answer(0x7E0, Frame(0x7E8, bytes.fromhex(data)))

    forget = answers("0462f40501")
    async with opened(sensor):
        forget()
        forget = answers("037f2278")
        asking = asyncio.ensure_future(sensor.read())
        await asyncio.sleep(1.0)
        asking.cancel()
        await asyncio.sleep(1.0)
        forget()
        can.feed(0x7E8, bytes.fromhex("037f2278"))
        await asyncio.sleep(3.0)
        asking = asyncio.ensure_future(sensor.read())
        await asyncio.sleep(0.1)
        answers("0462f40503")
        can.feed(0x7E8, bytes.fromhex("0462f40502"))
        assert await asking == 3.0
        assert len(can.sent) == 3


@pytest.mark.promise("BUS-5")
async def test_a_full_bus_costs_one_answer() -> None:
    """The frame that asks for the rest of it finds no room; the node is heard on."""
    can = FakeCan()
    link = IsoTp.of(can, 0x7E0, 0x7E8)

    def answer(frame: Frame) -> Frame | None:
        told = {1: b"\x10\x08abcdef", 0x30: b"\x21gh"}.get(frame.data[0])
        return None if told is None else Frame(0x7E8, told)

    can.answer(0x7E0, answer)
    await can.open()
    link.join(can, "me")
    forget = can.on_send(lambda _frame: can.full(10_000))
    with pytest.raises(DeviceFaultError, match="no frame was sent"):
        await link.ask(can, b"?", timeout=0.5)
    forget()
    can.full(0)
    assert await link.ask(can, b"?", timeout=2.0) == b"abcdefgh"
    await link.leave("me")
    await can.close()


async def test_a_sign_of_life_cuts_no_message() -> None:
    """Between the frames of one message it would be a new one, and end that."""
    can = FakeCan()
    link = IsoTp.of(can, 0x7E0, 0x7E8)
    await can.open()
    link.join(can, "me")
    asked = asyncio.ensure_future(link.ask(can, bytes(20), timeout=0.5))
    await asyncio.sleep(0.1)
    telling = asyncio.ensure_future(link.tell(can, b"\x3e\x80"))
    await asyncio.sleep(0.1)
    can.feed(0x7E8, b"\x30\0\0")
    await asyncio.sleep(0.1)
    can.feed(0x7E8, b"\x01\x50")
    await asyncio.gather(asked, telling)
    await asyncio.sleep(0.0)

    assert [frame.data[0] for frame in can.sent] == [0x10, 0x21, 0x22, 0x02]
    await link.leave("me")
    await can.close()


async def test_who_needs_longer_is_waited_for() -> None:
    """Response pending is neither an answer nor silence, but has its end."""
    can = FakeCan()
    unit = FakeUnit(can, VALUES)
    sensor = UdsSensor(identifier=0xF405, layout="B", bus=can)
    async with opened(sensor):
        unit.pending = 3
        assert await sensor.read() == 123.0
        unit.silent = True
        asking = asyncio.ensure_future(sensor.read())
        await asyncio.sleep(0.4)
        can.feed(0x7E8, bytes.fromhex("037f2278"))
        await asyncio.sleep(4.0)
        assert not asking.done()
        with pytest.raises(DriverStuckError):
            await asking


@pytest.mark.promise("RES-3")
@pytest.mark.parametrize("code", [0x21, 0x25, 0x37, 0x93])
async def test_who_says_that_it_cannot_yet_is_lost(code: int) -> None:
    """Busy, behind a gateway, in a delay, without power: nothing of it is wrong."""
    can = FakeCan()
    unit = FakeUnit(can, VALUES)
    sensor = UdsSensor(identifier=0xF405, layout="B", bus=can)
    async with opened(sensor):
        unit.refuse = code
        with pytest.raises(DeviceLostError, match="0xf405"):
            await sensor.read()


async def test_a_close_that_is_cut_leaves_no_sign_of_life() -> None:
    """Else the unit would stay in its session, and keep its output as it was told."""
    can = FakeCan()
    unit = FakeUnit(can, VALUES)
    fan = UdsActuator(identifier=0x0123, layout="B", safe=0.0, bus=can)
    await can.open()
    await fan.open()
    unit.silent = True
    with pytest.raises(TimeoutError):
        async with asyncio.timeout(0.1):
            await fan.close()
    can.sent.clear()
    await asyncio.sleep(10.0)
    assert not can.sent
    await can.close()


@pytest.mark.parametrize(
    ("code", "told"),
    [(0x33, "SecurityAccessDenied"), (0x22, "ConditionsNotCorrect"), (0xEE, "238")],
)
async def test_a_refusal_is_told_by_its_name(code: int, told: str) -> None:
    """It is a fault of what was asked, not a loss."""
    can = FakeCan()
    unit = FakeUnit(can, VALUES)
    sensor = UdsSensor(identifier=0xF405, layout="B", bus=can)
    async with opened(sensor):
        unit.refuse = code
        with pytest.raises(DeviceFaultError, match=f"0xf405 is refused: {told}"):
            await sensor.read()


@pytest.mark.parametrize("answer", ["027f22", "0162", "0362f4", "056200000102", "10"])
async def test_half_an_answer_is_none(answer: str) -> None:
    """Whatever comes is a fault, a silence, or nothing; the next answer counts."""
    can = FakeCan()
    unit = FakeUnit(can, VALUES)
    sensor = UdsSensor(identifier=0xF405, layout="B", bus=can)
    async with opened(sensor):
        unit.silent = True
        asking = asyncio.ensure_future(sensor.read())
        await asyncio.sleep(0.1)
        can.feed(0x7E8, bytes.fromhex(answer))
        with pytest.raises((DeviceFaultError, DriverStuckError)):
            await asking
        unit.silent = False
        await asyncio.sleep(1.0)
        assert await sensor.read() == 123.0


@pytest.mark.promise("AC-1")
async def test_a_command_that_does_not_fit_is_no_fault_of_the_unit() -> None:
    """It is refused as what it is, and the unit stays; a safe one stops the start."""
    can = FakeCan()
    FakeUnit(can, VALUES)

    def fan(safe: float) -> UdsActuator:
        return UdsActuator(
            identifier=0x0123, layout="B", safe=safe, name="fan", bus=can
        )

    user = esair.Behavior(name="user", writes={"fan": esair.writes(float)})
    async with esair.Robot(resources=[fan(0.0)], behaviors=[user]) as robot:
        port: Any = user.fan  # type: ignore[attr-defined]
        for _ in range(4):
            with pytest.raises(BadValueError, match=r"256.0 does not fit '>B'"):
                await port.write(256.0)
        assert await port.write(255.0)
        assert robot.resources.query("fan").faults == 0
    with pytest.raises(ExceptionGroup) as told:
        await esair.Robot(resources=[fan(256.0)]).__aenter__()
    assert "safe: does not fit" in str(told.value.exceptions[0])


async def test_what_does_not_fit_is_a_fault() -> None:
    """The answer of another layout is not used."""
    can = FakeCan()
    FakeUnit(can, VALUES)
    wide = UdsSensor(identifier=0xF190, layout="17s", name="wide", bus=can)
    async with opened(wide):
        wide._layout = UdsSensor(identifier=1, layout="I", bus=can)._layout
        with pytest.raises(DeviceFaultError, match="expected 4 bytes"):
            await wide.read()
    with pytest.raises(ConfigError, match="layout: expected one value"):
        UdsSensor(identifier=1, layout="HH", bus=can)


@pytest.mark.real_clock
async def test_another_stack_is_the_unit() -> None:
    """can-isotp's own, in a thread on python-can, with udsoncan's words: 200 bytes."""
    import can
    from udsoncan import Request, Response, services

    with can.Bus(interface="virtual", channel="uds", receive_own_messages=False) as bus:
        notifier = can.Notifier(bus, [])
        stack = isotp.NotifierBasedCanStack(
            bus, notifier, address=isotp.Address(txid=0x7E8, rxid=0x7E0)
        )
        stack.start()
        done = threading.Event()

        def answer() -> None:
            while not done.is_set():
                asked = stack.recv(block=True, timeout=0.05)
                if asked is None:
                    continue
                request = Request.from_payload(bytes(asked))
                text = bytes(request.data) + bytes(
                    itertools.islice(itertools.cycle(b"ab"), 200)
                )
                service = services.ReadDataByIdentifier
                stack.send(Response(service, 0, text).get_payload())

        answering = threading.Thread(target=answer)
        answering.start()
        try:
            robot = CanBus(name="drive", interface="virtual", channel="uds")
            sensor = UdsSensor(identifier=0xF190, layout="200s", timeout=5.0, bus=robot)
            async with opened(sensor):
                assert await sensor.read() == "ab" * 100
        finally:
            done.set()
            answering.join()
            stack.stop()
            notifier.stop()


async def test_long_requests_are_cut_and_go_their_own_way(
    fake_can: Callable[..., FakeCan],
) -> None:
    """ISO-TP alone, both ways; one request at a time, however many ask."""
    wire = fake_can("drive")
    FakeUnit(wire, VALUES)
    link = IsoTp.of(wire, 0x7E0, 0x7E8)
    await wire.open()
    link.join(wire, "me")
    await link.ask(wire, b"\x10\x03", b"\x50", timeout=1.0)
    asked = [b"\x2e\x01\x23" + bytes([n]) * 100 for n in range(5)]
    answers = await asyncio.gather(
        *(link.ask(wire, each, b"\x6e", b"\x7f", timeout=1.0) for each in asked)
    )
    assert answers == [b"\x6e\x01\x23"] * 5
    await link.leave("me")
    await wire.close()


async def test_a_bus_that_nobody_has_is_forgotten_with_what_its_devices_shared() -> (
    None
):
    """A robot that is made anew again and again keeps no bus of a former one."""
    wire = FakeCan("drive")
    UdsActuator(identifier=1, layout="B", safe=0.0, bus=wire)
    kept = weakref.ref(wire)

    del wire
    gc.collect()

    assert kept() is None
