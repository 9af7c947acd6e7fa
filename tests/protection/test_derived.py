"""Sensors that are computed of others: as old, as lost and as right as those are."""

from __future__ import annotations

import asyncio
import math
from typing import Any

import pytest

import esair
from esair.messages import BehaviorState, ResourceState
from esair.testing import FakeActuator, FakeSensor

pytestmark = pytest.mark.virtual_clock

RATE = 20.0  # Hz


class Distance(esair.Derived[float]):
    """The mean of what both wheels have turned."""

    left = esair.reads(float)
    right = esair.reads(float)

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.seen: list[tuple[float, float, float]] = []
        self.begun = 0
        self.bug = False

    def open(self) -> None:
        self.begun += 1

    def compute(self, left: float, right: float) -> float | None:
        if self.bug:
            raise RuntimeError("a bug")
        self.seen.append((esair.now(), left, right))
        return (left + right) / 2


class Follow(esair.Reaction):
    """Tell the wheels the distance; it remembers what it has decided on."""

    distance = esair.reads(float)
    left = esair.reads(float, optional=True)
    wheels = esair.writes(float)

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.seen: list[tuple[float, float | None]] = []

    def react(self, distance: float, left: float | None) -> float:
        self.seen.append((distance, left))
        return distance


class Encoder(FakeSensor[float]):
    """It is asked, and never speaks unasked."""

    pushes = False

    def turn(self, value: float) -> None:
        """Answer so from now on."""
        self._value = value


def encoder(name: str, value: float, rate: float = RATE) -> Encoder:
    return Encoder(name, value, type=float, rate=rate)


def rover() -> tuple[Encoder, Encoder, FakeActuator[float]]:
    wheels: FakeActuator[float] = FakeActuator("wheels", safe=0.0)
    return encoder("left", 1.0), encoder("right", 3.0), wheels


async def test_it_is_computed_once_a_turn_and_before_anybody_decides() -> None:
    """Whoever reads it and its source sees both of the same moment."""
    left, right, wheels = rover()
    distance, follow = Distance(), Follow()
    async with esair.Robot(
        resources=[distance, left, right, wheels], behaviors=[follow]
    ):
        for n in range(2, 10):
            left.turn(float(n))
            right.turn(n + 2.0)
            await asyncio.sleep(1.0 / RATE)
    times = [moment for moment, _, _ in distance.seen]
    assert len(times) == len(set(times)) >= 8
    assert all(value == (one or 0.0) + 1.0 for value, one in follow.seen)
    assert follow.seen[-1] == (10.0, 9.0)


async def test_a_behavior_reads_it_like_any_sensor() -> None:
    """By value, with its time, as a stream, from its history, and fresh."""
    left, right, wheels = rover()
    told: dict[str, Any] = {}

    class Ask(esair.Behavior):
        distance = esair.reads(float)

        async def run(self) -> None:
            told["value"] = await self.distance.read()
            told["reading"] = await self.distance.reading()
            left.turn(5.0)
            told["fresh"] = await self.distance.read(fresh=True)
            async for value in self.distance:
                told["stream"] = value
                break
            told["history"] = [each.value for each in self.distance.history(3)]

    async with esair.Robot(
        resources=[Distance(), left, right, wheels], behaviors=[Ask()]
    ) as robot:
        await asyncio.wait_for(robot.ended(), 2.0)
    assert told["value"] == 2.0
    assert told["reading"].sequence >= 1
    assert told["fresh"] == told["stream"] == 4.0
    assert told["history"][-1] == 4.0


async def test_it_is_as_old_as_the_oldest_reading_that_it_was_computed_of() -> None:
    """A source that is slow, or silent, is not hidden by one that is quick."""
    left, wheels = encoder("left", 1.0), FakeActuator("wheels", safe=0.0)
    right = encoder("right", 3.0, rate=2.0)
    distance = Distance()

    class Look(esair.Behavior):
        distance = esair.reads(float)

        async def run(self) -> None:
            await asyncio.sleep(0.45)
            reading = await self.distance.reading()
            ages.append(esair.now() - reading.time)

    ages: list[float] = []
    async with esair.Robot(
        resources=[left, right, distance, wheels], behaviors=[Look()]
    ) as robot:
        await robot.ended()
    assert ages == [pytest.approx(0.45, abs=0.06)]


async def test_it_is_too_old_when_the_first_of_its_sources_is() -> None:
    """A source that has stalled stops who decides on it, in that source's time."""
    left, right, wheels = rover()
    follow = Follow()
    async with esair.Robot(
        resources=[left, right, Distance(), wheels], behaviors=[follow]
    ) as robot:
        await wheels.until(2.0, timeout=1.0)
        await asyncio.sleep(0.11)
        right.stall()
        await asyncio.sleep(3.0 / RATE + 0.02)
        assert robot.behaviors.query("follow").state is BehaviorState.PARKED
        assert wheels.commands[-1] == 0.0
        assert robot.resources.query("distance").state is ResourceState.READY
        right_to_read = await robot.resources.register(
            "user", "distance", esair.Access.READ
        )
        with pytest.raises(esair.StaleReadingError):
            await robot.sensors.read(right_to_read)


@pytest.mark.promise("SC-3")
async def test_it_is_lost_with_its_source_and_back_with_it() -> None:
    """In the same step: nobody moves on what a lost encoder has said."""
    left, right, wheels = rover()
    distance = Distance()
    async with esair.Robot(
        resources=[left, right, distance, wheels], behaviors=[Follow()]
    ) as robot:
        await wheels.until(2.0, timeout=1.0)
        right.unplug()
        await asyncio.sleep(0)
        status = robot.resources.query("distance")
        assert status.state is ResourceState.LOST
        assert "right" in str(status.error)
        await asyncio.sleep(0.02)
        assert wheels.commands[-1] == 0.0
        await asyncio.sleep(1.0)
        right.turn(7.0)
        right.plug()
        await wheels.until(4.0, timeout=0.5)
        assert robot.resources.query("distance").losses == 1
        assert distance.begun == 2


async def test_one_whose_source_is_absent_at_the_start_comes_with_it() -> None:
    """The robot starts; what depends on it waits."""
    left, right, wheels = rover()
    left.unplug()
    async with esair.Robot(
        resources=[Distance(), left, right, wheels], behaviors=[Follow()]
    ) as robot:
        assert robot.resources.query("distance").state is ResourceState.LOST
        await asyncio.sleep(1.0)
        assert wheels.commands == [0.0]
        left.plug()
        await wheels.until(2.0, timeout=0.5)


@pytest.mark.promise("RS-5")
async def test_a_source_that_is_removed_and_added_is_found_again() -> None:
    """One of another type is not: the derived sensor says so, and stays lost."""
    left, right, wheels = rover()
    async with esair.Robot(
        resources=[Distance(), left, right, wheels], behaviors=[Follow()]
    ) as robot:
        await wheels.until(2.0, timeout=1.0)
        await robot.resources.remove("left")
        assert robot.resources.query("distance").state is ResourceState.LOST
        await robot.resources.add(FakeSensor("left", "far", type=str))
        await asyncio.sleep(0.2)
        assert "gives str" in str(robot.resources.query("distance").error)
        await robot.resources.remove("left")
        await robot.resources.add(encoder("left", 5.0))
        await wheels.until(4.0, timeout=0.5)
        await robot.resources.replace("left", encoder("left", 7.0))
        await wheels.until(5.0, timeout=0.5)
        await robot.resources.remove("distance")
        await robot.resources.add(Distance())
        wheels.commands.clear()
        await wheels.until(5.0, timeout=0.5)


@pytest.mark.fault("I02")
@pytest.mark.parametrize("value", [math.nan, math.inf, "far", None])
async def test_what_is_no_good_reaches_nobody(value: Any) -> None:
    """A computed value is checked like any reading; nothing new is no value."""
    left, right, wheels = rover()

    class Distance(esair.Derived[float]):
        left = esair.reads(float)
        bad = False

        def compute(self, left: float) -> float:
            return value if self.bad else left  # type: ignore[no-any-return]

    distance, follow = Distance(), Follow()
    async with esair.Robot(
        resources=[distance, left, right, wheels], behaviors=[follow]
    ) as robot:
        await wheels.until(1.0, timeout=1.0)
        distance.bad = True
        await asyncio.sleep(1.0)
        assert {each for each, _ in follow.seen} == {1.0}
        assert wheels.commands[-1] == 0.0
        assert robot.behaviors.query("follow").state is BehaviorState.PARKED
        assert (robot.resources.query("distance").faults > 0) is (value is not None)


@pytest.mark.fault("B01")
async def test_a_bug_in_it_is_a_fault_of_it_and_of_nobody_else() -> None:
    """It is closed and begun anew within its budget, then failed until a restart."""
    left, right, wheels = rover()
    distance = Distance()
    async with esair.Robot(
        resources=[distance, left, right, wheels], behaviors=[Follow()]
    ) as robot:
        await wheels.until(2.0, timeout=1.0)
        distance.bug = True
        await asyncio.sleep(0.5)
        assert wheels.commands[-1] == 0.0
        await asyncio.sleep(30.0)
        status = robot.resources.query("distance")
        assert status.state is ResourceState.FAILED
        assert "a bug" in str(status.error)
        assert robot.resources.query("left").state is ResourceState.READY
        distance.bug = False
        wheels.commands.clear()
        await robot.resources.restart("distance")
        await wheels.until(2.0, timeout=0.5)


async def test_one_of_another_one_comes_after_it_in_the_same_turn() -> None:
    """Depth decides, not names or the order in which they were given."""

    class Above(esair.Derived[float]):
        distance = esair.reads(float)
        left = esair.reads(float)

        def compute(self, distance: float, left: float) -> float:
            seen.append((distance, left))
            return distance - left

    seen: list[tuple[float, float]] = []
    left, right, wheels = rover()
    async with esair.Robot(resources=[Above(), Distance(), left, right, wheels]):
        for n in range(2, 8):
            left.turn(float(n))
            right.turn(n + 2.0)
            await asyncio.sleep(1.0 / RATE)
    assert len(seen) >= 6
    assert all(distance == one + 1.0 for distance, one in seen)


async def test_what_is_optional_may_be_absent() -> None:
    """It gets None then, and is computed anew when that comes or goes."""
    left, right, wheels = rover()

    class Distance(esair.Derived[float]):
        left = esair.reads(float)
        right = esair.reads(float, optional=True)

        def compute(self, left: float, right: float | None) -> float:
            return left if right is None else (left + right) / 2

    right.unplug()
    async with esair.Robot(
        resources=[Distance(), left, right, wheels], behaviors=[Follow()]
    ) as robot:
        await wheels.until(1.0, timeout=1.0)
        right.plug()
        await wheels.until(2.0, timeout=1.0)
        right.unplug()
        await wheels.until(1.0, timeout=1.0)
        right.plug()
        await wheels.until(2.0, timeout=9.0)
        await robot.resources.remove("right")
        await wheels.until(1.0, timeout=1.0)
        assert 0.0 not in wheels.commands[1:]


@pytest.mark.promise("TURN-3")
async def test_who_has_a_rate_waits_for_the_samples_that_it_is_computed_of() -> None:
    """The reading is of this instant, though its sources take a while to answer."""
    left, right, wheels = rover()
    ages: list[float] = []

    class Follow(esair.Reaction):
        rate = RATE
        distance = esair.reads(float)
        wheels = esair.writes(float)

        def react(self, distance: float) -> float:
            ages.append(esair.now() - self.distance.newest.time)
            return distance

    for each in (left, right):
        each.slow(0.004)
    async with esair.Robot(
        resources=[Distance(), left, right, wheels], behaviors=[Follow()]
    ):
        await asyncio.sleep(1.0)
    assert sorted(ages)[len(ages) // 2] < 0.1 / RATE


async def test_it_has_settings_operations_and_a_sense_of_time() -> None:
    """As any resource has; compute and operations never meet in two threads."""

    class Turned(esair.Derived[float]):
        scale = esair.setting(1.0, min=0.1, max=10.0)
        left = esair.reads(float)
        zero = 0.0

        def compute(self, left: float) -> float:
            elapsed.append(self.elapsed_ms)
            self.last = self.left.newest.value
            return self.scale * (left - self.zero)

        @esair.operation
        async def reset(self) -> None:
            self.zero = self.last

    elapsed: list[int] = []
    left = encoder("left", 3.0)
    told: list[float] = []

    class Use(esair.Behavior):
        turned = esair.reads(float, configure=True)

        async def run(self) -> None:
            told.append(await self.turned.read())
            await self.turned.configure(scale=2.0)
            told.append(await self.turned.read(fresh=True))
            await self.turned.operate("reset")
            told.append(await self.turned.read(fresh=True))

    policy = esair.Policy(
        "turned", allow={"use": esair.Access.READ | esair.Access.CONFIGURE}
    )
    async with esair.Robot(
        resources=[Turned(), left], behaviors=[Use()], policies=[policy]
    ) as robot:
        await asyncio.wait_for(robot.ended(), 2.0)
        await asyncio.sleep(0.2)
    assert told == [3.0, 6.0, 0.0]
    assert elapsed[0] == 0
    assert elapsed[-1] == 50


# What the rulebook says.


def mistakes(*resources: Any, **options: Any) -> list[str]:
    from esair.plan import Plan, examine

    found = examine(Plan(resources=resources, **options))
    return [f"{f.component}.{f.field}: {f.text}" for f in found if f.is_error]


class _Async(esair.Derived[float]):
    left = esair.reads(float)

    async def compute(self, left: float) -> float:  # type: ignore[override]
        return left


class _Other(esair.Derived[float]):
    left = esair.reads(float)

    def compute(self, right: float) -> float:  # type: ignore[override]
        return right


class _Mistyped(esair.Derived[float]):
    left = esair.reads(float)

    def compute(self, left: str) -> float:  # type: ignore[override]
        return float(left)


class _Nothing(esair.Derived[float]):
    def compute(self) -> float:
        return 0.0


class _Silent(esair.Derived[float]):
    left = esair.reads(float)


class _Asked(esair.Derived[float]):
    left = esair.reads(float)

    def compute(self, left: float) -> float:
        return left

    async def read(self) -> float:
        return 0.0


class _Itself(esair.Derived[float]):
    other = esair.reads(float)

    def compute(self, other: float) -> float:
        return other


class _Moved(esair.Derived[float]):
    wheels = esair.reads(float)

    def compute(self, wheels: float) -> float:
        return wheels


class _Untyped(esair.Derived[float]):
    left = esair.reads("left")  # type: ignore[var-annotated, arg-type]

    def compute(self, left: Any) -> float:
        return 0.0


class _Threaded(_Itself):
    other = esair.reads(float, name="left")

    @esair.operation
    def zero(self) -> None: ...


@pytest.mark.promise("RS-8")
@pytest.mark.parametrize(
    ("derived", "told"),
    [
        (Distance(), "no resource is named 'right'"),
        (_Async(), "expected a plain function, not async"),
        (_Other(), "its parameters must be its readings (left)"),
        (_Mistyped(), "its parameter 'left' is a str"),
        (_Nothing(), "it is computed of nothing"),
        (_Silent(), "a derived sensor must have a compute method"),
        (_Asked(), "has no read, stream or initial value"),
        (_Moved(), "its last command is read as name='wheels.applied'"),
        (_Untyped(), "expected a type such as float, not 'left'"),
        (_Threaded(), "expected async def"),
    ],
)
def test_a_mistake_in_it_stops_the_start(derived: Any, told: str) -> None:
    """With the words that a reaction gets."""
    wheels: FakeActuator[float] = FakeActuator("wheels", safe=0.0)
    found = mistakes(derived, encoder("left", 1.0), wheels)
    assert len(found) == 1
    assert found[0].startswith(derived.name)
    assert told in found[0]


def test_nothing_is_computed_of_itself() -> None:
    """Not even over others."""
    one, other = _Itself(name="one"), _Itself(name="other")
    found = mistakes(one, other)
    assert found == ["other.: it is computed of itself: other of other"]

    class Back(esair.Derived[float]):
        one = esair.reads(float)

        def compute(self, one: float) -> float:
            return one

    found = mistakes(_Itself(name="one"), Back(name="other"))
    assert found == [
        "one.: it is computed of itself: one of other of one",
        "other.: it is computed of itself: other of one of other",
    ]


def test_a_policy_counts_for_it() -> None:
    """It reads its sources in its own name."""
    policy = esair.Policy("left", allow={"somebody": esair.Access.READ})
    left, right, _ = rover()
    (found,) = mistakes(Distance(), left, right, policies=[policy])
    assert "allow 'distance' READ there" in found
    policy = esair.Policy("left", allow={"distance": esair.Access.READ})
    assert not mistakes(Distance(), left, right, policies=[policy])


def test_it_has_no_rate_to_set() -> None:
    """It is computed when its sources speak."""
    with pytest.raises(esair.BadValueError, match="rate"):
        Distance(rate=20.0)


@pytest.mark.promise("SC-1", "SC-2")
async def test_only_who_wants_a_fresh_value_has_the_sources_asked() -> None:
    """And only while it is there, by right, and those that it needs."""
    left, right, _ = rover()

    class Maybe(esair.Derived[float]):
        left = esair.reads(float)
        right = esair.reads(float, optional=True)

        def compute(self, left: float, right: float | None) -> float:
            return left + (right or 0.0)

    left.rate, right.rate = 1.0, 1.0
    async with esair.Robot(resources=[Maybe(name="both"), left, right]) as robot:
        mine = await robot.resources.register("user", "both", esair.Access.READ)
        assert (await robot.sensors.read(mine, fresh=True)).value in {1.0, 4.0}
        asked = (left.reads, right.reads)
        await robot.sensors.read(mine)
        assert (left.reads, right.reads) == asked
        await asyncio.sleep(0.1)
        with pytest.raises(esair.StaleReadingError):
            await robot.sensors.read(mine, max_age=0.05, timeout=0.1)
        assert (left.reads, right.reads) == asked
        right.stall()
        await robot.sensors.read(mine, fresh=True, timeout=0.1)
        assert (left.reads, right.reads) == (asked[0] + 1, asked[1])
        robot.resources.revoke(mine)
        with pytest.raises(esair.NotRegisteredError):
            await robot.sensors.read(mine, fresh=True)
        assert (left.reads, right.reads) == (asked[0] + 1, asked[1])
        right.resume()


@pytest.mark.promise("SC-1")
async def test_a_fresh_value_has_one_timeout_in_all() -> None:
    """What the first source took is taken from the second."""
    left, right, _ = rover()
    left.rate, right.rate = 1.0, 1.0
    async with esair.Robot(resources=[Distance(), left, right]) as robot:
        mine = await robot.resources.register("user", "distance", esair.Access.READ)
        left.slow(0.3)
        right.slow(0.3)
        began = asyncio.get_running_loop().time()
        with pytest.raises(esair.StaleReadingError):
            await robot.sensors.read(mine, fresh=True, timeout=0.5)
        assert asyncio.get_running_loop().time() - began == pytest.approx(0.5)
        await asyncio.sleep(0.9)  # not at the moment of a poll, which goes first
        reading = await robot.sensors.read(mine, fresh=True, timeout=0.7)
        assert asyncio.get_running_loop().time() - reading.time == pytest.approx(0.3)


@pytest.mark.promise("SUP-1")
async def test_who_waits_for_a_first_value_waits_as_long_as_it_says() -> None:
    """Whenever it asks: what was computed of has not spoken yet."""
    left: FakeSensor[float] = FakeSensor("left", type=float)
    right = FakeSensor("right", 1.0)
    user: Any = esair.Behavior(name="user", reads={"distance": esair.reads(float)})
    async with esair.Robot(
        resources=[left, right, Distance(name="distance")], behaviors=[user]
    ):
        await asyncio.sleep(5.3)
        began = esair.now()
        with pytest.raises(esair.StaleReadingError):
            await user.distance.read(timeout=0.25)
        assert esair.now() - began == pytest.approx(0.25, abs=0.01)


async def test_it_waits_at_the_start_until_its_sources_were_tried() -> None:
    """It is no loss that they are not open yet."""

    class Slow(Encoder):
        async def open(self) -> None:
            await asyncio.sleep(0.3)
            await super().open()

    _, right, wheels = rover()
    slow = Slow("left", 1.0, type=float, rate=RATE)
    distance = Distance()
    async with esair.Robot(
        resources=[distance, slow, right, wheels], behaviors=[Follow()]
    ) as robot:
        status = robot.resources.query("distance")
        assert (status.state, status.losses) == (ResourceState.READY, 0)
        assert distance.begun == 1


@pytest.mark.promise("RS-3")
async def test_the_rights_of_a_derived_one_end_with_each_of_its_openings() -> None:
    """However often it was bound anew it has one for each source; removed, none."""
    left, right = (FakeSensor(n, 1.0, type=float, rate=RATE) for n in ("left", "right"))
    async with esair.Robot(resources=[left, right, Distance()]) as robot:

        def live() -> list[str]:
            rights = robot._resources.registrations.live.values()
            return sorted(each.resource for each in rights)

        for _ in range(3):
            assert live() == ["left", "right"]
            await robot.resources.replace(
                "left", FakeSensor("left", 2.0, type=float, rate=RATE)
            )
            await asyncio.sleep(0.5)
        await robot.resources.remove("distance")
        assert live() == []


@pytest.mark.parametrize("bad", [math.nan, "rubbish"])
async def test_who_wants_a_fresh_value_gets_no_old_one_for_a_bad_one(bad: Any) -> None:
    """What was computed of fresh readings and is no good is an error, or nothing."""

    class Odd(esair.Derived[float]):
        sonar = esair.reads(float)

        def compute(self, sonar: float) -> float:
            return bad if sonar > 1.0 else sonar  # type: ignore[no-any-return]

    class Sonar(esair.Sensor[float]):
        rate = 1.0
        now = 1.0

        async def read(self) -> float:
            return self.now

    sonar = Sonar()
    user: Any = esair.Behavior(name="user", reads={"odd": esair.reads(float)})
    async with esair.Robot(resources=[sonar, Odd()], behaviors=[user]):
        assert await user.odd.read(fresh=True) == 1.0
        sonar.now = 2.0
        with pytest.raises(esair.EsairError):
            await user.odd.read(fresh=True, timeout=0.5)


async def test_a_bad_value_does_not_lengthen_the_life_of_the_good_one_before() -> None:
    """That is too old when it would have been without it."""

    class Odd(esair.Derived[float]):
        left = esair.reads(float)
        fault_limit = 1000

        def compute(self, left: float) -> float:
            return left if left < 2.0 else math.nan

    left = encoder("left", 1.0)
    user: Any = esair.Behavior(name="user", reads={"odd": esair.reads(float)})
    async with esair.Robot(resources=[left, Odd()], behaviors=[user]):
        await asyncio.sleep(1.0)
        assert await user.odd.read() == 1.0
        left.turn(2.0)
        await asyncio.sleep(0.5)
        with pytest.raises(esair.StaleReadingError):
            await user.odd.read()


async def test_a_source_that_is_not_there_is_the_cause_of_its_absence() -> None:
    """Who reads what is computed of it finds the reason."""
    left, right, _ = rover()
    left.unplug()
    user: Any = esair.Behavior(name="user", reads={"distance": esair.reads(float)})
    async with esair.Robot(resources=[Distance(), left, right], behaviors=[user]):
        with pytest.raises(esair.DeviceLostError, match="its source") as raised:
            await user.distance.read()
        cause = raised.value.__cause__
        assert isinstance(cause, esair.EsairError)
        assert str(cause) == "device of 'left' is lost: it is unplugged"


@pytest.mark.promise("RES-2", "ROB-3")
@pytest.mark.parametrize("error", [GeneratorExit, asyncio.CancelledError])
async def test_whatever_its_open_raises_it_is_opened_again(
    error: type[BaseException],
) -> None:
    """It was never open again, and nobody was told."""

    class Fails(Distance):
        def open(self) -> None:
            super().open()
            if self.begun == 1:
                raise error

    left, right, _ = rover()
    distance = Fails()
    robot = esair.Robot(resources=[left, right, distance])
    async with asyncio.timeout(10.0), robot:
        await asyncio.sleep(5.0)
        assert robot.resources.query("fails").state is ResourceState.READY

    assert distance.begun == 2
