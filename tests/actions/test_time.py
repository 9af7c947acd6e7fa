"""What a reaction and a behavior know of time, of readings, and of chance."""

from __future__ import annotations

import asyncio
import threading
import time
from typing import Any

import pytest

import esair
from esair import minimal
from esair.connections import SensorChannel
from esair.testing import VirtualLoop

pytestmark = pytest.mark.virtual_clock


class Note(esair.Reaction):
    """Notes the moments of its steps, and what its port says in them."""

    rate: float | None = 20.0
    sonar = esair.reads(float)

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.times: list[tuple[int, int]] = []
        self.seen: list[tuple[float, float, int]] = []

    def react(self, sonar: float) -> None:
        self.times.append((self.now_ms, self.elapsed_ms))
        newest = self.sonar.newest
        self.seen.append((sonar, newest.value, len(self.sonar.history(3))))


@pytest.mark.promise("REA-4")
async def test_a_reaction_knows_the_moment_of_its_step(fake_sensor: Any) -> None:
    """In whole milliseconds since the start, and since the step before; 0 at first."""
    note = Note()
    await asyncio.sleep(5.0)  # the robot's time begins with the robot
    async with esair.Robot(resources=[fake_sensor("sonar", 1.0)], behaviors=[note]):
        await asyncio.sleep(1.0)
    assert note.times[0][0] < 100
    assert note.times[0][1] == 0
    assert {elapsed for _now, elapsed in note.times[1:]} == {50}
    for before, after in zip(note.times, note.times[1:], strict=False):
        assert after[0] - before[0] == after[1]


@pytest.mark.promise("REA-4")
async def test_outside_of_a_robot_a_test_says_what_time_it_is(fake_sensor: Any) -> None:
    """It is 0 until then; in a robot the robot's time counts, whatever was set."""

    class When(esair.Reaction):
        rate: float | None = 20.0

        def __init__(self) -> None:
            super().__init__()
            self.steps: list[tuple[int, int]] = []

        def react(self) -> None:
            self.steps.append((self.now_ms, self.elapsed_ms))

    when = When()
    when.react()
    when.now_ms, when.elapsed_ms = 700, 50
    when.react()
    assert when.steps == [(0, 0), (700, 50)]
    async with esair.Robot(behaviors=[when]):
        await asyncio.sleep(0.3)
    assert when.steps[2][0] < 100
    assert when.steps[2][1] == 0
    assert {elapsed for _now, elapsed in when.steps[3:]} == {50}


@pytest.mark.promise("REA-4")
async def test_a_reaction_of_min_knows_it_too(fake_sensor: Any) -> None:
    """The same class, in a robot."""
    times = []

    class Small(minimal.Reaction):
        rate = 20.0
        sonar = minimal.reads(float)

        def react(self, sonar: float) -> None:
            times.append((self.now_ms, self.elapsed_ms))

    async with esair.Robot(
        resources=[fake_sensor("sonar", 1.0)],
        behaviors=[Small()],  # type: ignore[list-item]
    ):
        await asyncio.sleep(0.5)
    assert len(times) > 5
    assert [elapsed for _now, elapsed in times[:3]] == [0, 50, 50]


@pytest.mark.promise("REA-4")
async def test_inside_react_the_ports_answer_without_waiting(fake_sensor: Any) -> None:
    """The newest reading is the one that is decided on; the history has those before."""
    sonar, note = fake_sensor("sonar", 1.0), Note()
    async with esair.Robot(resources=[sonar], behaviors=[note]):
        await asyncio.sleep(0.5)
        sonar.feed(2.0)
        await asyncio.sleep(0.5)
    assert note.seen[0] == (1.0, 1.0, 1)
    assert note.seen[-1] == (2.0, 2.0, 3)
    assert all(given == newest for given, newest, _count in note.seen)


@pytest.mark.promise("REA-4", "SC-3")
async def test_the_newest_reading_is_as_old_as_what_is_decided_on() -> None:
    """At 200 Hz the last step before a silence is at the very moment of its limit."""

    class Tilt(esair.Sensor[float]):
        rate = 200.0

        async def read(self) -> float:
            now = asyncio.get_running_loop().time()
            if 2.862 <= now < 5.162:
                await asyncio.sleep(5.162 - now)
            return 1.0

    class Balance(Note):
        rate = 200.0
        sonar = esair.reads(float, name="tilt", max_age=0.02)

    balance = Balance()
    async with esair.Robot(resources=[Tilt()], behaviors=[balance]) as robot:
        await asyncio.sleep(8.0)
        status = robot.behaviors.query("balance")
    assert (status.state, status.error) == (esair.BehaviorState.RUNNING, None)
    assert balance.seen[-1] == (1.0, 1.0, 3)


@pytest.mark.promise("REA-3", "RES-2")
async def test_a_reaction_that_asks_for_what_is_not_there_begins_anew(
    fake_sensor: Any,
) -> None:
    """Its optional sensor is silent: it is parked until that speaks, and no longer."""

    class Look(esair.Reaction):
        rate = 20.0
        sonar = esair.reads(float, max_age=0.2, optional=True)
        steps = 0

        def react(self, sonar: float | None) -> None:
            assert self.sonar.newest.value == 1.0
            self.steps += 1

    sonar, look = fake_sensor("sonar", 1.0, rate=20.0), Look()
    async with esair.Robot(resources=[sonar], behaviors=[look]) as robot:
        await asyncio.sleep(1.0)
        sonar.stall()
        await asyncio.sleep(5.0)
        status = robot.behaviors.query("look")
        assert status.state is esair.BehaviorState.PARKED
        assert status.detail == "sonar is silent"
        sonar.resume()
        await asyncio.sleep(1.0)
        before = look.steps
        await asyncio.sleep(1.0)
        assert look.steps - before == 20
        assert robot.behaviors.query("look").state is esair.BehaviorState.RUNNING


@pytest.mark.promise("REA-4")
async def test_the_newest_reading_of_a_lost_sensor_is_none(fake_sensor: Any) -> None:
    """Nobody takes an old value for a new one: a behavior's port raises as read does."""
    sonar = fake_sensor("sonar", 1.0)
    user = esair.Behavior(name="user", reads={"sonar": esair.reads(float)})
    async with esair.Robot(resources=[sonar], behaviors=[user]):
        port: Any = user.sonar  # type: ignore[attr-defined]
        with pytest.raises(esair.StaleReadingError):
            _ = port.newest
        await port.read()
        assert port.newest.value == 1.0
        await asyncio.sleep(10.0)
        with pytest.raises(esair.StaleReadingError):
            _ = port.newest
        sonar.unplug()
        await asyncio.sleep(0.1)
        with pytest.raises(esair.DeviceLostError):
            _ = port.newest


@pytest.mark.promise("REA-3")
async def test_every_single_reading_has_its_step(fake_sensor: Any) -> None:
    """Several of one turn too, in their order; too many are dropped and counted."""
    clicks = fake_sensor("clicks", 0)
    heard: list[int] = []

    class Count(esair.Reaction):
        clicks = esair.reads(int, every=True)

        def react(self, clicks: int) -> None:
            heard.append(clicks)

    class Last(esair.Reaction):
        clicks = esair.reads(int)

        def react(self, clicks: int) -> None:
            pass

    async with esair.Robot(resources=[clicks], behaviors=[Count(), Last()]) as robot:
        await asyncio.sleep(0.5)
        heard.clear()
        channel: SensorChannel = robot.sensors.channel("clicks")
        for number in range(1, 6):
            channel.publish(number, -1)
        await asyncio.sleep(0.01)
        assert heard[:5] == [1, 2, 3, 4, 5]
        counts = robot.journal.counts()
        assert counts["last"]["skipped"] >= 4
        assert counts["count"]["overflow"] == 0
        heard.clear()
        for number in range(300):
            channel.publish(number, -1)
        await asyncio.sleep(0.01)
        assert heard[:256] == list(range(44, 300))
        assert robot.journal.counts()["count"]["overflow"] == 44


@pytest.mark.promise("BEH-5")
async def test_now_is_one_clock_in_the_loop_and_in_threads(fake_actuator: Any) -> None:
    """A plain behavior, a blocking driver, and a thread of asyncio show the same time."""
    shown: dict[str, float] = {}

    class Blocking(esair.Sensor[float]):
        def read(self) -> float:
            shown["driver"] = esair.now()
            return 1.0

    class Plain(esair.ThreadBehavior):
        blocking = esair.reads(float)

        def run(self) -> None:
            self.blocking.read()
            shown["thread"] = esair.now()

    await asyncio.sleep(1000.0)
    async with esair.Robot(resources=[Blocking()], behaviors=[Plain()]) as robot:
        await robot.ended()
        shown["loop"] = esair.now()
        shown["asyncio"] = await asyncio.to_thread(esair.now)
    assert min(shown.values()) >= 1000.0
    assert max(shown.values()) < 1001.0
    assert len(shown) == 4


@pytest.mark.promise("BEH-5")
@pytest.mark.real_clock
async def test_now_is_the_monotonic_time() -> None:
    """In real time, in a thread of the user's own too; in the loop that of the turn."""
    stranger: list[float] = []
    thread = threading.Thread(target=lambda: stranger.append(esair.now()))
    before = time.monotonic()
    await asyncio.sleep(0)
    here = esair.now()
    thread.start()
    thread.join()
    assert before <= here <= stranger[0] <= time.monotonic()


def _drawn(seed: int | None, *, more: bool = False) -> dict[str, list[float]]:
    """Return what each component of a robot draws."""
    found: dict[str, list[float]] = {"wander": [], "jitter": [], "plain": []}

    class Wander(esair.Behavior):
        async def run(self) -> None:
            for _ in range(3):
                found["wander"].append(esair.random.uniform(0.0, 1.0))
                await asyncio.sleep(0.1)

    class Plain(esair.ThreadBehavior):
        def run(self) -> None:
            found["plain"].append(esair.random.random())

    class Jitter(esair.Reaction):
        rate = 10.0
        sonar = esair.reads(float)

        def react(self, sonar: float) -> None:
            found["jitter"].append(esair.random.gauss(0.0, 1.0))

    class Other(Wander):
        async def run(self) -> None:
            for _ in range(5):
                esair.random.randrange(10)
                await asyncio.sleep(0.03)

    class Sonar(esair.Sensor[float]):
        async def read(self) -> float:
            return 1.0

    async def live() -> None:
        actions: list[Any] = [Wander(), Jitter(), Plain()]
        robot = esair.Robot(
            resources=[Sonar()],
            behaviors=[*actions, Other()] if more else actions,
            seed=seed,
        )
        async with robot:
            await asyncio.sleep(1.0)
            assert robot.seed == (seed or 0)

    loop = VirtualLoop()
    try:
        loop.run_until_complete(live())
    finally:
        loop.close()
    return found


@pytest.mark.promise("BEH-5")
def test_the_same_seed_gives_each_component_the_same_numbers() -> None:
    """What another component draws changes nothing; another seed gives others."""
    seven = _drawn(7)
    assert seven == _drawn(7, more=True)
    assert all(seven.values())
    assert seven["wander"][0] != seven["plain"][0]
    assert seven != _drawn(8)
    assert _drawn(None) == _drawn(None)  # on the virtual clock everything repeats


def test_the_seed_is_the_robots() -> None:
    """No component can disturb the numbers of another."""
    with pytest.raises(TypeError, match="seed"):
        esair.random.seed(1)
    with pytest.raises(esair.ConfigError, match="seed"):
        esair.Robot(seed="x")  # type: ignore[arg-type]


async def test_what_is_no_component_draws_without_a_seed() -> None:
    """A driver, say: in two robots of one seed it gives other numbers."""

    class Noise(esair.Sensor[float]):
        async def read(self) -> float:
            return esair.random.random()

    seen: list[float] = []
    for _ in range(2):
        user: Any = esair.Behavior(name="user", reads={"noise": esair.reads(float)})
        async with esair.Robot(resources=[Noise()], behaviors=[user], seed=7):
            seen.append(await user.noise.read())
    assert seen[0] != seen[1]


async def test_a_component_can_draw_the_same_again() -> None:
    """From where it has kept the state of its own stream."""

    class Twice(esair.Behavior):
        drawn: tuple[float, float]

        async def run(self) -> None:
            state = esair.random.getstate()
            first = esair.random.random()
            esair.random.setstate(state)
            self.drawn = first, esair.random.random()

    twice = Twice()
    async with esair.Robot(behaviors=[twice]) as robot:
        await robot.ended()
    assert twice.drawn[0] == twice.drawn[1]
