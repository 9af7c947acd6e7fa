"""How the end of the robot meets behaviors and commands."""

from __future__ import annotations

import asyncio
import contextlib
from typing import Any

import pytest
from tests.supervisors.actors import Idle, Scripted, for_ever, seeds

import esair

pytestmark = pytest.mark.virtual_clock


async def test_ended_waits_for_every_deliberative_behavior() -> None:
    """Two who wait for the end are both told."""

    async def run(behavior: Any) -> None:
        await asyncio.sleep(1.0)

    async with esair.Robot(behaviors=[Scripted(run), Idle(name="b")]) as robot:
        waiting = [asyncio.ensure_future(robot.ended()) for _ in range(2)]
        await asyncio.sleep(2.0)
        assert not any(each.done() for each in waiting)
        await robot.behaviors.remove("b")
        await asyncio.gather(*waiting)
        await robot.ended()


async def test_the_stop_ends_those_who_wait_for_the_end() -> None:
    """Nobody waits for behaviors of a robot that has stopped."""
    async with esair.Robot(behaviors=[Idle()]) as robot:
        waiting = asyncio.ensure_future(robot.ended())
        await asyncio.sleep(0.1)
    await waiting


@pytest.mark.fault("M20", "B11")
@pytest.mark.parametrize("verb", ["remove", "restart", "replace"])
async def test_a_stop_does_not_cut_short_a_clean_up(verb: str) -> None:
    """What a command has told to end has its grace, though the robot stops meanwhile."""
    ended: list[float] = []

    async def clean_up(_behavior: object) -> None:
        await asyncio.sleep(0.5)
        ended.append(loop.time())

    loop = asyncio.get_running_loop()
    behavior = Scripted(for_ever, teardown=clean_up, name="a")
    async with esair.Robot(behaviors=[behavior]) as robot:
        more = [Idle()] if verb == "replace" else []
        command = asyncio.ensure_future(getattr(robot.behaviors, verb)("a", *more))
        await asyncio.sleep(0.1)
    if verb == "restart":
        with pytest.raises(esair.EsairError):
            await command
    else:
        assert await command == []
    assert ended == [0.5]
    assert loop.time() == 0.5


class Lingers(esair.Actuator[float]):
    """Has a motion 1.5 s after it was told to, whatever is cancelled."""

    safe = 0.0
    deadline = 0.3

    def __init__(self, told: list[float]) -> None:
        super().__init__(name="wheels")
        self.told = told

    async def write(self, command: float) -> None:
        loop = asyncio.get_running_loop()
        until = loop.time() + (1.5 if command else 0.0)
        while loop.time() < until:
            with contextlib.suppress(asyncio.CancelledError):
                await asyncio.sleep(until - loop.time())
        self.told.append(command)


class Pushes(esair.Behavior):
    wheels = esair.writes(float)

    async def run(self) -> None:
        await self.wheels.write(0.5)
        await asyncio.sleep(3600.0)


@pytest.mark.promise("CALL-2", "AC-4")
async def test_a_stop_makes_safe_what_was_being_replaced() -> None:
    """A write that outlives the replacement is not the last thing on the wire."""
    told: list[float] = []
    async with esair.Robot(resources=[Lingers(told)], behaviors=[Pushes()]) as robot:
        await asyncio.sleep(0.05)
        replacing = robot.resources.replace("wheels", Lingers([]))
        command = asyncio.ensure_future(replacing)
        await asyncio.sleep(0.05)
    with pytest.raises(esair.StoppingError):
        await command
    await asyncio.sleep(2.0)
    assert told[-2:] == [0.5, 0.0]


@pytest.mark.fault("M20", "B14")
async def test_a_stop_waits_for_a_thread_that_was_told_to_end() -> None:
    """It ends at its next call, which is soon: that is no zombie."""
    loop: Any = asyncio.get_running_loop()

    class Looks(esair.ThreadBehavior):
        def run(self) -> None:
            loop.wait_in_thread(0.3)
            self.receive()

    async with esair.Robot(behaviors=[Looks()]) as robot:
        await asyncio.sleep(0.1)
        command = asyncio.ensure_future(robot.behaviors.remove("looks"))
        await asyncio.sleep(0.1)
    assert await command == []
    assert robot.behaviors.zombies == ()
    assert loop.time() == pytest.approx(0.3)


@pytest.mark.fault("M20")
@pytest.mark.parametrize("seed", seeds)
async def test_a_stop_in_the_middle_of_commands_leaves_nothing(seed: int) -> None:
    """A removal goes on to its end; what would begin ends with StoppingError."""

    async def slow(_behavior: object) -> None:
        await asyncio.sleep(0.5)

    async with esair.Robot(behaviors=[Scripted(for_ever, teardown=slow)]) as robot:
        removing = asyncio.ensure_future(robot.behaviors.remove("scripted"))
        commands = [
            asyncio.ensure_future(
                robot.behaviors.add(Scripted(for_ever, setup=slow, name="b"))
            ),
            asyncio.ensure_future(robot.behaviors.add(Idle(name="scripted"))),
        ]
        await asyncio.sleep(0.1)
    assert await removing == []
    for command in commands:
        with pytest.raises(esair.StoppingError):
            await command
    with pytest.raises(esair.StoppingError):
        await robot.behaviors.add(Idle(name="late"))


class Eye(esair.Sensor[float]):
    """Closes without a wait."""

    async def read(self) -> float:
        return 1.0


@pytest.mark.fault("M20")
@pytest.mark.promise("ROB-2", "SUP-2")
@pytest.mark.parametrize("passes", range(4))
async def test_a_removal_of_just_then_does_not_end_the_stop(
    passes: int, caplog: pytest.LogCaptureFixture
) -> None:
    """The stop has seen it, and it has gone before the stop comes to it."""

    async def remove() -> None:
        for _ in range(passes):
            await asyncio.sleep(0)
        await robot.resources.remove("eye")

    async with esair.Robot(resources=[Eye(name="eye")]) as robot:
        removing = asyncio.create_task(remove())
    await asyncio.gather(removing, return_exceptions=True)
    assert "met an error" not in caplog.text
    assert robot.resources.names() == []


@pytest.mark.promise("ROB-2")
async def test_a_device_that_came_back_unnoticed_is_made_safe(fake_actuator):
    """The stop tries an actuator that is lost once more, for its safe command."""
    wheels = fake_actuator("wheels", safe=0.0)

    class Drive(esair.Behavior):
        wheels = esair.writes(float)

        async def run(self):
            await self.wheels.write(1.0)
            await asyncio.Event().wait()

    async with esair.Robot(resources=[wheels], behaviors=[Drive()]) as robot:
        await wheels.until(1.0)
        wheels.unplug()
        await asyncio.sleep(3.0)
        wheels.report_arrived = lambda: None  # nobody hears of it
        wheels.plug()

    assert wheels.commands[-1] == 0.0
    assert robot.stopped[0].safe
    assert robot.stopped[0].answered


@pytest.mark.promise("ROB-2")
async def test_a_device_that_stays_away_is_reported(fake_actuator):
    """An actuator that could not be told its safe command is not called safe."""
    wheels = fake_actuator("wheels", safe=0.0)

    async with esair.Robot(resources=[wheels]) as robot:
        wheels.unplug()

    assert not robot.stopped[0].answered
    assert "unplugged" in robot.stopped[0].error
