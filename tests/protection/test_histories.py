"""Random histories: whatever is taken away and put back, nothing slips through."""

from __future__ import annotations

import asyncio
import random
from typing import Any

import pytest

import esair
from esair.testing import FakeSensor

pytestmark = pytest.mark.virtual_clock

HISTORIES, LONG, SOAK = 10, 40, 1_000
STEPS = 25


class Truth:
    """Who could see when; kept beside the robot, by what happens to its parts."""

    def __init__(self) -> None:
        self.moment = 0
        self.dark = 1
        self.seen = 0
        self.slipped: list[str] = []
        self.moved = 0

    def blind(self, why: str) -> None:
        """From now on nobody sees, until the next decision."""
        self.moment += 1
        self.dark = self.moment
        self.why = why

    def sees(self) -> None:
        """The protection has decided on a reading."""
        self.moment += 1
        self.seen = self.moment

    def told(self, command: float) -> None:
        """The device was told something."""
        if command == 0.0:
            return
        self.moved += 1
        if self.dark > self.seen:
            self.slipped.append(f"{command} after {self.why}")


class Wheels(esair.Actuator[float]):
    """Asks the truth at each command."""

    safe = 0.0
    command_timeout = 0.1

    def __init__(self, truth: Truth) -> None:
        super().__init__(name="wheels")
        self.truth = truth

    async def write(self, command: float) -> None:
        self.truth.told(command)
        if self.truth.moment % 3 == 0:
            await asyncio.sleep(0.002)


class Seeing(esair.Reaction):
    """What both kinds of protection share."""

    restart = esair.Restart(max=100_000, within=0.5, delay=0.01, max_delay=0.02)

    def __init__(self, truth: Truth) -> None:
        super().__init__(name="stop")
        self.truth = truth
        self.bug = False

    def decide(self, command: float | None) -> float | None:
        if self.bug:
            self.bug = False
            self.truth.blind("a crash")
            raise RuntimeError("a bug")
        self.truth.sees()
        return command


class Stop(Seeing):
    """A reaction above the behaviors."""

    sonar = esair.reads(float, max_age=0.3)
    wheels = esair.writes(float, priority=100)

    def react(self, sonar: float) -> float | None:
        return self.decide(0.0 if sonar < 0.4 else None)


class Guard(Seeing):
    """A guard."""

    sonar = esair.reads(float, max_age=0.3)
    wheels = esair.guards(float)

    def react(self, sonar: float, wheels: float) -> float | None:
        return self.decide(None if sonar < 0.4 else wheels)


class Drive(esair.Behavior):
    """Writes as often as it can, whatever the answers are."""

    wheels = esair.writes(float)
    restart = esair.Restart(max=100_000, within=0.5, delay=0.005, max_delay=0.01)

    async def run(self) -> None:
        async for _ in esair.every(0.003):
            try:
                await self.wheels.write(0.5)
            except esair.DeviceLostError:
                continue


async def history(seed: int, kind: type[Seeing]) -> Truth:
    """Do things in random order with a robot that drives; return the truth."""
    dice = random.Random(seed)
    truth = Truth()
    sonar: Any = FakeSensor("sonar", 2.0, type=float, rate=100.0)
    stop = kind(truth)
    robot = esair.Robot(
        resources=[Wheels(truth), sonar], behaviors=[Drive(), stop], grace=0.1
    )
    truth.blind("the start")
    async with robot:
        await asyncio.sleep(0.05)
        for _ in range(STEPS):
            match dice.randrange(7):
                case 0:
                    await robot.resources.remove("wheels")
                    truth.blind("the removal of the wheels")
                    await asyncio.sleep(dice.choice([0.0, 0.02]))
                    await robot.resources.add(Wheels(truth))
                case 1:
                    stop = kind(truth)
                    await robot.behaviors.replace("stop", stop)
                case 2:
                    stop.bug = True
                case 3:
                    truth.blind("the loss of the sonar")
                    sonar.unplug()
                    await asyncio.sleep(dice.choice([0.0, 0.02, 0.3]))
                    sonar.plug()
                case 4:
                    await robot.resources.remove("sonar")
                    truth.blind("the removal of the sonar")
                    await asyncio.sleep(dice.choice([0.0, 0.02]))
                    sonar = FakeSensor("sonar", 2.0, type=float, rate=100.0)
                    await robot.resources.add(sonar)
                case 5:
                    await robot.resources.replace("wheels", Wheels(truth))
                case _:
                    pass
            await asyncio.sleep(dice.choice([0.0, 0.001, 0.02, 0.1]))
        await asyncio.sleep(1.0)
        moved = truth.moved
        await asyncio.sleep(0.2)
        assert truth.moved > moved  # it drives on when all is well again
    return truth


@pytest.mark.long
@pytest.mark.promise("PRO-2")
@pytest.mark.parametrize("kind", [Stop, Guard])
async def test_not_one_command_slips_through(
    kind: type[Seeing], request: pytest.FixtureRequest
) -> None:
    """Taken away and added, lost, replaced, crashed: no motion without a decision."""
    option = request.config.getoption
    soak, long = option("--esair-soak"), option("--esair-long")
    for seed in range((SOAK if soak else LONG if long else HISTORIES) // 2):
        truth = await history(seed, kind)
        assert truth.slipped == [], f"history {seed}"
