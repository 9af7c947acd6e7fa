"""What was taken away is kept by nobody."""

from __future__ import annotations

import asyncio
import gc
import weakref
from typing import Any

import pytest

import esair
from esair.testing import FakeActuator, FakeSensor

pytestmark = pytest.mark.virtual_clock


class Avoid(esair.Reaction):
    """Shares the wheels with others, and sees what they see."""

    sonar = esair.reads(float)
    wheels = esair.writes(float)

    def react(self, sonar: float) -> float | None:
        return 0.0 if sonar < 0.5 else None


class Clear(esair.Reaction):
    """Guards the wheels."""

    sonar = esair.reads(float)
    wheels = esair.guards(float)

    def react(self, sonar: float, wheels: float) -> float | None:
        return wheels


class Drive(esair.Behavior):
    """Writes now and then."""

    wheels = esair.writes(float)

    async def run(self) -> None:
        async for _ in esair.every(0.05):
            await self.wheels.write(0.5)


@pytest.mark.promise("RS-3", "BS-5")
@pytest.mark.parametrize("kind", [Avoid, Clear, Drive])
async def test_who_was_removed_is_forgotten(kind: type[Any]) -> None:
    """Nobody waits for what it saw, and its rights are gone."""
    sonar, wheels = FakeSensor("sonar", 1.0), FakeActuator("wheels", safe=0.0)
    async with esair.Robot(
        resources=[sonar, wheels], behaviors=[Avoid(name="stays")]
    ) as robot:
        await robot.behaviors.add(kind(name="goes"))
        known = weakref.ref(robot.behaviors.action("goes"))
        await asyncio.sleep(0.2)
        await robot.behaviors.remove("goes")
        await asyncio.sleep(0.2)
        gc.collect()
        assert known() is None


@pytest.mark.promise("RS-3")
async def test_a_right_to_what_was_removed_is_kept_no_longer_than_the_next() -> None:
    """However often a device goes and comes, a behavior has one right to it."""
    drive = Drive()
    async with esair.Robot(
        resources=[FakeActuator("wheels", safe=0.0)], behaviors=[drive]
    ) as robot:
        for _ in range(5):
            await robot.resources.add(FakeSensor("sonar", 1.0))
            await drive.register("sonar", esair.Access.READ)
            await robot.resources.remove("sonar")
        rights = list(robot._behaviors.members["drive"].uses())
        assert [each.resource for each in rights].count("sonar") <= 1


class Lidar(esair.Sensor[float]):
    """Takes 4 ms for each reading."""

    rate = 50.0

    async def read(self) -> float:
        await asyncio.sleep(0.004)
        return 1.0


class Wheels(esair.Actuator[float]):
    """Writes down how long after a tick of 20 ms it is told something."""

    safe = 0.0

    def __init__(self) -> None:
        super().__init__()
        self.late: list[float] = []

    async def write(self, command: float) -> None:
        self.late.append(asyncio.get_running_loop().time() % 0.02)


class First(esair.Reaction):
    """Has the higher priority: who decides in the same turn waits for what it sees."""

    rate = 50.0
    lidar = esair.reads(float)
    wheels = esair.writes(float, priority=5)

    def react(self, lidar: float) -> float | None:
        return None


class Looks(esair.Reaction):
    """Has the lidar polled, and moves nothing."""

    rate = 50.0
    lidar = esair.reads(float)

    def react(self, lidar: float) -> None: ...


class Then(esair.Reaction):
    """Needs nothing that takes time."""

    rate = 50.0
    wheels = esair.writes(float)

    def react(self) -> float:
        return 0.5


@pytest.mark.promise("AC-1")
async def test_nobody_waits_for_what_one_sees_that_was_removed() -> None:
    """The others decide at once again."""
    wheels = Wheels()
    async with esair.Robot(
        resources=[Lidar(), wheels], behaviors=[First(name="first"), Then(), Looks()]
    ) as robot:
        await asyncio.sleep(0.5)
        assert 0.003 < wheels.late[-1] < 0.005
        await robot.behaviors.remove("first")
        await asyncio.sleep(0.5)
        assert min(wheels.late[-1], 0.02 - wheels.late[-1]) < 0.001
