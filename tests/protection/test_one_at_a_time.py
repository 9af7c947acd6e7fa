"""A driver is in one call at a time, whoever wants something of it meanwhile."""

from __future__ import annotations

import asyncio
import random
from typing import Any

import pytest

import esair
from esair.testing import FakeActuator, FakeSensor

pytestmark = pytest.mark.virtual_clock


OPENED = 7.0
"""Stands in what has landed where the device was opened."""


class Counts(FakeActuator[float]):
    """Counts how many of its calls are alive at once; some of them wait."""

    def __init__(self, *waits: float, during: Any = None, **options: Any) -> None:
        super().__init__("wheels", safe=0.0, command_timeout=0.3, **options)
        self.waits = waits
        self.during = during
        self.alive = self.most = 0
        self.landed: list[float] = []

    async def open(self) -> None:
        await super().open()
        self.landed.append(OPENED)

    async def write(self, command: float) -> None:
        self.alive += 1
        self.most = max(self.most, self.alive)
        try:
            if self.during is not None and command:
                self.during()
            for seconds in self.waits:
                await asyncio.sleep(seconds)
            self.landed.append(command)
        finally:
            self.alive -= 1


class Drive(esair.Behavior):
    """Writes whatever comes, at any time."""

    wheels = esair.writes(float)

    def __init__(self, seed: int = 0, name: str = "drive") -> None:
        super().__init__(name=name)
        self.chance = random.Random(seed)

    async def run(self) -> None:
        while True:
            await asyncio.sleep(self.chance.uniform(0.0, 0.06))
            speed = self.chance.choice([0.0, 0.0, self.chance.uniform(0.1, 1.0)])
            try:
                await self.wheels.write(speed)
            except esair.EsairError:
                await asyncio.sleep(0.01)


class Stop(esair.Reaction):
    """Keeps the wheels safe while it cannot see."""

    sonar = esair.reads(float, max_age=0.11)
    wheels = esair.writes(float, priority=3)

    def react(self, sonar: float) -> float | None:
        return 0.0 if sonar < 0.2 else None


@pytest.mark.promise("CALL-1", "AC-4", "RES-2")
@pytest.mark.parametrize("waits", [(), (0.0,), (0.013,), (0.047, 0.005)], ids=str)
@pytest.mark.parametrize("seed", range(6))
async def test_calls_of_a_driver_never_overlap(
    waits: tuple[float, ...], seed: int
) -> None:
    """Motions, safe commands past a blind hold, a halt, a loss: one after the other."""
    wheels, chance = Counts(*waits), random.Random(seed)
    sonar = FakeSensor("sonar", 1.0)
    drives = [Drive(seed), Drive(seed + 100, "other")]
    async with esair.Robot(
        resources=[sonar, wheels], behaviors=[*drives, Stop()]
    ) as robot:
        for _ in range(80):
            await asyncio.sleep(chance.uniform(0.001, 0.25))
            if chance.random() < 0.1:
                await robot.halt("enough")
                robot.resume()
            chance.choice([sonar.silence, sonar.speak])()
            if chance.random() < 0.15:
                wheels.unplug()
                await asyncio.sleep(chance.choice([0.0, chance.uniform(0.0, 0.1)]))
                wheels.plug()
            sonar.feed(chance.uniform(0.0, 3.0))
    assert wheels.most == 1
    assert sum(map(bool, wheels.landed)) > 20
    assert wheels.landed[-1] == 0.0
    begun = [place for place, what in enumerate(wheels.landed) if what == OPENED]
    assert len(begun) > 3
    for place in begun:  # it is safe before it moves
        after = [what for what in wheels.landed[place:] if what != OPENED]
        assert after[0] == 0.0


@pytest.mark.promise("CALL-1", "AC-4")
@pytest.mark.parametrize("waits", [(), (0.02,)], ids=str)
async def test_a_driver_that_halts_the_robot_is_told_so_afterwards(
    waits: tuple[float, ...],
) -> None:
    """What it was told last is to be safe, and its own call is over before that."""
    wheels, sonar, drive = Counts(*waits), FakeSensor("sonar", 1.0), Drive()
    async with esair.Robot(resources=[sonar, wheels], behaviors=[drive]) as robot:
        wheels.during = lambda: robot.halt("its driver has seen enough")
        await asyncio.sleep(1.0)
        assert wheels.most == 1
        assert any(wheels.landed)
        assert wheels.landed[-1] == 0.0


@pytest.mark.promise("CALL-1", "AC-4")
@pytest.mark.parametrize("waits", [(), (0.02,)], ids=str)
async def test_a_driver_that_brings_news_is_not_called_from_within(
    waits: tuple[float, ...],
) -> None:
    """A reaction to what it says amid a call has its turn after that call."""
    wheels, sonar, drive = Counts(*waits), FakeSensor("sonar", 1.0), Drive()
    parts: list[Any] = [sonar, wheels]
    async with esair.Robot(resources=parts, behaviors=[drive, Stop()]):
        await asyncio.sleep(0.1)
        wheels.landed.clear()
        wheels.during = lambda: sonar.feed(0.05)
        await asyncio.sleep(0.5)
        assert wheels.most == 1
        moved = next(place for place, speed in enumerate(wheels.landed) if speed)
        assert wheels.landed[moved + 1 :]
        assert not any(wheels.landed[moved + 1 :])


class Stubborn(Counts):
    """Goes on with a motion for half a second, whoever cancels it."""

    async def write(self, command: float) -> None:
        if not command:
            await super().write(command)
            return
        until = asyncio.get_running_loop().time() + 0.53
        while (left := until - asyncio.get_running_loop().time()) > 1e-9:
            try:
                await asyncio.sleep(left)
            except asyncio.CancelledError:
                continue
        self.landed.append(command)


class Once(esair.Behavior):
    wheels = esair.writes(float)

    async def run(self) -> None:
        await self.wheels.write(0.4)


@pytest.mark.promise("CALL-2", "ROB-2")
@pytest.mark.parametrize("way", ["stop", "remove"])
async def test_what_waits_for_a_motion_goes_on_when_it_ends(way: str) -> None:
    """And no later: safe is sent once more, and that was it."""
    wheels = Stubborn()
    wheels.deadline = 0.2
    loop = asyncio.get_running_loop()
    async with esair.Robot(resources=[wheels], behaviors=[Once()]) as robot:
        await asyncio.sleep(0.11)
        begun = loop.time()
        if way == "remove":
            await robot.behaviors.remove("once")
            assert loop.time() - begun < 0.55
    assert loop.time() - begun < 0.55
    landed = [what for what in wheels.landed if what != OPENED]
    assert landed[-2:] == [0.4, 0.0]


class Wanders(esair.Behavior):
    """Drives on, as fast as its driver lets it."""

    wheels = esair.writes(float)

    async def run(self) -> None:
        while True:
            await self.wheels.write(1.0)
            await asyncio.sleep(0.001)


class Brakes(esair.Reaction):
    sonar = esair.reads(float)
    wheels = esair.writes(float, priority=20)

    def react(self, sonar: float) -> float | None:
        return 0.0 if sonar < 0.5 else None


@pytest.mark.promise("AC-2", "PRO-6")
@pytest.mark.parametrize("takes", [0.003, 0.021, 0.04, 0.057])
@pytest.mark.parametrize("rate", [19.0, 25.0, 50.0])
async def test_a_slew_lets_a_slow_driver_brake(takes: float, rate: float) -> None:
    """What was told is from when it was sent: as fast as declared, and no slower."""
    wheels = Counts(takes, slew=2.0)
    sonar = FakeSensor("sonar", 1.0, rate=rate)
    async with esair.Robot(
        resources=[sonar, wheels], behaviors=[Wanders(), Brakes()]
    ) as robot:
        await asyncio.sleep(1.3)
        assert wheels.landed[-1] == 1.0
        sonar.feed(0.2)
        await asyncio.sleep(0.3)
        assert wheels.landed[-1] > 0.2
        await asyncio.sleep(0.5)
        assert wheels.landed[-1] == 0.0
        assert robot.resources.query("wheels").state is esair.ResourceState.READY
