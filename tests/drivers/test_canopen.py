"""Objects of a CANopen node: by SDO and PDO, with its identity and heartbeat."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import os
import struct
import threading
import time
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any, ClassVar

import can
import pytest
from canopen.objectdictionary import import_od
from hypothesis import given
from hypothesis import strategies as st
from tests.drivers.parts import opened

import esair
from esair.buses import CanBus, Frame
from esair.drivers.canopen import (
    CanopenActuator,
    CanopenNetwork,
    CanopenSensor,
    Mapped,
)
from esair.drivers.canopen.fake import FakeCanopenNode
from esair.exceptions import (
    BusyError,
    ConfigError,
    DeviceFaultError,
    DeviceLostError,
    DriverStuckError,
)
from esair.testing import (
    ActuatorContract,
    BusContract,
    FakeCan,
    GatewayContract,
    SensorContract,
)

MOTOR = Path(__file__).parent / "motor.eds"
PATIENCE = 10.0  # s; the node answers at once, on a machine that may be busy

pytestmark = pytest.mark.virtual_clock


@pytest.fixture
def rig(fake_can: Callable[..., Any]) -> Callable[[], Any]:
    """Put a node on a bus: the wire and the node."""

    def make() -> tuple[Any, FakeCanopenNode]:
        wire = fake_can("drive")
        node = FakeCanopenNode(wire, MOTOR, node=5)
        return wire, node

    return make


def sensor(wire: Any, object_: Any = "Position actual value", **keywords: Any) -> Any:
    return CanopenSensor(
        bus=wire,
        object=object_,
        **{"node": 5, "eds": MOTOR, "sdo_timeout": PATIENCE, **keywords},
    )


def actuator(wire: Any, object_: Any = "Target velocity", **keywords: Any) -> Any:
    return CanopenActuator(
        bus=wire,
        object=object_,
        **{
            "node": 5,
            "eds": MOTOR,
            "safe": 0,
            "sdo_timeout": PATIENCE,
            **keywords,
        },
    )


class Wired(GatewayContract):
    @pytest.fixture(autouse=True)
    def _rig(self, rig: Callable[[], Any]) -> None:
        self.rig = rig

    def wire(self) -> Any:
        self.on_wire, self.node = self.rig()
        return self.on_wire

    async def unplug(self, _device: Any) -> None:
        self.on_wire.unplug()

    async def silence(self, device: Any) -> None:
        device.sdo_timeout = 0.02
        self.node.stop()

    async def speak(self, device: Any) -> None:
        device.sdo_timeout = PATIENCE
        self.node.refuse(0x1000, 0, 0)
        self.node.boot()

    async def silence_by_proxy(self, _device: Any) -> None:
        """A gateway to its network has waited for it in vain."""
        self.node.refuse(0x1000, 0, 0x05040000)
        self.node.local.nmt.stop_heartbeat()

    async def power_cycle(self, _device: Any) -> None:
        self.node.power_cycle()


class TestCanopenOnABus(BusContract):
    """Whose an SDO answer is: the package takes any that comes."""

    pytestmark: ClassVar[list[Any]] = [pytest.mark.real_clock]

    @pytest.fixture(autouse=True)
    async def _closed(self) -> AsyncIterator[None]:
        yield
        await self.device.close()

    def make(self) -> Any:
        self.wire = FakeCan("drive")
        self.node = FakeCanopenNode(self.wire, MOTOR, node=5)
        self.device = sensor(self.wire, sdo_timeout=0.08)
        return self.wire

    async def use(self, bus: Any) -> None:
        await self.device.open()
        await self.device.read()
        await self.device.close()

    async def ask(self, bus: Any, number: int) -> int:
        if self.device._link is None:
            await self.device.open()
        self.node[0x6064] = number
        with contextlib.suppress(DeviceLostError):
            return int(await self.device.read())
        return number  # it was told that there was no answer

    async def delay(self, bus: Any, seconds: float) -> None:
        self.node.delay = seconds


class TestSensor(Wired, SensorContract):
    def make(self) -> Any:
        return sensor(self.wire())


class TestPdoSensor(Wired, SensorContract):
    def make(self) -> Any:
        made = sensor(self.wire(), pdo=True, factor=0.5)

        def push() -> None:
            self.node.send_pdo(1)
            self.timer = asyncio.get_running_loop().call_later(0.01, push)

        push()
        return made


class TestActuator(Wired, ActuatorContract):
    def make(self) -> Any:
        return actuator(self.wire(), factor=0.1, safe=0.0)

    def commands(self) -> list[Any]:
        return [500.0, -500.0, 0.123]


@pytest.mark.real_clock
@pytest.mark.promise("BUS-3")
async def test_a_late_sdo_answer_is_never_that_to_the_next_request() -> None:
    """The request that was given up is owed one; it is counted and nobody's."""
    wire = FakeCan("drive")
    node = FakeCanopenNode(wire, MOTOR, node=5)
    device = sensor(wire)
    async with opened(device):
        node[0x6064] = 1
        node.delay, device.sdo_timeout = 0.25, 0.05
        with pytest.raises(DeviceLostError):
            await device.read()
        node[0x6064] = 2
        node.delay, device.sdo_timeout = 0.0, PATIENCE

        assert await device.read() == 2
        assert wire.stats.late == 1


@pytest.mark.real_clock
@pytest.mark.promise("BUS-3")
async def test_what_a_tool_on_the_bus_is_told_is_no_answer() -> None:
    """Its request goes to the same node, and the answer has the same id."""
    wire = FakeCan("drive")
    node = FakeCanopenNode(wire, MOTOR, node=5)
    told = [
        Frame(0x585, bytes((kind, 0, 0x20, 1, 0, 0, 2, 6))) for kind in (96, 75, 128)
    ]
    motor, place = actuator(wire), sensor(wire)
    async with opened(motor, place):
        node.delay = 0.05
        wire.answer(0x605, told)
        begin = asyncio.get_running_loop().time()
        await motor.write(7)
        assert asyncio.get_running_loop().time() - begin >= 0.05
        assert await place.read() == 0
        assert node[0x60FF] == 7


@pytest.mark.promise("BUS-4")
async def test_an_emergency_is_heard_and_told(
    rig: Any, caplog: pytest.LogCaptureFixture
) -> None:
    """To every device on the node, and once in the log, not each of a flood."""
    wire, node = rig()
    position, velocity = sensor(wire), actuator(wire)
    async with opened(position, velocity):
        for _ in range(50):
            node.emergency(0x4210, 0x08, b"hot!!")
        wire.feed(0x85, b"short")
        node.emergency(0)
        await asyncio.sleep(0.01)

        told = [str(each) for each in velocity.emergencies]
        assert len(told) == 16, "the newest"
        assert "0x4210 (Temperature), register 0x08" in told[0]
        assert position.emergencies[-1].code == 0
        assert caplog.text.count("0x4210") == 1


@pytest.mark.parametrize(
    ("object_", "put", "wanted", "kind"),
    [
        ("Position actual value", -123456, -123456, int),
        ([0x6064, 0], 7, 7, int),
        (0x6041, 0x237, 0x237, int),
        ("Gains.Integral", 0.75, 0.75, float),
        ([0x2000, 2], 0.75, 0.75, float),
        ("Brake", True, True, bool),
        ("Serial text", "x" * 100, "x" * 100, str),
    ],
)
async def test_objects_are_read_by_name_or_index(
    rig: Any, object_: Any, put: Any, wanted: Any, kind: type
) -> None:
    """Of the type that the file says; a long one in several segments."""
    wire, node = rig()
    if kind is float:
        node.local.sdo["Gains"]["Integral"].raw = put
    else:
        node[object_ if isinstance(object_, str | int) else object_[0]] = put
    device = sensor(wire, object_ if isinstance(object_, str | int) else tuple(object_))
    async with opened(device):
        assert device.value_type is kind
        value = await device.read()
        assert value == wanted
        assert type(value) is kind


async def test_what_a_real_number_cannot_hold_is_beyond_its_limits(rig: Any) -> None:
    """Else it were an error of the driver, which is a fault of the node; in its unit."""
    wire, _ = rig()
    gain = actuator(wire, "Gains.Integral", safe=0.0, factor=0.01)
    assert gain.limits == pytest.approx((-3.4e36, 3.4e36))


@pytest.mark.real_clock
async def test_each_device_waits_as_long_as_it_says(rig: Any) -> None:
    """Not as long as the one that asks the node after it."""
    wire, node = rig()
    slow = sensor(wire, sdo_timeout=1.0)
    quick = sensor(wire, "Brake", sdo_timeout=0.1)
    async with opened(slow, quick):
        node.delay = 0.2
        asked = slow.read(), quick.read()
        done = await asyncio.gather(*asked, return_exceptions=True)
        node.delay = 0.0
    assert done[0] == 0
    assert isinstance(done[1], DeviceLostError)


async def test_a_factor_makes_a_unit(rig: Any) -> None:
    """Both ways; the limits of the file are in the unit too."""
    wire, node = rig()
    node[0x6064] = 1500
    position = sensor(wire, factor=0.001)
    velocity = actuator(wire, factor=0.01, safe=0.0)
    assert velocity.limits == (-50.0, 50.0)
    async with opened(position, velocity):
        assert await position.read() == pytest.approx(1.5)
        await velocity.write(-12.344)
    assert node.written[-1] == (0x60FF, 0, -1234)


async def test_devices_on_one_node_open_it_once(rig: Any) -> None:
    """It is started once; the last that leaves ends the listening."""
    wire, node = rig()
    devices = [sensor(wire), sensor(wire, "Brake"), actuator(wire)]
    assert node.state == "PRE-OPERATIONAL"
    async with opened(*devices):
        assert node.state == "OPERATIONAL"
        starts = [frame for frame in wire.sent if frame.id == 0]
        assert [frame.data for frame in starts] == [bytes([1, 5])]
        await devices[0].close()
        assert await devices[1].read() is True
        with pytest.raises(DeviceLostError, match="not open"):
            await devices[0].read()


@pytest.mark.fault("D04")
async def test_a_node_is_started_with_its_safe_command(rig: Any) -> None:
    """It never runs with what it was told before: whoever is on it opens it."""
    wire, node = rig()
    node[0x60FF] = 1000
    position, velocity = sensor(wire, name="position"), actuator(wire, name="motor")
    at_the_start = []

    def look(frame: Any) -> None:
        if frame.id == 0:
            at_the_start.append(node[0x60FF])

    wire.on_send(look)
    async with esair.Robot(resources=[position, velocity]):
        pass
    assert at_the_start == [0]


async def test_a_node_that_is_told_nothing_before_its_start_is_started(
    rig: Any,
) -> None:
    """The safe command is then the first thing that it is told."""
    wire, node = rig()
    node.refuse(0x60FF, 0, 0x08000022)
    async with opened(actuator(wire)):
        assert node.state == "OPERATIONAL"


async def test_an_abort_is_a_fault_in_the_words_of_the_standard(rig: Any) -> None:
    """The node is there and says why it does not."""
    wire, node = rig()
    velocity, position = actuator(wire), sensor(wire)
    async with opened(velocity, position):
        node.refuse(0x60FF, 0, 0x08000022)
        node.refuse(0x6064, 0, 0x06060000)
        with pytest.raises(DeviceFaultError, match="present device state"):
            await velocity.write(1)
        with pytest.raises(DeviceFaultError, match="hardware error"):
            await position.read()


@pytest.mark.fault("D01")
async def test_a_node_that_is_not_there_is_lost(
    rig: Any, caplog: pytest.LogCaptureFixture
) -> None:
    """At its opening, and when it falls silent later; without a heartbeat too."""
    wire, node = rig()
    node.stop()
    device = sensor(wire, sdo_timeout=0.05)
    patient = sensor(wire)
    await wire.open()
    with pytest.raises(DeviceLostError, match="node 5 does not answer"):
        await device.open()
    await device.close()

    node.boot()
    async with opened(patient):
        node.stop()
        patient.sdo_timeout = 0.05
        with pytest.raises(DeviceLostError, match="node 5 does not answer"):
            await patient.read()
    assert caplog.text == "", "the package has nothing to add"


@pytest.mark.fault("D05")
@pytest.mark.parametrize("subindex", [1, 2])
async def test_another_device_with_that_id_is_refused(rig: Any, subindex: int) -> None:
    """Vendor and product are compared with the file."""
    wire, node = rig()
    node.local.sdo[0x1018][subindex].raw = 0x999
    device = sensor(wire)
    await wire.open()
    with pytest.raises(DeviceFaultError, match="0x999 instead of 0x"):
        await device.open()
    await device.close()
    await wire.close()


@pytest.mark.promise("BUS-4")
async def test_who_joins_a_node_has_the_heartbeat_that_it_needs(rig: Any) -> None:
    """Though the node is open already, for a device that needs none."""
    wire, node = rig()
    motor, place = actuator(wire, name="motor"), sensor(wire, name="at", heartbeat=0.05)
    async with esair.Robot(resources=[motor]) as robot:
        await asyncio.sleep(0.5)
        await robot.resources.add(place)
        await asyncio.sleep(0.5)
        motor.sdo_timeout = place.sdo_timeout = 0.02
        node.stop()
        await asyncio.sleep(0.2)
        states = [robot.resources.query(name).state for name in ("motor", "at")]
        assert esair.ResourceState.READY not in states


@pytest.mark.fault("D03", "D04")
@pytest.mark.parametrize("what", ["silence", "restart"])
async def test_the_heartbeat_tells_the_loss_of_a_node(rig: Any, what: str) -> None:
    """Of one that nobody uses; it comes back safe, and nothing else is written."""
    wire, node = rig()
    device = actuator(wire, name="motor", heartbeat=0.05)
    policy = esair.Policy("motor", allow={"me": esair.Access.WRITE})
    async with esair.Robot(resources=[device], policies=[policy]) as robot:
        right = await robot.resources.register("me", "motor", esair.Access.WRITE)
        await robot.actuators.write(right, 1000)
        assert node[0x1017] == 50
        if what == "silence":
            node.stop()
        else:
            node.boot()
        await asyncio.sleep(0.16)
        assert robot.resources.query("motor").losses == 1
        if what == "silence":
            node.boot()
        await asyncio.sleep(7.0)
        assert robot.resources.query("motor").state is esair.ResourceState.READY
        assert node.state == "OPERATIONAL"
        velocities = [value for index, _, value in node.written if index == 0x60FF]
        assert velocities.count(1000) == 1
        assert velocities[-1] == 0


async def test_a_pdo_is_a_reading(rig: Any) -> None:
    """The one that holds the object, by the mapping in the node; short ones count."""
    wire, node = rig()
    position = sensor(wire, pdo=True)
    async with opened(position):
        stream = position.stream()
        waiting = asyncio.ensure_future(anext(stream))
        await asyncio.sleep(0)
        wire.feed(0x185, b"\0" * 5)
        node[0x6064] = -77
        node.send_pdo(1)
        assert await waiting == -77
        assert position.bad_frames == 1
        await stream.aclose()
    assert not position.can_be_asked
    assert sensor(wire).can_be_asked


@given(
    index=st.sampled_from([0x6064, 0x6041, 0x2001]),
    length=st.integers(1, 32),
    offset=st.integers(0, 40),
    around=st.integers(0, 2**72 - 1),
    data=st.data(),
)
def test_an_object_may_lie_anywhere_in_a_pdo(
    index: int, length: int, offset: int, around: int, data: st.DataObject
) -> None:
    """Between bytes too, and with fewer bits than it has itself."""
    variable: Any = import_od(str(MOTOR), 5)[index]
    length = 1 if index == 0x2001 else min(length, len(variable))
    signed = index == 0x6064
    least = -(1 << length - 1) if signed else 0
    value = data.draw(st.integers(least, least + (1 << length) - 1))
    mask = (1 << length) - 1
    bits = around & ~(mask << offset) | (value & mask) << offset
    mapped = Mapped(variable, 0x185, 9, offset, length)

    assert mapped.decode(bits.to_bytes(9, "little")) == value


def test_a_number_with_a_point_may_lie_anywhere_in_a_pdo() -> None:
    """It has all its bits."""
    dictionary: Any = import_od(str(MOTOR), 5)
    packed = int.from_bytes(struct.pack("<f", -0.75), "little") << 5

    mapped = Mapped(dictionary[0x2000][1], 0x185, 5, 5, 32)

    assert mapped.decode(packed.to_bytes(5, "little")) == -0.75


@pytest.mark.promise("SC-3")
async def test_what_the_file_does_not_know_has_its_place_in_a_pdo(rig: Any) -> None:
    """Else all behind it would be read from other bits."""
    wire, node = rig()
    node.local.sdo[0x1A00][1].raw = 0x2099_0108
    position = sensor(wire, pdo=True)
    async with opened(position):
        stream = position.stream()
        waiting = asyncio.ensure_future(anext(stream))
        await asyncio.sleep(0)
        wire.feed(0x185, b"\xff" + (-77).to_bytes(4, "little", signed=True))
        assert await waiting == -77
        await stream.aclose()


async def test_each_device_on_a_node_has_the_objects_of_its_own_file(
    rig: Any, tmp_path: Path
) -> None:
    """The node may have been opened for one that knows less of it, as a drive does."""
    wire, node = rig()
    node.local.sdo["Gains"]["Integral"].raw = 0.75
    short = tmp_path / "short.eds"
    short.write_text(MOTOR.read_text().partition("[ManufacturerObjects]")[0])
    position, gain = sensor(wire, eds=short), sensor(wire, "Gains.Integral")
    async with opened(position, gain):
        assert await gain.read() == 0.75


@pytest.mark.fault("D05")
@pytest.mark.parametrize("order", [1, -1])
async def test_a_node_is_compared_with_the_file_of_each_device(
    rig: Any, tmp_path: Path, order: int
) -> None:
    """What is another's file is told, and no command by it, not even a safe one."""
    wire, node = rig()
    wrong = tmp_path / "wrong.eds"
    wrong.write_text(MOTOR.read_text().replace("0x456", "0x457"))
    position = sensor(wire, name="position")
    velocity = actuator(wire, name="motor", eds=wrong)
    async with esair.Robot(resources=[position, velocity][::order]) as robot:
        await asyncio.sleep(1.0)
        assert robot.resources.query("position").state is esair.ResourceState.READY
        assert "another EDS file" in str(robot.resources.query("motor").error)
    assert 0x60FF not in [index for index, _, _ in node.written]


async def test_an_object_that_is_in_no_pdo_is_told(rig: Any) -> None:
    """The set-up of the node decides, not the file."""
    wire, _ = rig()
    device = sensor(wire, "Brake", pdo=True)
    await wire.open()
    with pytest.raises(DeviceFaultError, match="sends no PDO with 'Brake'"):
        await device.open()
    await device.close()
    await wire.close()


@pytest.mark.promise("AC-4")
async def test_a_write_that_waits_gives_way_to_a_newer_one(rig: Any) -> None:
    """It does not reach the node after it."""
    wire, node = rig()
    velocity = actuator(wire)
    async with opened(velocity):
        writes = []
        for value in (1000, 2000, 0):
            writes.append(asyncio.ensure_future(velocity.write(value)))
            await asyncio.sleep(0)
        done = await asyncio.gather(*writes, return_exceptions=True)
    assert isinstance(done[1], BusyError)
    assert done[2] is None
    velocities = [value for index, _, value in node.written if index == 0x60FF]
    assert velocities[-1] == 0
    assert 2000 not in velocities


@pytest.mark.fault("C04")
async def test_a_bus_that_takes_nothing_is_told_in_time(rig: Any) -> None:
    """The thread does not wait longer for room than a frame may."""
    wire, _ = rig()
    device = sensor(wire)
    async with opened(device):

        async def send(*_: Any, **__: Any) -> None:
            raise DriverStuckError("drive", "send", 0.2)

        wire.send = send
        with pytest.raises(DriverStuckError, match="drive"):
            await device.read()
        del wire.send


@pytest.mark.fault("C08")
async def test_nothing_is_sent_periodically(rig: Any) -> None:
    """Not by the kernel either: it would go on when the robot hangs."""
    wire, _ = rig()
    with pytest.raises(DeviceFaultError, match="periodically"):
        CanopenNetwork(wire).send_periodic(0x201, b"", 0.1)


@pytest.mark.fault("C10")
async def test_frames_of_the_wrong_length_end_nothing(rig: Any) -> None:
    """A heartbeat or an answer without a byte, or with one."""
    wire, _ = rig()
    device = sensor(wire)
    async with opened(device):
        for number in (0x585, 0x705):
            wire.feed(number, b"")
            wire.feed(number, b"\x01")
        await asyncio.sleep(0.01)
        assert await device.read() == 0


@pytest.mark.parametrize(
    ("cls", "keywords", "told"),
    [
        (
            CanopenSensor,
            {"object": "Position actual vlaue"},
            "did you mean 'Position act",
        ),
        (
            CanopenSensor,
            {"object": 0x7000},
            "object: there is no object 0x7000; there are",
        ),
        (CanopenSensor, {"object": (0x2000, 9)}, "expected one of Gains.Number"),
        (CanopenSensor, {"object": "Gains"}, "expected one of Gains.Number of entries"),
        (CanopenSensor, {"object": "Secret"}, "object: 'Secret' cannot be read"),
        (CanopenSensor, {"node": 0}, "node: expected 1 to 127, not 0"),
        (CanopenSensor, {"eds": "nowhere.eds"}, "nowhere.eds cannot be read: No such"),
        (CanopenSensor, {"eds": __file__}, "eds: "),
        (CanopenSensor, {"object": "Serial text", "factor": 2.0}, "factor: expected"),
        (CanopenSensor, {"heartbeat": 100}, "heartbeat: expected 0.001 to 65 s"),
        (CanopenActuator, {"object": "Statusword"}, "'Statusword' cannot be written"),
        (
            CanopenActuator,
            {"object": "Target velocity", "safe": 0.5},
            "safe: expected int",
        ),
        (CanopenActuator, {"object": "Target velocity", "safe": 5001}, "-5000 to 5000"),
        (
            CanopenActuator,
            {"object": "Target velocity", "limits": (-9000, 1)},
            "limits: the file allows -5000 to 5000",
        ),
        (
            CanopenActuator,
            {"object": "Target velocity", "limits": (-1, "fast")},
            "limits: expected (least, greatest), not (-1, 'fast')",
        ),
        (
            CanopenActuator,
            {"object": "Target velocity", "limits": 9},
            "limits: expected (least, greatest), not 9",
        ),
    ],
)
def test_mistakes_are_told_when_the_device_is_made(
    cls: Any, keywords: dict[str, Any], told: str
) -> None:
    """With the field, and the nearest names of the file."""
    described: dict[str, Any] = {"node": 5, "eds": MOTOR, "object": "Brake"}
    if cls is CanopenActuator:
        described["safe"] = 0
    with pytest.raises(ConfigError) as caught:
        cls(**{**described, **keywords})
    assert told in str(caught.value)


class FarEnd:
    """What a `FakeCanopenNode` needs of a bus, on a real interface."""

    def __init__(self, bus: CanBus) -> None:
        self.bus = bus
        self.frames = bus.frames(0x000, 0x605, limit=64)
        self.task = asyncio.ensure_future(self._listen())
        self._send = asyncio.Queue[tuple[int, bytes]]()
        self.sender = asyncio.ensure_future(self._send_all())

    def on_send(self, listener: Callable[[Any], Any]) -> None:
        self.listener = listener

    def feed(self, number: int, data: bytes) -> None:
        self._send.put_nowait((number, data))

    async def close(self) -> None:
        for task in (self.task, self.sender):
            task.cancel()
        await asyncio.wait({self.task, self.sender})
        self.frames.close()

    async def _listen(self) -> None:
        async for frame in self.frames:
            self.listener(frame)

    async def _send_all(self) -> None:
        while True:
            await self.bus.send(*await self._send.get())


@pytest.mark.real_clock
async def test_it_works_where_the_lane_of_the_bus_is_needed_to_send() -> None:
    """An interface without a descriptor: neither thread waits for the other."""
    channel = f"canopen-{os.getpid()}"
    near, far = (
        CanBus(name=name, interface="virtual", channel=channel)
        for name in ("near", "far")
    )
    await far.open()
    end = FarEnd(far)
    node = FakeCanopenNode(end, MOTOR, node=5)  # type: ignore[arg-type]
    described: dict[str, Any] = {"node": 5, "eds": MOTOR, "bus": near}
    position = CanopenSensor(object="Position actual value", sdo_timeout=5, **described)
    velocity = CanopenActuator(
        object="Target velocity", safe=0, sdo_timeout=5, **described
    )
    position.deadline = velocity.deadline = 20.0
    async with asyncio.timeout(30), opened(position, velocity):
        for value in range(20):
            node[0x6064] = value
            assert await position.read() == value
            await velocity.write(value)
            assert node.written[-1] == (0x60FF, 0, value)
    node.stop()
    await end.close()
    await far.close()


@pytest.mark.real_clock
@pytest.mark.promise("BUS-4")
@pytest.mark.parametrize("seconds", [0.55, 0.8])
async def test_heartbeats_that_came_while_the_loop_stood_still_count(
    seconds: float,
) -> None:
    """The node was there all the time; this computer was held up."""
    channel = f"canopen-still-{os.getpid()}"
    near, far = (
        CanBus(name=name, interface="virtual", channel=channel)
        for name in ("near", "far")
    )
    await far.open()
    end, over = FarEnd(far), threading.Event()
    node = FakeCanopenNode(end, MOTOR, node=5)  # type: ignore[arg-type]

    beats: list[float] = []

    def live() -> None:
        beat = can.Message(arbitration_id=0x705, data=[5], is_extended_id=False)
        with can.Bus(interface="virtual", channel=channel) as bus:
            while not over.wait(0.02):
                beats.append(time.monotonic())
                bus.send(beat)

    heart = threading.Thread(target=live)
    heart.start()
    described: dict[str, Any] = {"node": 5, "eds": MOTOR, "bus": near}
    device = CanopenSensor(
        object="Position actual value", heartbeat=0.2, sdo_timeout=5, **described
    )
    device.deadline = 20.0
    lost: list[BaseException | None] = []
    device._listener = lost.append
    try:
        async with asyncio.timeout(30), opened(device):
            for _ in range(2):
                await asyncio.sleep(0.3)
                time.sleep(seconds)  # noqa: ASYNC251 - it is what is tried
            await asyncio.sleep(0.1)
        pauses = (after - before for before, after in itertools.pairwise(beats))
        assert lost == [] or max(pauses) > 0.3, "it was no pause of the node"
    finally:
        over.set()
        heart.join()
        node.stop()
        await end.close()
        await far.close()
