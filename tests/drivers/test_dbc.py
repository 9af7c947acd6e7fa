"""Messages of a DBC file as sensors and actuators."""

from __future__ import annotations

import asyncio
from contextlib import aclosing, suppress
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.drivers.parts import OnCan, opened

import esair
from esair.buses import CanBus, Frame
from esair.drivers.dbc import DbcActuator, DbcSensor, MessageCodec, find_message
from esair.drivers.dbc._j1939 import Reassembly
from esair.drivers.dbc.fake import FakeDbcNode
from esair.exceptions import (
    BadValueError,
    ConfigError,
    DeviceFaultError,
    DeviceLostError,
)
from esair.testing import ActuatorContract, SensorContract

ROVER = Path(__file__).parent / "rover.dbc"

pytestmark = pytest.mark.virtual_clock


def driven(device: esair.Resource) -> esair.Robot:
    """A robot with one device, which "me" may write."""
    policy = esair.Policy(device.name, allow={"me": esair.Access.WRITE})
    return esair.Robot(resources=[device], policies=[policy])


def command(wire: Any, **keywords: Any) -> DbcActuator:
    """The wheels' command, with a gear that is always the same."""
    return DbcActuator(
        name="wheels",
        bus=wire,
        database=ROVER,
        **{
            "message": "WheelCommand",
            "safe": {"left": 0.0, "right": 0.0},
            "fixed": {"gear": "low"},
            "sequence": "count",
            **keywords,
        },
    )


def feedback(wire: Any, **keywords: Any) -> DbcSensor:
    return DbcSensor(
        bus=wire, database=ROVER, **{"message": "WheelFeedback", **keywords}
    )


class Wired(OnCan):
    """A node on the bus of a device under test, whose class has a ``make``."""

    def node(self) -> Any:
        self.far = FakeDbcNode(self.wire, ROVER)
        return self.wire

    async def silence(self, _device: Any) -> None:
        self.far.stop()

    async def speak(self, _device: Any) -> None:
        self.start()

    def start(self) -> None:
        """Send what it sends, if it sends anything."""

    keeps_nothing = "each frame says all that the node needs"


class TestActuator(Wired, ActuatorContract):
    is_heard = False  # nothing answers a frame

    def make(self) -> DbcActuator:
        return command(self.node(), cycle=0.02)

    def commands(self) -> list[Any]:
        return [{"left": 2.0, "right": -2.0}, {"left": 1, "right": 0.5}]


class TestOneSignalActuator(Wired, ActuatorContract):
    is_heard = False

    def make(self) -> DbcActuator:
        return command(self.node(), signal="left", safe=0.0)

    def commands(self) -> list[Any]:
        return [2.0, -2.0]


class TestSensor(Wired, SensorContract):
    @pytest.fixture(autouse=True)
    def _still(self) -> Any:
        yield
        self.far.stop()

    def make(self) -> DbcSensor:
        made = feedback(self.node(), silent_after=0.2)
        self.start()
        return made

    def start(self) -> None:
        self.far.send_every(0.01, "WheelFeedback", speed=1.5, mode=1, current=-3.0)


async def test_a_command_reaches_the_node_with_what_is_fixed_and_counted(
    fake_can: Any,
) -> None:
    """A sequence signal counts the frames, modulo what it can hold."""
    wire = fake_can("drive")
    node = FakeDbcNode(wire, ROVER)

    async with opened(command(wire)) as wheels:
        for _ in range(257):
            await wheels.write({"left": -1.25, "right": 2})
        await asyncio.sleep(0)

    assert node.heard[0].signals == {"left": -1.25, "right": 2, "gear": 1, "count": 0}
    assert [heard.signals["count"] for heard in list(node.heard)[-2:]] == [255, 0]


async def test_one_signal_is_a_number_and_the_others_rest(fake_can: Any) -> None:
    """What is neither commanded nor fixed is at its initial value, or nearest to 0."""
    wire = fake_can("drive")

    async with opened(command(wire, signal="right", safe=0.0)) as wheels:
        assert wheels.value_type is float
        assert wheels.limits == (-2.0, 2.0)
        await wheels.write(0.5)
        await asyncio.sleep(0)

    assert wire.sent[-1].data == bytes([0, 0, 0xF4, 1, 1, 0])


@pytest.mark.promise("AC-1")
async def test_what_is_rounded_is_told_and_beyond_no_limit(fake_can: Any) -> None:
    """A frame has thousandths: half of one is none, and 0.0015 would be 0.002."""
    wire = fake_can("drive")
    one = command(wire, signal="left", safe=0.0, limits=(-1.0, 0.0015))

    async with opened(command(wire), one) as wheels:
        assert await wheels.write({"left": 0.5, "right": 1}) is None
        told = await wheels.write({"left": 0.0014, "right": 1})
        assert told == {"left": 0.001, "right": 1}
        assert await one.write(0.0015) == 0.001
        await asyncio.sleep(0)

    assert wire.sent[-1].data[:2] == bytes([1, 0])


@pytest.mark.promise("AC-1")
async def test_what_is_rounded_to_the_greatest_is_that(
    fake_can: Any, tmp_path: Path
) -> None:
    """Three times 0.1 is a bit more than 0.3, which the file allows."""
    (path := tmp_path / "tenths.dbc").write_text(
        'VERSION ""\nNS_ :\nBS_:\nBU_: A\nBO_ 5 Tenths: 8 A\n'
        ' SG_ page M : 0|8@1+ (1,0) [0|1] "" A\n'
        ' SG_ plain : 8|8@1+ (0.1,0) [0|0.3] "" A\n'
        ' SG_ paged m0 : 16|8@1+ (0.1,0) [0|0.3] "" A\n'
    )
    wire = fake_can("drive")
    safe = {"page": 0, "plain": 0.0, "paged": 0.0}
    tenths = DbcActuator(bus=wire, database=path, message="Tenths", safe=safe)

    async with opened(tenths):
        told = await tenths.write({"page": 0, "plain": 0.29, "paged": 0.29})
        await asyncio.sleep(0)

    assert told == {"page": 0, "plain": 0.3, "paged": 0.3}
    assert wire.sent[-1].data[:3] == bytes([0, 3, 3])


async def test_limits_come_from_the_file_and_can_be_narrowed(fake_can: Any) -> None:
    """By [min|max], or else by what the bits can hold; wider is a mistake."""
    wire = fake_can("drive")
    assert command(wire).limits == {"left": (-2.0, 2.0), "right": (-2.0, 2.0)}
    narrow = command(wire, limits={"left": (-1, 1)})
    assert narrow.limits == {"left": (-1, 1), "right": (-2.0, 2.0)}
    amps = DbcActuator(
        bus=wire, database=ROVER, message="WheelFeedback", signal="current", safe=0.0
    )
    assert amps.limits == pytest.approx((-300.0, 355.35))

    with pytest.raises(ConfigError, match=r"limits.left: the file allows -2 to 2"):
        command(wire, limits={"left": (-3, 1)})
    with pytest.raises(ConfigError, match=r"limits.left: expected \(least"):
        command(wire, limits={"left": 3})
    with pytest.raises(ConfigError, match=r"limits.knob: it is multiplexed"):
        DbcActuator(
            database=ROVER,
            message="Panel",
            safe={"page": 0, "voltage": 0.0},
            limits={"knob": (0, 1)},
        )


@pytest.mark.promise("AC-1")
@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        ({"left": 0.0}, "right"),
        ({"left": 0.0, "rigth": 0.0}, "rigth: there is no such signal; did you mean"),
        ({"left": 0.0, "right": 2.5}, "right: expected -2 to 2, not 2.5"),
        ({"left": 0.0, "right": float("nan")}, "expected a finite number"),
        ({"left": 0.0, "right": "fast"}, "'fast' is no choice"),
        ({"left": None, "right": 0.0}, "left: expected a number"),
        ({"left": 0.0, "right": 0.0, "gear": 1}, "gear: there is no such signal"),
        (0.0, "expected dict"),
    ],
)
async def test_what_does_not_fit_is_refused_before_it_leaves(
    fake_can: Any, wrong: Any, told: str
) -> None:
    """The writer learns which signal it is; the device has no fault."""
    wire = fake_can("drive")
    async with driven(command(wire)) as robot:
        right = await robot.resources.register("me", "wheels", esair.Access.WRITE)
        await robot.actuators.write(right, {"left": 1.0, "right": 1})
        await asyncio.sleep(0)
        sent = len(wire.sent)

        with pytest.raises(BadValueError, match="wheels") as caught:
            await robot.actuators.write(right, wrong)

        await asyncio.sleep(0)
        assert told in str(caught.value)
        assert len(wire.sent) == sent
        assert robot.resources.query("wheels").faults == 0


async def test_choices_are_names_or_numbers(fake_can: Any) -> None:
    """Both ways; a wrong name is refused with the nearest."""
    wire = fake_can("drive")
    gear = DbcActuator(
        name="gear",
        bus=wire,
        database=ROVER,
        message="WheelCommand",
        signal="gear",
        safe="neutral",
    )
    async with driven(gear) as robot:
        right = await robot.resources.register("me", "gear", esair.Access.WRITE)
        await robot.actuators.write(right, "high")
        await asyncio.sleep(0)
        assert wire.sent[-1].data[4] == 2
        with pytest.raises(BadValueError, match="did you mean 'low'"):
            await robot.actuators.write(right, "lwo")
    assert wire.sent[-1].data[4] == 0

    node = FakeDbcNode(wire, ROVER)
    for choices, wanted in (("numbers", [7, 3]), ("names", ["fault", "3"])):
        async with opened(feedback(wire, signal="mode", choices=choices)) as sensor:
            assert await taken(sensor, node, {"mode": 7}, {"mode": 3}) == wanted
    async with opened(feedback(wire, choices="names")) as sensor:
        (value,) = await taken(sensor, node, {"mode": 1})
        assert value == {"speed": 0.5, "mode": "on", "current": 0.0}


async def taken(
    sensor: DbcSensor, node: FakeDbcNode, *sent: dict[str, Any]
) -> list[Any]:
    """What a sensor gives for some frames of feedback."""
    async with aclosing(sensor.stream()) as stream:  # type: ignore[type-var]
        values = []
        for signals in sent:
            waiting = asyncio.ensure_future(anext(stream))
            await asyncio.sleep(0)
            node.send("WheelFeedback", **{"speed": 0.5, "current": 0.0, **signals})
            values.append(await waiting)
    return values


async def test_a_multiplexed_message_has_the_signals_of_its_page(fake_can: Any) -> None:
    """Both ways, with a 29-bit id; a signal of the other page is no reading."""
    wire = fake_can("drive")
    whole = DbcSensor(bus=wire, database=ROVER, message="Panel")
    knob = DbcSensor(bus=wire, database=ROVER, message="Panel", signal="knob")
    node = FakeDbcNode(wire, ROVER)
    async with opened(whole):
        streams = [whole.stream(), knob.stream()]
        first = [asyncio.ensure_future(anext(stream)) for stream in streams]
        await asyncio.sleep(0)
        node.send("Panel", page=0, voltage=24.5)
        node.send("Panel", page=1, button=1, knob=42)
        assert await first[0] == {"page": 0, "voltage": 24.5}
        assert await first[1] == 42
        assert await anext(streams[0]) == {"page": 1, "button": 1, "knob": 42}
        for stream in streams:
            await stream.aclose()

    panel = DbcActuator(
        name="panel",
        bus=wire,
        database=ROVER,
        message="Panel",
        safe={"page": 0, "voltage": 0.0},
    )
    async with driven(panel) as robot:
        right = await robot.resources.register("me", "panel", esair.Access.WRITE)
        await robot.actuators.write(right, {"page": 1, "button": 2, "knob": 3})
        await asyncio.sleep(0)
        assert wire.sent[-1].extended
        for wrong, told in (
            ({"page": 1, "voltage": 1.0}, 'signal "button" is required'),
            ({"page": 0, "voltage": 1.0, "knob": 1}, "knob: the multiplexer does not"),
            ({"page": 1, "button": 2, "knob": 101}, "knob: expected 0 to 100"),
            ({"page": 2}, "page: expected 0 to 1, not 2"),
        ):
            with pytest.raises(BadValueError, match="panel") as caught:
                await robot.actuators.write(right, wrong)
            assert told in str(caught.value)


@pytest.mark.fault("C10")
async def test_bad_frames_are_counted_and_ten_in_a_row_are_a_fault(
    fake_can: Any,
) -> None:
    """The wrong length, and the same number as a 29-bit id, which is another id."""
    wire = fake_can("drive")
    node = FakeDbcNode(wire, ROVER)
    async with opened(feedback(wire, signal="speed")) as sensor:
        stream = sensor.stream()
        waiting = asyncio.ensure_future(anext(stream))
        await asyncio.sleep(0)
        for length in (0, 4, 6, 8):
            wire.feed(257, bytes(length))
        wire.feed(257, b"\xff" * 5, extended=True)
        node.send("WheelFeedback", speed=0.25, mode=0, current=0.0)
        assert await waiting == 0.25
        assert sensor.bad_frames == 4

        for _ in range(10):
            wire.feed(257, b"abc")
        with pytest.raises(DeviceFaultError, match="10 bad frames in a row"):
            await anext(stream)


@pytest.mark.fault("D15")
async def test_a_frame_that_does_not_count_on_is_no_reading(fake_can: Any) -> None:
    """Ten in a row are a fault; what is left out by the numbers is counted."""
    wire = fake_can("drive")
    node = FakeDbcNode(wire, ROVER)
    device: Any = DbcSensor(
        bus=wire,
        database=ROVER,
        message="WheelCommand",
        signal="left",
        sequence="count",
    )

    def send(*counts: int) -> None:
        for count in counts:
            node.send("WheelCommand", left=count / 1000, right=0, gear=0, count=count)

    async with opened(device) as sensor, aclosing(sensor.stream()) as stream:
        waiting = asyncio.ensure_future(anext(stream))
        await asyncio.sleep(0)
        send(254, 254, 254, 255, 0, 1, 4)
        values = [await waiting, *[await anext(stream) for _ in range(4)]]
        assert values == pytest.approx([0.254, 0.255, 0.0, 0.001, 0.004])
        assert (device.repeated, device.missed) == (2, 2)
        send(*[4] * 10)
        with pytest.raises(DeviceFaultError, match="its count stays at 4"):
            await anext(stream)
    assert device.bad_frames == 0


async def test_what_nobody_takes_in_time_is_counted(fake_can: Any) -> None:
    """The newest win, and the count outlives the closing."""
    wire = fake_can("drive")
    node = FakeDbcNode(wire, ROVER)
    async with (
        opened(feedback(wire, signal="speed", buffer=4)) as sensor,
        aclosing(sensor.stream()) as stream,
    ):
        waiting = asyncio.ensure_future(anext(stream))
        await asyncio.sleep(0)
        for speed in range(10):
            node.send("WheelFeedback", speed=speed, mode=0, current=0.0)
        await asyncio.sleep(0.01)
        values = [await waiting, *[await anext(stream) for _ in range(3)]]
    assert values == [6, 7, 8, 9]
    assert sensor.dropped == 6


@pytest.mark.promise("SC-3")
async def test_a_silent_node_makes_readings_stale(fake_can: Any) -> None:
    """There is no reading that is newer than the last frame."""
    wire = fake_can("drive")
    node = FakeDbcNode(wire, ROVER)
    sensor = feedback(wire, name="wheel", signal="speed")
    async with esair.Robot(resources=[sensor]) as robot:
        right = await robot.resources.register("me", "wheel", esair.Access.READ)
        await asyncio.sleep(0.1)
        node.send("WheelFeedback", speed=1.0, mode=0, current=0.0)
        await asyncio.sleep(0.1)
        assert (await robot.sensors.read(right, max_age=0.5)).value == 1.0
        await asyncio.sleep(1.0)
        with pytest.raises(esair.StaleReadingError):
            await robot.sensors.read(right, max_age=0.5)


@pytest.mark.promise("SC-3")
@pytest.mark.fault("D15")
async def test_a_node_that_hangs_gives_no_reading_at_all(fake_can: Any) -> None:
    """Nor one after each fault, or opening, from which on its frames are listened to."""
    wire = fake_can("drive")
    node = FakeDbcNode(wire, ROVER)
    sensor = DbcSensor(
        name="left",
        bus=wire,
        database=ROVER,
        message="WheelCommand",
        signal="left",
        sequence="count",
    )
    user: Any = esair.Behavior(name="user", reads={"left": esair.reads(float)})
    async with esair.Robot(resources=[sensor], behaviors=[user]) as robot:
        node.send_every(0.01, "WheelCommand", left=1.0, right=0.0, gear=1, count=7)
        assert (await user.left.reading(timeout=1.0)).sequence == 1
        await asyncio.sleep(10.0)
        assert robot.resources.query("left").losses > 0
        assert robot.journal.counts()["left"]["readings"] == 1
        node.stop()


@pytest.mark.fault("C08")
async def test_a_command_is_repeated_until_its_time_is_over_and_no_longer(
    fake_can: Any,
) -> None:
    """Only a write renews it; the safe command that follows is repeated for good."""
    wire = fake_can("drive")
    wheels = command(wire, cycle=0.01, sequence=None, fixed={"gear": 1, "count": 0})
    async with driven(wheels) as robot:
        right = await robot.resources.register("me", "wheels", esair.Access.WRITE)
        await robot.actuators.write(right, {"left": 1.0, "right": 1.0})
        await asyncio.sleep(0)
        moving = wire.sent[-1].data
        wire.sent.clear()
        await asyncio.sleep(1.0)
        sent = [frame.data for frame in wire.sent]

    assert 18 <= sent.count(moving) <= 20
    assert len(set(sent)) == 2
    assert sent[-1] != moving
    assert 75 <= len(sent) - sent.count(moving) <= 82


async def test_without_a_cycle_each_command_is_sent_once(fake_can: Any) -> None:
    """And the safe command once more, when nobody has written in time."""
    wire = fake_can("drive")
    async with driven(command(wire)) as robot:
        right = await robot.resources.register("me", "wheels", esair.Access.WRITE)
        await asyncio.sleep(0)
        wire.sent.clear()
        await robot.actuators.write(right, {"left": 1.0, "right": 1.0})
        await asyncio.sleep(1.0)
        assert len(wire.sent) == 2


@pytest.mark.parametrize(
    ("keywords", "told"),
    [
        (
            {"message": "WheelComand"},
            "message: rover.dbc has no message 'WheelComand'; did",
        ),
        (
            {"signal": "lefft", "safe": 0.0},
            "signal: WheelCommand has no signal 'lefft'; did",
        ),
        ({"fixed": {"gaer": 1}}, "fixed.gaer: WheelCommand has no signal 'gaer'; did"),
        ({"sequence": "left"}, "sequence: 'left' is no unsigned"),
        ({"safe": {"left": 0.0}}, 'safe: The signal "right" is required'),
        (
            {"safe": {"left": 0.0, "right": 9.0}},
            "safe: right: expected -2 to 2, not 9.0",
        ),
        ({"safe": 0.0}, "safe: expected a table of signals"),
        ({"safe": {"left": 0.0, "right": 0.0}, "limits": {"left": (1, 2)}}, "1 to 2"),
        ({"limits": (1, 2)}, "limits: expected a table by signal, not (1, 2)"),
        ({"limits": {"left": ("a", "b")}}, "limits.left: expected (least, greatest)"),
        ({"signal": "left"}, "safe: expected a number"),
        ({"fixed": {"gear": "hihg"}}, "safe:"),
        ({"cycle": 0.0}, "cycle: expected a number of seconds"),
        ({"database": "nowhere.dbc"}, "nowhere.dbc cannot be read: No such file"),
        ({"database": __file__}, "cannot be understood"),
    ],
)
def test_mistakes_are_told_when_the_device_is_made(
    keywords: dict[str, Any], told: str
) -> None:
    """With the field, and the nearest names of the file."""
    described = {
        "database": ROVER,
        "message": "WheelCommand",
        "safe": {"left": 0.0, "right": 0.0},
        "fixed": {"gear": 0},
        "sequence": "count",
    }
    with pytest.raises(ConfigError) as caught:
        DbcActuator(**{**described, **keywords})
    assert told in str(caught.value)


@given(
    st.floats(-32, 32), st.integers(0, 255), st.floats(-300, 355), st.binary(max_size=8)
)
def test_what_is_packed_is_unpacked_and_no_bytes_break_it(
    speed: float, mode: int, current: float, data: bytes
) -> None:
    """Within the resolution of each signal; wrong bytes are a FrameError only."""
    codec = MessageCodec(find_message("x", ROVER, "WheelFeedback"))

    again = codec.decode(
        codec.encode({"speed": speed, "mode": mode, "current": current})
    )

    assert again["speed"] == pytest.approx(speed, abs=0.00051)
    assert again["current"] == pytest.approx(current, abs=0.0051)
    assert again["mode"] == mode
    for message in ("WheelFeedback", "Panel", "Scale"):
        with suppress(ValueError):
            MessageCodec(find_message("x", ROVER, message), names=True).decode(data)


def test_a_bus_of_the_right_kind_is_asked_for() -> None:
    """The configuration reads it from the class."""
    assert DbcSensor.__annotations__["bus"] == DbcActuator.__annotations__["bus"]
    assert CanBus.__name__ in str(DbcSensor.__annotations__["bus"])


@pytest.mark.fault("C08")
async def test_the_driver_itself_ends_the_repeats_of_a_command(fake_can: Any) -> None:
    """Even if nobody tells it the safe command in time."""
    wire = fake_can("drive")
    async with opened(command(wire, cycle=0.01)) as wheels:
        await asyncio.sleep(0.1)
        assert len(wire.sent) == 0, "before the first command nothing is repeated"
        await wheels.write({"left": 1.0, "right": 1.0})
        await asyncio.sleep(1.0)
        assert 18 <= len(wire.sent) <= 21
        wire.sent.clear()
        await wheels.write({"left": 0.0, "right": 0.0})
        await asyncio.sleep(1.0)
        assert len(wire.sent) > 90, "the safe command is repeated for good"


@pytest.mark.promise("CALL-1")
async def test_what_has_failed_is_not_repeated(fake_can: Any) -> None:
    """Its writer was told that it was not sent: no cycle sends it afterwards."""
    wire = fake_can("drive")
    async with opened(command(wire, cycle=0.01)) as wheels:
        await wheels.write({"left": 0.0, "right": 0.0})
        await asyncio.sleep(0.05)
        safe = {frame.data[:4] for frame in wire.sent}
        wire.fail(ValueError("odd"), times=1)
        with pytest.raises(ValueError, match="odd"):
            await wheels.write({"left": 1.0, "right": 1.0})
        await asyncio.sleep(0.3)
        assert {frame.data[:4] for frame in wire.sent} == safe
        await wheels.write({"left": 1.0, "right": 1.0})
        await asyncio.sleep(0.05)
        assert {frame.data[:4] for frame in wire.sent} != safe


@pytest.mark.fault("C04", "C05")
@pytest.mark.parametrize(
    ("what", "told"),
    [("full once", []), ("full", [DeviceFaultError]), ("pulled", [DeviceLostError])],
)
async def test_repeats_that_find_no_room_are_left_out_until_they_are_a_fault(
    fake_can: Any, what: str, told: list[type]
) -> None:
    """The third in a row is one; a bus that is gone is a loss at once."""
    wire = fake_can("drive", send_timeout=0.001)
    errors: list[BaseException | None] = []
    async with opened(command(wire, cycle=0.01)) as wheels:
        wheels._listener = errors.append
        await wheels.write({"left": 0.0, "right": 0.0})
        await asyncio.sleep(0.05)
        if what == "pulled":
            wire.fail(ConnectionError("the cable was pulled"))
        else:
            wire.full(1 if what == "full once" else 1000)
        await asyncio.sleep(0.2)
        before = len(wire.sent)
        await asyncio.sleep(0.1)

        assert [type(error) for error in errors] == told
        assert (len(wire.sent) > before + 5) is (told == [])


J1939 = """VERSION ""
NS_ :
BS_:
BU_: Engine
BO_ 2364540158 Speed: 8 Engine
 SG_ rpm : 24|16@1+ (0.125,0) [0|8031.875] "rpm" Engine
BO_ 2348810494 Torque: 8 Engine
 SG_ limit : 8|16@1+ (0.125,0) [0|8031.875] "rpm" Engine
BO_ 2364540160 Other: 8 Engine
 SG_ x : 0|8@1+ (1,0) [0|250] "" Engine
BO_ 5 Short: 8 Engine
 SG_ y : 0|8@1+ (1,0) [0|250] "" Engine
BO_ 2566841854 Hours: 10 Engine
 SG_ hours : 0|32@1+ (0.05,0) [0|210554060.75] "h" Engine
 SG_ turns : 32|48@1+ (1000,0) [0|0] "r" Engine
BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";
BA_DEF_DEF_ "VFrameFormat" "";
BA_ "VFrameFormat" BO_ 2364540158 3;
BA_ "VFrameFormat" BO_ 2348810494 3;
BA_ "VFrameFormat" BO_ 2566841854 3;
"""


@pytest.mark.promise("BUS-4")
async def test_a_message_of_j1939_is_heard_from_every_address(
    fake_can: Any, tmp_path: Path
) -> None:
    """Whatever its priority; or from one address, or from that of the file alone."""
    (database := tmp_path / "engine.dbc").write_text(J1939)
    wire = fake_can("drive")
    make = partial(DbcSensor, bus=wire, database=database, message="Speed")
    every, one = make(signal="rpm"), make(name="one", signal="rpm", source=0x11)
    data = (8 * 800).to_bytes(2, "little")
    streams: list[Any] = [every.stream(), one.stream()]
    async with opened(every), opened(one), aclosing(streams[0]) as values:
        async with aclosing(streams[1]) as values_of_one:
            first, first_of_one = (
                asyncio.ensure_future(anext(each)) for each in (values, values_of_one)
            )
            await asyncio.sleep(0)
            for number in (0x0CF00400, 0x18F00411, 0x0CF004FE, 0x0CF00500):
                wire.feed(number, bytes(3) + data + bytes(3), extended=True)
            wire.feed(0x400, bytes(8))
            assert await first == 800.0
            assert [await anext(values) for _ in range(2)] == [800.0] * 2
            assert await first_of_one == 800.0

        assert every.sources == {0x00: 1, 0x11: 1, 0xFE: 1}
        assert one.sources == {0x11: 1}
        assert every.bad_frames == one.bad_frames == 0


HOURS = 0x00FEE5


def packets(source: int, data: bytes, *, to: int = 0xFF, kind: int = 32) -> list[Frame]:
    """A message in packets, as SAE J1939-21 has them."""
    count = -(-len(data) // 7)
    head = bytes([kind, len(data), 0, count, 0xFF]) + HOURS.to_bytes(3, "little")
    ids = 0x18EC0000 | to << 8 | source, 0x18EB0000 | to << 8 | source
    padded = data.ljust(7 * count, b"\xff")
    return [
        Frame(ids[0], head, True),
        *(
            Frame(ids[1], bytes([n + 1]) + padded[7 * n : 7 * n + 7], True)
            for n in range(count)
        ),
    ]


def hours(number: float) -> bytes:
    return round(number * 20).to_bytes(4, "little") + bytes(6)


@pytest.mark.promise("BUS-4")
async def test_a_message_of_j1939_comes_in_packets(
    fake_can: Any, tmp_path: Path
) -> None:
    """Announced to all or sent to another node, of several nodes at the same time."""
    (database := tmp_path / "engine.dbc").write_text(J1939)
    wire = fake_can("drive")
    device = DbcSensor(bus=wire, database=database, message="Hours", signal="hours")
    stream: Any = device.stream()
    async with opened(device), aclosing(stream) as values:
        first = asyncio.ensure_future(anext(values))
        await asyncio.sleep(0)
        every = packets(0x11, hours(11.0)), packets(0x22, hours(22.0))
        other = packets(0x33, hours(33.0), to=0x44, kind=16)
        other.insert(2, other[1])  # the other node has asked for it once more
        for group in zip(*every, other, strict=False):
            for frame in group:
                wire.feed(frame.id, frame.data, extended=True)
        wire.feed(other[-1].id, other[-1].data, extended=True)
        assert {await first, await anext(values), await anext(values)} == {11, 22, 33}
        assert device.sources == {0x11: 1, 0x22: 1, 0x33: 1}
        assert device.bad_frames == 0


@pytest.mark.fault("D11")
async def test_a_message_that_is_not_whole_is_none(
    fake_can: Any, tmp_path: Path
) -> None:
    """A packet is missing, late or none; it was ended; another one has begun."""
    (database := tmp_path / "engine.dbc").write_text(J1939)
    wire = fake_can("drive")
    device = DbcSensor(
        bus=wire, database=database, message="Hours", signal="hours", source=0x11
    )
    stream: Any = device.stream()

    def feed(*frames: Frame) -> None:
        for frame in frames:
            wire.feed(frame.id, frame.data, extended=True)

    async with opened(device), aclosing(stream) as values:
        value = asyncio.ensure_future(anext(values))
        await asyncio.sleep(0)
        head, one, two = packets(0x11, hours(1.0))
        abort = Frame(head.id, bytes([255, 1, 255, 255, 255, 0xE5, 0xFE, 0]), True)
        feed(head, two)
        feed(head, Frame(one.id, b"\0" + one.data[1:], True), one, two)
        feed(head, one, abort, two)
        feed(head, one)
        await asyncio.sleep(0.8)
        feed(two)
        feed(head, head, *packets(0x11, hours(5.0)), *packets(0x22, hours(6.0)))
        assert await value == 5.0


@given(
    st.lists(
        st.tuples(
            st.sampled_from([0xEC, 0xEB, 0xE8]),
            st.integers(0, 3),
            st.sampled_from([16, 17, 32, 255, 1, 2, 3, 0]),
            st.integers(0, 2000),
        )
    )
)
def test_no_packets_make_more_than_they_announce(frames: list[Any]) -> None:
    """Whatever comes: nothing is raised, and what is kept is bounded."""
    together = Reassembly(HOURS << 8)
    for place, ends, first, size in frames:
        data = bytes([first]) + size.to_bytes(2, "little") + b"\2\xff"
        whole = together.feed(
            Frame(place << 16 | ends * 0x101, data + HOURS.to_bytes(3, "little"), True)
        )
        assert whole is None or 8 < len(whole.data) <= 1785
    assert len(together._begun) <= 4
    assert sum(len(each.data) for each in together._begun.values()) <= 4 * 1785


async def test_a_command_of_j1939_has_both_addresses(
    fake_can: Any, tmp_path: Path
) -> None:
    """Those of the file, or those that are given; also when the watchdog sends it."""
    (database := tmp_path / "engine.dbc").write_text(J1939)
    wire = fake_can("drive")
    make = partial(DbcActuator, database=database, message="Torque", safe={"limit": 0})
    for device, number in [
        (make(bus=wire), 0x0C0000FE),
        (make(bus=wire, source=0x27, destination=0x05), 0x0C000527),
    ]:
        async with opened(device):
            await device.write({"limit": 10.0})
            assert (await wire.until(number)).extended
            (safe,) = device.safe_frames().frames
            assert int.from_bytes(safe[:4], "little") & 0x1FFFFFFF == number
        wire.sent.clear()


@pytest.mark.parametrize(
    ("kind", "keywords", "told"),
    [
        (DbcSensor, {"message": "Speed", "source": 256}, "source: expected an address"),
        (DbcSensor, {"message": "Short", "source": 1}, "source: Short has an id of 11"),
        (
            DbcActuator,
            {"message": "Other", "safe": {"x": 0}, "destination": 3},
            "destination: Other is for all nodes",
        ),
    ],
)
def test_addresses_that_are_none_are_told(
    tmp_path: Path, kind: Any, keywords: dict[str, Any], told: str
) -> None:
    """When the device is made."""
    (database := tmp_path / "engine.dbc").write_text(J1939)

    with pytest.raises(ConfigError, match=told):
        kind(database=database, **keywords)


@pytest.mark.promise("BUS-4")
async def test_a_multiplexed_command_replaces_no_other(
    fake_can: Any, tmp_path: Path
) -> None:
    """Commands for two pages both arrive; an older one for the same page does not."""
    page = described(
        tmp_path,
        ' SG_ page M : 0|8@1+ (1,0) [0|1] "" A',
        ' SG_ low m0 : 8|8@1+ (1,0) [0|9] "" A',
        ' SG_ high m1 : 8|8@1+ (1,0) [0|9] "" A\n',
    )
    wire = fake_can("drive")
    device = DbcActuator(
        bus=wire, database=page, message="M", safe={"page": 0, "low": 0}
    )
    async with opened(device):
        wire.full(2)
        commands = [
            {"page": 0, "low": 1},
            {"page": 1, "high": 2},
            {"page": 0, "low": 3},
        ]
        done = await asyncio.gather(
            *map(device.write, commands), return_exceptions=True
        )
        await asyncio.sleep(0.01)

    assert [type(each).__name__ for each in done] == [
        "BusyError",
        "NoneType",
        "NoneType",
    ]
    assert [frame.data[:2] for frame in wire.sent] == [b"\x01\x02", b"\x00\x03"]


def described(folder: Path, *lines: str, length: int = 8) -> Path:
    """A file with one message, M, of these signals."""
    (file := folder / "one.dbc").write_text(
        f'VERSION ""\nNS_ :\nBS_:\nBU_: A\nBO_ 100 M: {length} A\n' + "\n".join(lines)
    )
    return file


MODES = (
    ' SG_ mode M : 0|8@1+ (1,0) [0|3] "" A',
    ' SG_ low m0 : 8|8@1+ (1,0) [0|0] "" A',
    ' SG_ high m1 : 8|8@1+ (1,0) [5|9] "" A',
    ' SG_ gear : 16|8@1+ (1,0) [0|3] "" A',
    ' SG_ ratio : 32|32@1- (1,0) [0|0] "" A\n',
    'VAL_ 100 gear 0 "off" 1 "on" 15 "missing" ;',
    "SIG_VALTYPE_ 100 ratio : 1;\n",
)


@pytest.mark.promise("AC-1")
@pytest.mark.parametrize(
    ("signal", "fixed", "safe", "good", "bad", "told"),
    [
        ("ratio", {}, 0.0, 3.4e38, 3.5e38, r"expected -3\.40282e\+38 to"),
        ("gear", {}, 0, 15, 4, "expected 0 to 3, not 4"),
        ("mode", {}, 0, 1, 2, "Expected one of {0 or 1}"),
        ("high", {"mode": 1}, 5.0, 9, 10, "expected 5 to 9, not 10"),
    ],
)
async def test_no_bad_value_of_one_signal_is_a_fault_of_the_device(
    fake_can: Any,
    tmp_path: Path,
    signal: str,
    fixed: Any,
    safe: Any,
    good: float,
    bad: float,
    told: str,
) -> None:
    """It is refused before it leaves, however often; none becomes infinite."""
    wire = fake_can("drive")
    device = DbcActuator(
        name="one",
        bus=wire,
        database=described(tmp_path, *MODES),
        message="M",
        signal=signal,
        fixed=fixed,
        safe=safe,
    )
    async with driven(device) as robot:
        right = await robot.resources.register("me", "one", esair.Access.WRITE)
        for _ in range(4):
            with pytest.raises(BadValueError, match=told):
                await robot.actuators.write(right, bad)
        assert await robot.actuators.write(right, good)
        await asyncio.sleep(0)

        sent = device.codec.decode(wire.sent[-1].data)[signal]
        assert sent == pytest.approx(good, rel=1e-6)
        assert robot.resources.query("one").faults == 0


async def test_a_message_that_no_frame_fits_has_bytes_to_spare(
    fake_can: Any, tmp_path: Path
) -> None:
    """With CAN FD 10 bytes travel in a frame of 12."""
    wire = fake_can("drive", fd=True)
    file = described(tmp_path, ' SG_ last : 72|8@1+ (1,0) [0|0] "" A\n', length=10)
    far = DbcActuator(
        name="far", bus=wire, database=file, message="M", signal="last", safe=0
    )
    near = DbcSensor(name="near", bus=wire, database=file, message="M", signal="last")
    async with (
        opened(near),
        opened(far),
        aclosing(near.stream()) as stream,  # type: ignore[type-var]
    ):
        waiting = asyncio.ensure_future(anext(stream))
        await asyncio.sleep(0)
        await far.write(7.0)
        await asyncio.sleep(0)
        assert wire.sent[-1].data == bytes([*[0] * 9, 7, 0, 0])
        wire.feed(100, wire.sent[-1].data)
        assert await waiting == 7


async def test_a_number_of_frames_may_have_a_name(
    fake_can: Any, tmp_path: Path
) -> None:
    """It counts on in any case."""
    wire = fake_can("drive")
    sensor = DbcSensor(
        bus=wire,
        database=described(tmp_path, *MODES),
        message="M",
        sequence="gear",
        choices="names",
        name="counted",
    )
    async with opened(sensor), aclosing(sensor.stream()) as stream:  # type: ignore[type-var]
        waiting = asyncio.ensure_future(anext(stream))
        await asyncio.sleep(0)
        for number in (0, 2, 2, 3):
            wire.feed(100, bytes([0, 0, number, 0, 0, 0, 0, 0]))
        assert [(await waiting)["gear"], (await anext(stream))["gear"]] == ["off", 2]
        assert (await anext(stream))["gear"] == 3
    assert (sensor.missed, sensor.repeated) == (1, 1)


def panel(wire: Any, **keywords: Any) -> DbcActuator:
    safe = {"page": 0, "voltage": 0.0}
    return DbcActuator(
        name="panel",
        bus=wire,
        database=ROVER,
        **{"message": "Panel", "safe": safe, **keywords},
    )


def test_how_fast_a_multiplexed_signal_changes_cannot_be_limited(fake_can: Any) -> None:
    """The command before may have said nothing about it."""
    with pytest.raises(ConfigError, match=r"slew\.voltage: it is multiplexed"):
        panel(fake_can("drive"), slew={"voltage": 1.0})
    with pytest.raises(ConfigError, match=r"slew: .* did you mean 'left'"):
        command(fake_can("drive"), slew={"lefft": 1.0})
    assert panel(fake_can("drive"), slew={"page": 1.0}).slew == {"page": 1.0}


async def test_a_change_that_is_too_fast_is_made_slower(fake_can: Any) -> None:
    """As with any other actuator."""
    wire = fake_can("drive")
    wheels = command(wire, slew={"left": 1.0, "right": 1.0})
    async with driven(wheels) as robot:
        right = await robot.resources.register("me", "wheels", esair.Access.WRITE)
        await asyncio.sleep(0.1)
        written = await robot.actuators.write(right, {"left": 2.0, "right": -2.0})
    assert written
    assert 0.0 < written.command["left"] < 2.0
    assert -2.0 < written.command["right"] < 0.0


async def test_a_truth_value_is_no_number(fake_can: Any) -> None:
    """Unless the signal has but one bit."""
    wire = fake_can("drive")
    async with driven(command(wire)) as robot:
        right = await robot.resources.register("me", "wheels", esair.Access.WRITE)
        with pytest.raises(BadValueError, match="left: expected a number, not True"):
            await robot.actuators.write(right, {"left": True, "right": 0.0})
