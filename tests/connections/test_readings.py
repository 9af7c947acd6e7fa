"""Readings: checked, as old as their measurement, and never from before."""

from __future__ import annotations

import asyncio
import collections
import dataclasses
import decimal
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import attrs
import numpy as np
import pytest

import esair
from esair import ResourceState
from esair.messages import Stamped
from esair.testing import FakeActuator, FakeSensor

pytestmark = pytest.mark.virtual_clock


@attrs.frozen
class Fix:
    """Where it is, and how sure."""

    x: float
    y: float
    ranges: tuple[float, ...] = ()


def now() -> float:
    return asyncio.get_running_loop().time()


class Copy(esair.Reaction):
    """Hands the sensor on to the wheels."""

    sonar = esair.reads(float)
    wheels = esair.writes(float)

    def react(self, sonar: float) -> float:
        return sonar


@pytest.mark.promise("SC-3")
@pytest.mark.parametrize("bad", [math.nan, math.inf, "near", True, 9.0])
async def test_a_bad_reading_reaches_no_action(bad: Any, user_of: Any) -> None:
    """It is counted; what reads it is told of a fault, what follows sees nothing."""
    sonar = FakeSensor("sonar", 0.5, type=float, rate=20.0)
    sonar.limits = (0.0, 5.0)
    sonar.fault_limit = 1000
    wheels, user = (
        FakeActuator("wheels", safe=0.0),
        user_of("u", sonar=esair.reads(float)),
    )
    async with esair.Robot(
        resources=[sonar, wheels], behaviors=[Copy(), user]
    ) as robot:
        await wheels.until(0.5)
        sonar.feed(bad)
        with pytest.raises(esair.DeviceFaultError, match="sonar"):
            await user.sonar.read(fresh=True)
        await asyncio.sleep(0.5)
        assert set(wheels.commands) == {0.0, 0.5}
        assert robot.journal.counts()["sonar"]["bad"] >= 1


@pytest.mark.promise("SC-3")
async def test_a_whole_number_that_no_float_holds_is_bad(user_of: Any) -> None:
    """It is as little finite as infinity; each computation with it would raise."""
    sonar, user = (
        FakeSensor("sonar", 1, type=float),
        user_of("u", sonar=esair.reads(float)),
    )
    async with esair.Robot(resources=[sonar], behaviors=[user]):
        assert await user.sonar.read() == 1
        sonar.feed(10**400)
        with pytest.raises(esair.DeviceFaultError, match="too large"):
            await user.sonar.read(fresh=True)


@pytest.mark.promise("SC-3")
@pytest.mark.parametrize(
    ("kind", "good", "bad"),
    [(str, "near", 1), (bool, True, 1), (int, 7, True), (float, 7, True)],
)
async def test_a_reading_of_another_type_is_bad(
    kind: Any, good: Any, bad: Any, user_of: Any
) -> None:
    """A whole number is a float; what is true or false is neither."""
    sonar = FakeSensor("sonar", good, type=kind)
    user = user_of("u", sonar=esair.reads(kind))
    async with esair.Robot(resources=[sonar], behaviors=[user]):
        assert await user.sonar.read() == good
        sonar.feed(bad)
        with pytest.raises(esair.DeviceFaultError, match=f"expected {kind.__name__}"):
            await user.sonar.read(fresh=True)


@pytest.mark.promise("SC-3", "AC-1")
@pytest.mark.parametrize("bad", ["near", True, b"", (1.0,)])
async def test_one_of_several_types_is_no_other(bad: Any, user_of: Any) -> None:
    """A sensor that gives a number or None, an actuator that takes one or a word."""
    sonar = FakeSensor[float | None]("sonar", None, type=float | None)

    class Lamp(esair.Actuator[float | str]):
        safe = 0.0
        command_timeout = 9.0

        async def write(self, command: float | str) -> None: ...

    several: tuple[Any, Any] = (float | None, float | str)
    ports = {"sonar": esair.reads(several[0]), "lamp": esair.writes(several[1])}
    user = user_of("u", **ports)
    async with esair.Robot(resources=[sonar, Lamp()], behaviors=[user]):
        assert await user.sonar.read(fresh=True) is None
        assert await user.lamp.write("blink")
        sonar.feed(bad)
        with pytest.raises(esair.DeviceFaultError, match="expected float"):
            await user.sonar.read(fresh=True)
        if bad != "near":
            with pytest.raises(esair.BadValueError, match="expected float"):
                await user.lamp.write(bad)
        sonar.feed(0.5)
        assert await user.sonar.read(fresh=True) == 0.5


@pytest.mark.promise("SC-3")
async def test_whole_numbers_have_limits_too(user_of: Any) -> None:
    """Of a value that is none within, there is no reading."""
    count = FakeSensor("count", 3, type=int)
    count.limits = (0, 10)
    user = user_of("u", count=esair.reads(int))
    async with esair.Robot(resources=[count], behaviors=[user]):
        assert await user.count.read() == 3
        count.feed(11)
        with pytest.raises(esair.DeviceFaultError, match="11"):
            await user.count.read(fresh=True)


@pytest.mark.promise("SC-3")
async def test_infinity_is_bad_within_limits_that_have_one_end(user_of: Any) -> None:
    """That there is no greatest value does not make infinity one."""
    sonar, user = (
        FakeSensor("sonar", 1e300, type=float),
        user_of("u", sonar=esair.reads(float)),
    )
    sonar.limits = (0.0, math.inf)
    async with esair.Robot(resources=[sonar], behaviors=[user]):
        assert await user.sonar.read() == 1e300
        for bad in (math.inf, -1.0):
            sonar.feed(bad)
            with pytest.raises(esair.DeviceFaultError):
                await user.sonar.read(fresh=True)


@pytest.mark.promise("SC-3")
async def test_each_number_of_a_structure_is_looked_at(user_of: Any) -> None:
    """Its fields, not what lies deeper: a scan may have seen nothing somewhere."""
    gps = FakeSensor("gps", Fix(0.0, 0.0), type=Fix)
    gps.limits = {"x": (-1.0, 1.0)}
    user = user_of("user", gps=esair.reads(Fix))
    async with esair.Robot(resources=[gps], behaviors=[user]):
        gps.feed(Fix(0.0, 5.0, (math.inf, 1.0)))
        assert (await user.gps.read(fresh=True)).y == 5.0
        for bad, field in ((Fix(0.0, math.nan), "y"), (Fix(2.0, 0.0), "x")):
            gps.feed(bad)
            with pytest.raises(esair.DeviceFaultError, match=f"gave {field} = "):
                await user.gps.read(fresh=True)


@pytest.mark.promise("SC-3")
async def test_a_polled_sensor_is_current_for_three_periods(user_of: Any) -> None:
    """A reaction that says nothing about age does not drive on an older reading."""
    sonar, wheels = (
        FakeSensor("sonar", 1.0, rate=10.0),
        FakeActuator("wheels", safe=0.0),
    )
    sonar.deadline = 30.0
    async with esair.Robot(resources=[sonar, wheels], behaviors=[Copy()]) as robot:
        await wheels.until(1.0)
        sonar.stall()
        await asyncio.sleep(0.25)
        assert robot.behaviors.query("copy").state is esair.BehaviorState.RUNNING
        await asyncio.sleep(0.15)
        status = robot.behaviors.query("copy")
        assert status.state is esair.BehaviorState.PARKED
        assert "0.3 s" in status.detail


@pytest.mark.promise("SC-3")
async def test_a_device_that_pushes_may_say_how_long_it_is_silent(user_of: Any) -> None:
    """With a period its readings grow old; without one they do not."""
    beacon, bumper = FakeSensor[float]("beacon"), FakeSensor[float]("bumper")
    beacon.period = 0.5
    user = user_of("user", beacon=esair.reads(float), bumper=esair.reads(float))
    async with esair.Robot(resources=[beacon, bumper], behaviors=[user]):
        beacon.feed(1.0)
        bumper.feed(2.0)
        await asyncio.sleep(0.4)
        assert (await user.beacon.read(), await user.bumper.read()) == (1.0, 2.0)
        await asyncio.sleep(0.2)
        with pytest.raises(esair.StaleReadingError):
            await user.beacon.read()
        await asyncio.sleep(1000.0)
        assert await user.bumper.read() == 2.0


@pytest.mark.promise("SC-1")
async def test_what_is_pushed_while_it_is_asked_is_newer(user_of: Any) -> None:
    """The answer was measured before: it is no reading, and a fresh one is the pushed."""

    class Bumper(esair.Sensor[bool]):
        rate = 10.0
        is_pressed = False

        async def read(self) -> bool:
            was = self.is_pressed
            await asyncio.sleep(0.02)
            return was

        async def stream(self) -> Any:
            await asyncio.sleep(1.01)  # amid a question
            self.is_pressed = True
            yield True
            await asyncio.sleep(1000.0)

    bumper, user = Bumper(), user_of("user", bumper=esair.reads(bool))
    async with esair.Robot(resources=[bumper], behaviors=[user]):
        await asyncio.sleep(1.0)
        fresh = asyncio.ensure_future(user.bumper.read(fresh=True))
        await asyncio.sleep(0.5)
        assert await fresh is True
        assert [each.value for each in user.bumper.history(2)] == [True]


@pytest.mark.promise("SC-4")
@pytest.mark.parametrize("with_age", [False, True])
async def test_the_age_of_a_reading_counts_from_its_measurement(
    user_of: Any, with_age: bool
) -> None:
    """The driver says when it was measured; the reading carries both times."""

    class Camera(esair.Sensor[float]):
        async def stream(self) -> Any:
            await asyncio.sleep(0.5)
            yield Stamped(1.0, age=0.2) if with_age else Stamped(1.0, now() - 0.2)
            await asyncio.sleep(1000.0)

    user = user_of("user", camera=esair.reads(float))
    began = now()
    async with esair.Robot(resources=[Camera()], behaviors=[user]):
        await asyncio.sleep(0.6)
        reading = await user.camera.reading()
        assert tuple(reading) == (1.0, pytest.approx(began + 0.3), 1)
        assert reading.arrived == pytest.approx(began + 0.5)
        with pytest.raises(esair.StaleReadingError):
            await user.camera.read(max_age=0.25)
        assert await user.camera.read(max_age=0.35) == 1.0


@pytest.mark.promise("SC-1")
@pytest.mark.promise("SC-4")
@pytest.mark.parametrize("pushes", [False, True])
async def test_what_was_measured_before_the_question_is_not_fresh(
    user_of: Any, pushes: bool
) -> None:
    """However late it comes: a fresh reading waits for one that was measured since."""

    class Camera(esair.Sensor[float]):
        rate = 10.0
        asked = 0

    async def read(self: Camera) -> Any:
        self.asked += 1
        return Stamped(1.0, age=0.15)

    async def stream(self: Camera) -> Any:
        while True:
            await asyncio.sleep(0.1)
            yield Stamped(1.0, now() - 0.15)

    setattr(Camera, "stream" if pushes else "read", stream if pushes else read)
    user, camera = user_of("user", camera=esair.reads(float)), Camera()
    async with esair.Robot(resources=[camera], behaviors=[user]):
        await asyncio.sleep(0.62)
        before = now()
        reading = await user.camera.reading(fresh=True)
        assert before <= reading.time <= before + 0.1
        assert camera.asked <= 3
        with pytest.raises(esair.StaleReadingError, match=r"limit 0\.14 s"):
            await user.camera.read(fresh=True, timeout=0.14)


@pytest.mark.promise("SC-1")
@pytest.mark.promise("SC-4")
async def test_a_measurement_that_comes_late_replaces_no_newer_one(
    user_of: Any,
) -> None:
    """It is counted; nobody gets it, and the newest stays that."""

    class Camera(esair.Sensor[float]):
        async def stream(self) -> Any:
            for time in (0.3, 0.1, 0.2, 0.4):
                await asyncio.sleep(0.1)
                yield Stamped(time, began + time)
            await asyncio.sleep(1000.0)

    class Follower(esair.Behavior):
        camera = esair.reads(float)
        seen: tuple[float, ...] = ()

        async def run(self) -> None:
            async for value in self.camera:
                self.seen += (value,)

    follower = Follower()
    user, began = user_of("user", camera=esair.reads(float)), now() - 0.4
    async with esair.Robot(resources=[Camera()], behaviors=[user, follower]) as robot:
        await asyncio.sleep(0.35)
        assert await user.camera.read() == 0.3
        await asyncio.sleep(0.1)
        assert [each.value for each in user.camera.history(9)] == [0.3, 0.4]
        assert robot.journal.counts()["camera"]["dropped"] == 2
    assert follower.seen == (0.3, 0.4)


@pytest.mark.promise("SC-4")
@pytest.mark.parametrize("time", [1e9, math.nan, "noon", 10**400])
async def test_a_measurement_of_the_future_is_a_fault(user_of: Any, time: Any) -> None:
    """A clock that is wrong makes no reading young for ever."""

    class Camera(esair.Sensor[float]):
        async def read(self) -> Any:
            return Stamped(1.0, time)

    user = user_of("user", camera=esair.reads(float))
    async with esair.Robot(resources=[Camera()], behaviors=[user]):
        with pytest.raises(esair.DeviceFaultError, match="time of measurement"):
            await user.camera.read()


@pytest.mark.promise("SC-3")
async def test_what_a_device_answers_while_it_is_lost_is_no_reading(
    user_of: Any,
) -> None:
    """A driver that reports a loss and gives a value all the same is not believed."""

    class Odd(esair.Sensor[float]):
        async def read(self) -> float:
            self.report_lost()
            return 1.0

    user = user_of("user", odd=esair.reads(float))
    async with esair.Robot(resources=[Odd()], behaviors=[user]) as robot:
        with pytest.raises(esair.DeviceLostError):
            await user.odd.read()
        assert robot.resources.query("odd").state is ResourceState.LOST
        assert robot.sensors.channels["odd"].newest is None


class Pose(NamedTuple):
    """A structured value, as the parts of another one."""

    x: float
    y: float


@dataclasses.dataclass
class Scan:
    """A structured value with rows."""

    ranges: Any
    pose: Any = None


class Hostile:
    """Raises when it is compared."""

    def __le__(self, other: object) -> bool:
        raise RuntimeError("no order")

    __ge__ = __le__


@pytest.mark.promise("SC-3")
@pytest.mark.parametrize(
    ("value", "told"),
    [
        ({"left": {"speed": math.nan}}, "left.speed = nan"),
        ({"left": {"speed": math.inf}}, "left.speed = inf"),
        (Scan([1.0, math.nan]), "NaN in ranges"),
        (Scan([Pose(0.0, 0.0), Pose(0.0, math.nan)]), r"ranges\[1\].y = nan"),
        (Scan(["start", math.nan]), r"ranges\[1\] = nan"),
        (Scan([], Pose(math.nan, 0.0)), "pose.x = nan"),
        (np.array([1.0, math.nan]), "NaN in an array"),
        ({"image": np.array([math.nan])}, "NaN in image"),
        (Pose(math.inf, 0.0), "a finite number, it gave x = inf"),
        ([Pose(0.0, -math.inf)], "a finite number"),
    ],
)
async def test_a_number_that_is_none_is_found_wherever_it_is(
    value: Any, told: str
) -> None:
    """In fields, rows, dictionaries and arrays; the error says where."""
    lidar = FakeSensor("lidar", value, rate=10.0)
    user: Any = esair.Behavior(name="user", reads={"lidar": esair.reads(object)})
    async with esair.Robot(resources=[lidar], behaviors=[user]):
        with pytest.raises(esair.DeviceFaultError, match=told):
            await user.lidar.read(fresh=True)


class Slots:
    """A value that keeps its parts in slots."""

    __slots__ = ("speed",)

    def __init__(self, speed: object) -> None:
        self.speed = speed


class Plain:
    """A value of any other class."""

    def __init__(self, speed: object) -> None:
        self.speed = speed


def nested(levels: int, inside: object) -> object:
    """Put something into so many dictionaries, one in the other."""
    return {"deep": nested(levels - 1, inside)} if levels else inside


class AnyWheels(FakeActuator[object]):
    """Take commands of any class."""

    value_type: Any = object


SAFE = Plain(0.0)

HIDING: dict[str, Callable[[Any], object]] = {
    "set": lambda number: {number},
    "deque": lambda number: collections.deque([number]),
    "slots": Slots,
    "decimal": lambda number: decimal.Decimal(number),
    "key of a mapping": lambda number: {number: 1.0},
    "complex": lambda number: complex(0.0, number),
    "five deep": lambda number: nested(5, number),
    "plain object": Plain,
}


@pytest.mark.promise("SC-3")
@pytest.mark.parametrize("shape", HIDING)
async def test_what_is_refused_as_a_command_is_refused_as_a_reading(shape: str) -> None:
    """And as what a guard returns: one walk, whatever NaN hides in."""
    heard: list[object] = []

    class Relay(esair.Reaction):
        lidar = esair.reads(object)
        wheels = esair.guards(object)

        def react(self, lidar: object, wheels: object) -> object:
            return HIDING[shape](math.nan)

    lidar = FakeSensor("lidar", HIDING[shape](1.0), rate=10.0)
    wheels: Any = AnyWheels("wheels", safe=SAFE)
    user: Any = esair.Behavior(
        name="user",
        reads={"lidar": esair.reads(object)},
        writes={"wheels": esair.writes(object)},
    )
    async with esair.Robot(resources=[lidar, wheels], behaviors=[user]) as robot:
        assert await user.lidar.read(fresh=True) is not None
        assert await user.wheels.write(HIDING[shape](1.0))
        lidar.feed(HIDING[shape](math.nan))
        with pytest.raises(esair.DeviceFaultError, match=r"finite|number"):
            await user.lidar.read(fresh=True)
        with pytest.raises(esair.BadValueError, match="finite"):
            await user.wheels.write(HIDING[shape](math.nan))
        told = len(wheels.commands)
        lidar.feed(HIDING[shape](1.0))
        await robot.behaviors.add(Relay())
        await asyncio.sleep(0.3)
        heard.append(await user.wheels.write(HIDING[shape](1.0)))
        assert not heard[-1]
        assert all(
            isinstance(each, Plain) and each.speed == 0.0
            for each in wheels.commands[told:]
        )


@pytest.mark.promise("SC-3")
async def test_a_value_that_holds_itself_is_no_reading() -> None:
    """It is refused instead of looked at for ever; what is in it twice is looked at once."""
    endless: list[Any] = []
    endless.append(endless)
    shared: object = 1.0
    for _ in range(7):
        shared = [shared] * 20
    lidar = FakeSensor("lidar", shared, rate=10.0)
    user: Any = esair.Behavior(name="user", reads={"lidar": esair.reads(object)})
    async with esair.Robot(resources=[lidar], behaviors=[user]):
        assert len(await user.lidar.read(fresh=True)) == 20
        lidar.feed(endless)
        with pytest.raises(esair.DeviceFaultError, match="nested too deeply"):
            await user.lidar.read(fresh=True)


@pytest.mark.promise("SC-3")
@pytest.mark.parametrize(
    "value",
    [
        Scan([1.0, math.inf], Pose(0.0, 0.0)),
        ["start", 1.0, b"raw", None],
        np.array([1, 2, 3]),
        object(),
    ],
)
async def test_what_may_be_in_a_reading_passes(value: Any) -> None:
    """In a row infinity stands for "nothing in reach"."""
    lidar = FakeSensor("lidar", value, rate=10.0)
    user: Any = esair.Behavior(name="user", reads={"lidar": esair.reads(object)})
    async with esair.Robot(resources=[lidar], behaviors=[user]):
        assert np.all(await user.lidar.read(fresh=True) == value)


@pytest.mark.promise("SC-3")
async def test_a_reading_that_cannot_be_checked_is_a_fault() -> None:
    """It may be an object of any class; the error of its check is contained."""

    class Strange(FakeSensor[Any]):
        limits = (0.0, 1.0)

    user: Any = esair.Behavior(name="user", reads={"strange": esair.reads(object)})
    strange: Any = Strange("strange", Hostile())
    async with esair.Robot(resources=[strange], behaviors=[user]):
        with pytest.raises(
            esair.DeviceFaultError, match=r"cannot be checked.*no order"
        ):
            await user.strange.read(fresh=True)


@pytest.mark.promise("SC-3")
async def test_an_array_that_never_changes_is_frozen() -> None:
    """Also values of which equality is an array, or raises."""

    class Camera(FakeSensor[Any]):
        max_repeat = 3

    camera: Any = Camera("camera", np.zeros(4))
    user: Any = esair.Behavior(name="user", reads={"camera": esair.reads(object)})
    async with esair.Robot(resources=[camera], behaviors=[user]):
        for _ in range(3):
            await user.camera.read(fresh=True)
        with pytest.raises(esair.DeviceFaultError, match="frozen"):
            await user.camera.read(fresh=True)
        camera.feed(np.zeros(5))  # of another shape: it cannot be compared
        await user.camera.read(fresh=True)


class Stream:
    """An iterator that is no generator: it has nothing to be closed."""

    def __init__(self, values: list[float]) -> None:
        self.values = values

    def __aiter__(self) -> Stream:
        return self

    async def __anext__(self) -> float:
        if not self.values:
            raise StopAsyncIteration
        return self.values.pop(0)


@pytest.mark.promise("SC-1")
@pytest.mark.parametrize("count", [99, 100, 101, 250])
async def test_a_stream_may_be_any_iterator_and_have_many_values_at_once(
    count: int,
) -> None:
    """All come in without a pause; then its end is a loss like any other."""

    class Pushes(esair.Sensor[float]):
        def stream(self) -> Any:
            return Stream([float(n) for n in range(count)])

    began = asyncio.get_running_loop().time()
    async with esair.Robot(resources=[Pushes()]) as robot:
        channel = robot.sensors.channel("pushes")
        while channel.sequence < count:  # noqa: ASYNC110 - it tells nobody
            await asyncio.sleep(0)
        assert asyncio.get_running_loop().time() == began
        await asyncio.sleep(0.01)
        assert "its stream has ended" in str(robot.resources.query("pushes").error)


@pytest.mark.promise("SC-3")
async def test_a_loop_that_is_busy_keeps_no_reading_from_another() -> None:
    """One that has not come back yet, and one that waits: both follow the same sensor."""
    sonar = FakeSensor("sonar", 1.0, type=float, rate=1.0)
    user: Any = esair.Behavior(name="user", reads={"sonar": esair.reads(float)})
    async with esair.Robot(resources=[sonar], behaviors=[user]):
        busy, other = aiter(user.sonar), aiter(user.sonar)
        firsts = [asyncio.create_task(anext(each)) for each in (busy, other)]  # type: ignore[arg-type]
        assert [await each for each in firsts] == [1.0, 1.0]
        for value in (2.0, 3.0):
            waiting = asyncio.create_task(anext(other))
            await asyncio.sleep(0.01)
            sonar.feed(value)
            assert await asyncio.wait_for(waiting, 0.1) == value
        assert await anext(busy) == 3.0
        await busy.aclose()
        await other.aclose()
