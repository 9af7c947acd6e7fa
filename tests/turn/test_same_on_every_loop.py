"""A turn means the same on every loop; a robot works on each of them."""

from __future__ import annotations

import asyncio
import threading
import time
from typing import Any

import pytest
from tests.turn.loops import LOOPS, Make, run
from tests.turn.passes import meanings

import esair
from esair.loop import turn_of
from esair.testing import FakeActuator, FakeSensor

pytestmark = [pytest.mark.real_clock, pytest.mark.promise("TURN-7")]

FOREIGN = pytest.mark.parametrize(
    "make", [LOOPS["asyncio"], LOOPS["uvloop"]], ids=["asyncio", "uvloop"]
)


def test_turns_are_counted_alike_on_every_loop() -> None:
    """From a reading to its command, from a loss to LOST; and one order of a moment."""
    seen = meanings()
    assert set(seen) == {"asyncio", "esair.run", "virtual", "uvloop"}
    assert len({repr(each) for each in seen.values()}) == 1, seen
    one = seen["esair.run"]
    assert one.to_command == [1, 1, 1]
    assert one.to_lost == 1
    assert not one.at_once
    assert one.order == ["due", "deadline", "stale", "dead man"]


def test_new_event_loop_is_the_loop_of_run() -> None:
    """Who brings a loop of their own can have the one whose recordings are exact."""

    async def main() -> bool:
        return turn_of(asyncio.get_running_loop()).repeats

    assert run(esair.new_event_loop, main())
    assert not run(LOOPS["asyncio"], main())


class Beat(esair.Reaction):
    rate = 50.0
    sonar = esair.reads(float)
    wheels = esair.writes(float, priority=1)

    def __init__(self) -> None:
        super().__init__()
        self.steps = 0

    def react(self, sonar: float) -> float | None:
        self.steps += 1
        return 0.1 if sonar > 0.5 else None


class Uses(esair.Behavior):
    sonar = esair.reads(float)
    wheels = esair.writes(float)


class Thread(esair.ThreadBehavior):
    sonar = esair.reads(float)

    def __init__(self) -> None:
        super().__init__()
        self.seen: list[float] = []
        self.times: list[float] = []

    def run(self) -> None:
        for _ in esair.every(0.01):
            self.seen.append(self.sonar.read())
            self.times.append(esair.now())


class Blocking(esair.Sensor[float]):
    """A driver that blocks."""

    value_type = float
    rate = 50.0

    def read(self) -> float:
        time.sleep(0.002)
        return 2.0


@FOREIGN
def test_sensors_reactions_and_threads(make: Make) -> None:
    """Polls go out, steps are taken, blocking code runs beside them."""

    async def main() -> None:
        sonar, wheels = (
            FakeSensor("sonar", 1.0, rate=50.0),
            FakeActuator("wheels", safe=0.0),
        )
        beat, thread, slow = Beat(), Thread(), Blocking(name="slow")
        uses = Uses()
        async with esair.Robot(
            resources=[sonar, wheels, slow], behaviors=[beat, thread, uses]
        ) as robot:
            await asyncio.sleep(0.4)
            right = await robot.resources.register("user", "slow", esair.Access.READ)
            assert await robot.sensors.port(right).read() == 2.0
            assert await uses.sonar.read(fresh=True) == 1.0
            assert isinstance(await uses.wheels.write(0.3), esair.Refused)
        assert beat.steps >= 10
        assert len(thread.seen) >= 10
        assert thread.times == sorted(thread.times)
        assert wheels.commands[-1] == 0.0
        assert 0.1 in wheels.commands

    run(make, main())


@FOREIGN
def test_a_dead_man_a_deadline_and_a_stuck_driver(make: Make) -> None:
    """What has not come is seen in time."""

    async def main() -> None:
        wheels = FakeActuator("wheels", safe=0.0, command_timeout=0.1)
        sonar, uses = FakeSensor("sonar", 1.0), Uses()
        sonar.deadline = 0.1
        async with esair.Robot(resources=[wheels, sonar], behaviors=[uses]) as robot:
            began = time.monotonic()
            await uses.wheels.write(0.5)
            await wheels.until(0.0, timeout=5.0)
            assert 0.09 < time.monotonic() - began < 2.0
            sonar.slow(5.0)
            with pytest.raises(esair.EsairError):
                await uses.sonar.read(fresh=True)
            with pytest.raises(TimeoutError):
                await uses.receive(timeout=0.05)
            assert robot.journal.counts()["wheels"]["timeouts"] == 1

    run(make, main())


@FOREIGN
def test_losses_commands_of_the_user_and_halts(make: Make) -> None:
    """What comes from threads and from the user takes effect."""

    async def main() -> None:
        wheels, sonar, uses = (
            FakeActuator("wheels", safe=0.0),
            FakeSensor("sonar", 1.0, rate=50.0),
            Uses(),
        )
        async with esair.Robot(resources=[wheels, sonar], behaviors=[uses]) as robot:
            thread = threading.Thread(target=wheels.unplug)
            thread.start()
            await asyncio.to_thread(thread.join)
            await until_state(robot, esair.ResourceState.LOST)
            wheels.plug()
            await until_state(robot, esair.ResourceState.READY)

            await robot.behaviors.add(beat := Beat())
            await asyncio.sleep(0.2)
            assert beat.steps
            await robot.behaviors.remove("beat")
            await robot.resources.replace("sonar", FakeSensor("sonar", 0.2))

            halting = await asyncio.to_thread(robot.halt, "enough")
            assert [each.safe for each in await halting] == [True]
            assert isinstance(await uses.wheels.write(0.4), esair.Refused)
            robot.resume()
            assert isinstance(await uses.wheels.write(0.4), esair.Written)

    run(make, main())


async def until_state(robot: Any, state: esair.ResourceState) -> None:
    for _ in range(500):
        if robot.resources.query("wheels").state is state:
            return
        await asyncio.sleep(0.01)
    raise AssertionError(f"it is not {state}")
