"""A child is a function of its messages: the virtual clock and a replay know no difference."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest
from tests.placement.actors import Deaf
from tests.placement.parts import Avoid, Drive, ThreadDrive, Twist, Wanderer

import esair
from esair.testing import FakeActuator, FakeSensor

pytestmark = [pytest.mark.virtual_clock, pytest.mark.xdist_group("placement")]

STOP = Twist(0.0, 0.0)


async def told(where: Any, seed: int) -> list[Any]:
    """What the wheels were told in a world with everything in it, and when."""
    loop = asyncio.get_running_loop()
    wheels, sonar = FakeActuator("wheels", safe=STOP), FakeSensor("sonar", 1.0)
    commands: list[Any] = []
    parts: list[Any] = [Avoid(), Wanderer(name="wander")]
    for each in parts:
        each.placement = where
    robot = esair.Robot(resources=[wheels, sonar], behaviors=parts, seed=seed)
    await asyncio.sleep(10.0 - loop.time() % 10.0)  # all periods lie on one grid
    begin = loop.time()
    robot.journal.listen(
        lambda event: (
            commands.append((round(event.time - begin, 3), event.value))
            if event.kind.value == "sent"
            else None
        )
    )
    async with robot:
        await asyncio.sleep(0.0113)  # the start of a process takes turns, and no time
        for step in range(20):
            sonar.feed(0.2 if (step * 7 + seed) % 5 == 0 else 1.0)
            await asyncio.sleep(0.037)
    return commands


@pytest.mark.long
@pytest.mark.promise("PLC-7")
@pytest.mark.parametrize("seed", [1, 5])
async def test_the_same_commands_as_a_task(seed: int) -> None:
    """On the virtual clock the wheels hear the same at the same moments, wherever it runs."""
    here = await told(None, seed)
    there = await told("process", seed)
    assert here == there
    assert len(here) > 20


@pytest.mark.promise("PLC-7")
@pytest.mark.parametrize(
    "seed",
    [
        *(pytest.param(seed, marks=pytest.mark.long) for seed in range(6, 26)),
        *(pytest.param(seed, marks=pytest.mark.soak) for seed in range(26, 106)),
    ],
)
async def test_the_same_commands_in_many_worlds(seed: int) -> None:
    """The same in a hundred worlds."""
    assert await told(None, seed) == await told("process", seed)


@pytest.mark.long
@pytest.mark.promise("PLC-7", "PLC-3")
@pytest.mark.parametrize("kind", [Drive, ThreadDrive])
async def test_time_stands_still_while_a_child_works(kind: type[Any]) -> None:
    """An hour of a behavior that ticks in a child takes seconds."""
    loop = asyncio.get_running_loop()
    wheels = FakeActuator("wheels", safe=STOP)
    drive = kind(name="drive")
    async with esair.Robot(resources=[wheels], behaviors=[drive]):
        begin = loop.time()
        await wheels.until(Twist(0.3, 0.0), timeout=1.0)
        first = len(wheels.commands)
        await asyncio.sleep(2.0)
        assert loop.time() - begin < 2.1
        assert 195 <= len(wheels.commands) - first <= 205


@pytest.mark.promise("PLC-3", "PLC-7")
async def test_a_crash_comes_at_the_same_moment() -> None:
    """A child that dies in its third step dies there on the virtual clock, too."""
    wheels = FakeActuator("wheels", safe=STOP)
    drive = Drive(fault="exit", at=20)
    async with esair.Robot(resources=[wheels], behaviors=[drive]) as robot:
        await asyncio.sleep(0.25)
        assert robot.behaviors.query("drive").restarts == 1
        assert isinstance(robot.behaviors.query("drive").error, esair.ProcessDiedError)


@pytest.mark.long
@pytest.mark.promise("PLC-3")
@pytest.mark.parametrize("fault", ["hang", "stop", "talk"])
async def test_a_hang_is_seen_on_the_virtual_clock(fault: str) -> None:
    """No virtual time passes while it hangs: real time counts for that alone."""
    wheels = FakeActuator("wheels", safe=STOP)
    drive = Drive(fault=fault, at=5)
    drive.placement = esair.Placement(stall=0.5)  # type: ignore[assignment]
    async with esair.Robot(resources=[wheels], behaviors=[drive]) as robot:
        await asyncio.sleep(0.1)
        assert robot.behaviors.query("drive").restarts == 1
        told = str(robot.behaviors.query("drive").error)
        assert "hung for 0.5 s" in told
        assert fault == "stop" or "misbehave" in told


@pytest.mark.promise("PLC-3", "PLC-4")
async def test_a_deaf_driver_ends_with_its_process() -> None:
    """Nothing waits for its answer any more: it is removed, its call is over."""
    eye = Deaf(name="eye")
    eye.placement = "process"
    eye.deadline = 0.5
    async with esair.Robot(resources=[eye]) as robot:
        await asyncio.sleep(1.0)
        await robot.resources.remove("eye")
        await asyncio.sleep(1.0)
        assert not robot.resources.abandoned()
