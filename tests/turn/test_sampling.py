"""A reaction with a rate samples its sensors, then decides."""

from __future__ import annotations

import asyncio
import math
import statistics
import time
from typing import Any

import pytest

import esair
from esair.testing import FakeActuator

RATE = 20.0


class Asked(esair.Sensor[float]):
    """Answers after a time; its value is the moment at which it answered."""

    def __init__(self, name: str, rate: float, takes: float) -> None:
        super().__init__(name=name)
        self.rate = rate
        self.takes = takes

    async def read(self) -> float:
        if self.takes:
            await asyncio.sleep(self.takes)
        return asyncio.get_running_loop().time()


class InThread(Asked):
    """The same with a plain method, which blocks a thread."""

    def read(self) -> float:  # type: ignore[override]
        time.sleep(self.takes)
        return time.monotonic()


class Ages(esair.Reaction):
    """Notes how old what it decides on is."""

    rate = RATE
    sensor = esair.reads(float, max_age=10.0)
    motor = esair.writes(float)

    def __init__(self, name: str = "ages") -> None:
        super().__init__(name=name)
        self.ages: list[float] = []
        self.moments: list[float] = []

    def react(self, sensor: float) -> float:
        now = asyncio.get_running_loop().time()
        self.ages.append(now - sensor)
        self.moments.append(now)
        return 1.0


async def ages(sensor: Any, seconds: float) -> Ages:
    reaction = Ages()
    robot = esair.Robot(
        resources=[sensor, FakeActuator("motor", safe=0.0)], behaviors=[reaction]
    )
    async with robot:
        await asyncio.sleep(seconds)
    return reaction


@pytest.mark.virtual_clock
@pytest.mark.promise("TURN-3")
@pytest.mark.parametrize("rate", [20.0, 40.0, 60.0, 100.0])
@pytest.mark.parametrize("takes", [0.0, 0.002, 0.008])
async def test_a_reaction_decides_on_what_was_sampled_at_its_own_instant(
    rate: float, takes: float
) -> None:
    """The age is far below a tenth of the period, whatever harmonic rate is asked."""
    reaction = await ages(Asked("sensor", rate, takes), 5.0)

    assert len(reaction.ages) >= 99
    assert statistics.median(reaction.ages) < 1e-6


@pytest.mark.virtual_clock
@pytest.mark.promise("TURN-3")
async def test_a_sensor_that_is_too_slow_is_not_waited_for() -> None:
    """It answers after 35 of 50 ms: the steps keep their own moments."""
    reaction = await ages(Asked("sensor", RATE, 0.035), 5.0)

    assert len(reaction.moments) >= 95
    late = [moment % 0.05 for moment in reaction.moments[3:]]
    assert max(min(each, 0.05 - each) for each in late) < 1e-6


@pytest.mark.virtual_clock
@pytest.mark.promise("TURN-3")
async def test_a_sensor_that_stops_answering_delays_a_step_by_half_a_period() -> None:
    """It is waited for once more, and then known as slow."""
    sensor = Asked("sensor", RATE, 0.002)
    reaction = Ages()
    robot = esair.Robot(
        resources=[sensor, FakeActuator("motor", safe=0.0)], behaviors=[reaction]
    )
    async with robot:
        await asyncio.sleep(1.01)
        sensor.takes = 0.6
        before = len(reaction.moments)
        await asyncio.sleep(0.5)
        late = [moment % 0.05 for moment in reaction.moments[before:]]

    assert late[0] == pytest.approx(0.025)
    assert len(late) == 10
    assert max(min(each, 0.05 - each) for each in late[1:]) < 1e-6


@pytest.mark.virtual_clock
@pytest.mark.promise("TURN-3")
async def test_a_failing_sensor_is_not_waited_for_longer_than_its_error() -> None:
    """The step comes when the poll of its instant has ended, whatever came of it."""

    class Failing(Asked):
        async def read(self) -> float:
            value = await super().read()
            if value > 1.0:
                raise ValueError("no")
            return value

    reaction = await ages(Failing("sensor", RATE, 0.004), 1.4)

    assert [moment % 0.05 for moment in reaction.moments[-5:]] == pytest.approx(
        [0.004] * 5
    )


class Same(esair.Derived[float]):
    """Computed of a sensor, with nothing added."""

    source = esair.reads(float, max_age=10.0)

    def compute(self, source: float) -> float:
        return source


class Optional(Same):
    """It is there without its source, too."""

    source = esair.reads(float, max_age=10.0, optional=True)


@pytest.mark.virtual_clock
@pytest.mark.promise("TURN-3")
@pytest.mark.parametrize("how", ["added", "replaced"])
@pytest.mark.parametrize("kind", [Same, Optional])
async def test_samples_of_a_source_that_has_come_are_waited_for(
    how: str, kind: type[Same]
) -> None:
    """What is computed of it is as new as it was with the source before."""
    reaction, motor = Ages(), FakeActuator("motor", safe=0.0)

    def source() -> Asked:
        return Asked("source", RATE, 0.002)

    robot = esair.Robot(
        resources=[kind(name="sensor"), motor, source()], behaviors=[reaction]
    )
    async with robot:
        if how == "replaced":
            await robot.resources.replace("source", source())
        else:
            await robot.resources.remove("source")
            await robot.resources.add(source())
        await asyncio.sleep(1.0)
        reaction.ages.clear()
        await asyncio.sleep(5.0)

    assert len(reaction.ages) >= 99
    assert statistics.median(reaction.ages) < 1e-6


@pytest.mark.virtual_clock
@pytest.mark.promise("TURN-3")
@pytest.mark.parametrize("watched", [False, True])
async def test_what_a_guard_sees_is_waited_for_as_long_as_it_guards(
    watched: bool,
) -> None:
    """All who have a say in one actuator decide on samples of one instant."""

    class Guard(esair.Reaction):
        other = esair.reads(float)
        motor = esair.guards(float)
        rate = RATE

        def react(self, other: float, motor: float) -> float:
            return motor

    class Watch(esair.Behavior):
        other = esair.reads(float)

        async def run(self) -> None:
            async for _ in self.other:
                pass

    reaction = Ages()
    devices = [Asked("sensor", RATE, 0.002), Asked("other", RATE, 0.01)]
    robot = esair.Robot(
        resources=[*devices, FakeActuator("motor", safe=0.0)],
        behaviors=[reaction, Guard(), *[Watch()] * watched],
    )
    async with robot:
        await asyncio.sleep(1.0)
        assert reaction.moments[-1] % 0.05 == pytest.approx(0.01)
        await robot.behaviors.remove("guard")
        await asyncio.sleep(1.0)
        assert reaction.moments[-1] % 0.05 == pytest.approx(0.002)


@pytest.mark.real_clock
@pytest.mark.promise("TURN-3")
@pytest.mark.parametrize("kind", [Asked, InThread])
async def test_the_same_in_real_time(kind: Any) -> None:
    """With a device that takes 2 ms, in the loop and on a thread.

    A busy computer makes a value old, never new: without the phase all would be old.
    """
    reaction = await ages(kind("sensor", RATE, 0.002), 2.0)

    assert statistics.quantiles(reaction.ages, n=4)[0] < 0.1 / RATE


@pytest.mark.virtual_clock
@pytest.mark.promise("TURN-3")
async def test_a_sensor_that_takes_just_half_a_period_is_waited_for() -> None:
    """Each step decides on the answer of its own instant."""
    sensor = Asked("sensor", 16.0, 1 / 32)
    reaction = Ages()
    reaction.rate = 16.0
    robot = esair.Robot(
        resources=[sensor, FakeActuator("motor", safe=0.0)], behaviors=[reaction]
    )
    async with robot:
        await asyncio.sleep(5.0)

    assert statistics.median(reaction.ages) < 1e-6


class Beside(esair.Reaction):
    """Has another sensor asked at each instant."""

    rate = RATE
    other = esair.reads(float)

    def react(self, other: float) -> None:
        """Move nothing."""


@pytest.mark.virtual_clock
@pytest.mark.promise("TURN-3")
@pytest.mark.parametrize(("rate", "takes"), [(5.0, 0.002), (16.0, 0.02)])
async def test_who_is_not_asked_at_the_instant_of_a_step_is_not_waited_for(
    rate: float, takes: float
) -> None:
    """Neither one whose poll is not due, nor one whose earlier poll is on its way."""
    reaction, other = Ages(), Asked("other", RATE, 0.002)
    sensors = [Asked("sensor", rate, takes), other]
    motor = FakeActuator("motor", safe=0.0)
    async with esair.Robot(resources=[*sensors, motor], behaviors=[reaction, Beside()]):
        await asyncio.sleep(5.0)

    own = [moment * RATE % 1 for moment in reaction.moments]
    late = [each for each in own if 1e-6 < each < 1 - 1e-6]
    asked_together = 5.0 * math.gcd(int(RATE), int(rate))
    assert len(reaction.moments) >= 99
    assert len(late) <= asked_together + 1


class Rival(esair.Reaction):
    """Moves the same by a sensor that takes its time."""

    rate = RATE
    slower = esair.reads(float)

    def react(self, slower: float) -> None:
        """Have no opinion now."""


@pytest.mark.virtual_clock
@pytest.mark.promise("TURN-2", "TURN-3")
@pytest.mark.parametrize(("priority", "after"), [(1, 0.01), (0, 0.01), (-1, 0.0)])
async def test_who_has_as_much_to_say_is_waited_for(
    priority: int, after: float
) -> None:
    """Both decide on what there is to see at one moment; one with less is not."""
    reaction, motor = Ages(), FakeActuator("motor", safe=0.0)
    rival = Rival(writes={"motor": esair.writes(float, priority=priority)})
    sensors = [Asked("sensor", RATE, 0.0), Asked("slower", RATE, 0.01)]
    async with esair.Robot(resources=[*sensors, motor], behaviors=[reaction, rival]):
        await asyncio.sleep(3.0)

    waited = [moment * RATE % 1 / RATE for moment in reaction.moments[5:]]
    assert len(waited) >= 50
    assert [round(each, 6) % 0.05 for each in waited] == [after] * len(waited)


@pytest.mark.virtual_clock
async def test_who_is_removed_while_it_waits_for_a_sample_steps_no_more() -> None:
    """The sample comes for nobody."""
    asked = asyncio.Event()

    class Slow(esair.Sensor[float]):
        rate = 10.0

        async def read(self) -> float:
            asked.set()
            await asyncio.sleep(0.03)
            return 1.0

    class Looks(esair.Reaction):
        rate = 10.0
        slow = esair.reads(float)
        steps = 0

        def react(self, slow: float) -> None:
            self.steps += 1

    looks = Looks()
    async with esair.Robot(resources=[Slow()], behaviors=[looks]) as robot:
        await asyncio.sleep(0.55)
        asked.clear()
        await asked.wait()
        before = looks.steps
        await robot.behaviors.remove("looks")
        await asyncio.sleep(1.0)
        assert looks.steps == before > 3
