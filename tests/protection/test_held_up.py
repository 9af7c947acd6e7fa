"""A loop that was held up: nothing moves on what was seen before."""

from __future__ import annotations

import asyncio
import time
from typing import Any

import pytest
from tests.turn.loops import LOOPS, Make, run

import esair
from esair.loop import turn_of
from esair.testing import FakeActuator

pytestmark = pytest.mark.real_clock


class Sonar(esair.Sensor[float]):
    """Says when it has measured."""

    rate = 20.0
    max_age = 0.15
    blocking = False

    def read(self) -> float:
        return time.monotonic()


class SlowSonar(Sonar):
    """The same, by a driver that takes a thread for a while."""

    blocking = True

    def read(self) -> float:
        measured = time.monotonic()
        time.sleep(0.01)
        return measured


class Wheels(esair.Actuator[float]):
    """Keeps how long ago was seen by what it is told."""

    safe = 0.0
    blocking = False

    def __init__(self, brake: Brake) -> None:
        super().__init__(name="wheels")
        self.brake = brake
        self.ages: list[float] = []

    def write(self, command: float) -> None:
        if command:
            self.ages.append(time.monotonic() - self.brake.seen)


class Brake(esair.Reaction):
    """Lets pass what it is asked for, while it sees."""

    sonar = esair.reads(float)
    wheels = esair.guards(float)
    seen = 0.0

    def react(self, sonar: float, wheels: float) -> float:
        self.seen = sonar
        return wheels


class Plans(esair.Behavior):
    """Computes for longer than a reading is good, then moves."""

    wheels = esair.writes(float)
    sonar = esair.reads(float)

    def __init__(self) -> None:
        super().__init__()
        self.done = asyncio.Event()

    async def run(self) -> None:
        for _ in range(5):
            await asyncio.sleep(0.11)
            time.sleep(0.3)  # noqa: ASYNC251 - that is the point
            await self.wheels.write(1.0)
            try:
                seen = await self.sonar.read()
            except esair.StaleReadingError:
                seen = time.monotonic()
            assert time.monotonic() - seen < 0.29
        self.done.set()


class Insists(esair.Behavior):
    """Asks to move all the time."""

    wheels = esair.writes(float)

    async def run(self) -> None:
        async for _ in esair.every(0.004):
            await self.wheels.write(1.0)


@pytest.mark.promise("PRO-9", "SC-3", "TURN-4")
@pytest.mark.parametrize("make", LOOPS.values(), ids=LOOPS)
def test_who_has_computed_does_not_move_on_an_old_reading(make: Make) -> None:
    """The clock stands still in a turn, so the await gives way to a new one first."""
    brake, plans = Brake(), Plans()
    wheels = Wheels(brake)

    async def main() -> None:
        if turn_of(asyncio.get_running_loop()).virtual:
            pytest.skip("there a computation takes no time")
        robot = esair.Robot(
            resources=[Sonar(), wheels],
            behaviors=[plans, brake],
            stall_warning=None,
        )
        async with robot:
            async with asyncio.timeout(20.0):
                await plans.done.wait()

    run(make, main())
    assert all(age < 0.29 for age in wheels.ages), wheels.ages


@pytest.mark.promise("PRO-9", "SC-4", "TURN-1")
def test_what_a_thread_brought_meanwhile_is_as_old_as_it_is() -> None:
    """It ends its read while the loop is held up; what was seen then is no news."""
    brake = Brake()
    wheels = Wheels(brake)

    async def main() -> None:
        robot = esair.Robot(
            resources=[SlowSonar(name="sonar"), wheels],
            behaviors=[Insists(), brake],
            stall_warning=None,
        )
        async with robot:
            for number in range(12):
                await asyncio.sleep(0.1 + 0.005 * number)  # amid some of its reads
                time.sleep(0.3)  # noqa: ASYNC251 - that is the point

    with asyncio.Runner(loop_factory=esair.new_event_loop) as runner:
        runner.run(main())
    assert wheels.ages
    assert all(age < 0.29 for age in wheels.ages), max(wheels.ages)


@pytest.mark.promise("SC-4")
def test_what_a_stream_brought_meanwhile_is_as_old_as_it_is() -> None:
    """The thread of a plain stream is no other."""
    seen: list[Any] = []

    class Pushes(esair.Sensor[float]):
        def stream(self) -> Any:
            while True:
                time.sleep(0.02)
                yield time.monotonic()

    class Looks(esair.Behavior):
        pushes = esair.reads(float)

        async def run(self) -> None:
            while True:
                reading = await self.pushes.reading(fresh=True)
                seen.append(reading.time - reading.value)

    async def main() -> None:
        robot = esair.Robot(
            resources=[Pushes(), FakeActuator("wheels", safe=0.0)],
            behaviors=[Looks()],
            stall_warning=None,
        )
        async with robot:
            for _ in range(4):
                await asyncio.sleep(0.1)
                time.sleep(0.3)  # noqa: ASYNC251 - that is the point
            async with asyncio.timeout(10.0):
                while len(seen) <= 4:  # noqa: ASYNC110 - the computer may be busy
                    await asyncio.sleep(0.02)

    with asyncio.Runner(loop_factory=esair.new_event_loop) as runner:
        runner.run(main())
    assert len(seen) > 4
    assert max(seen) < 0.1
