"""Stories of a driver that answers late: at the stop safe is last, or it is told."""

from __future__ import annotations

import asyncio
import contextlib
import random
from typing import Any

import pytest

import esair
from esair.testing import FakeActuator

pytestmark = pytest.mark.virtual_clock


def now() -> float:
    return asyncio.get_running_loop().time()


class Late(esair.Actuator[float]):
    """Some of its calls take up to two seconds, whoever cancels them."""

    safe = 0.0

    def __init__(self, name: str, dice: random.Random, landed: list[float]) -> None:
        super().__init__(name=name)
        self.dice, self.landed = dice, landed
        self.is_there = True
        self.lateness = dice.choice([0.1, 0.3, 0.6, 1.0])
        self.when = dice.choice(["first", "last"])
        self.deadline = dice.choice([0.1, 0.25, 1.0])

    async def late(self, chance: float) -> None:
        until = now() + self.dice.uniform(0.2, 2.0)
        while self.dice.random() < chance and (left := until - now()) > 1e-9:
            chance = 1.0
            with contextlib.suppress(asyncio.CancelledError):
                await asyncio.sleep(left)

    async def open(self) -> None:
        await self.late(0.1)
        if not self.is_there:
            raise ConnectionError("unplugged")

    async def close(self) -> None:
        await self.late(0.1)

    async def write(self, command: float) -> None:
        if self.when == "last":
            await self.late(self.lateness)
        if not self.is_there:
            raise ConnectionError("unplugged")
        self.landed.append(command)
        if self.when == "first":
            await self.late(self.lateness)

    def plug(self, is_there: bool) -> None:
        self.is_there = is_there
        (self.report_arrived if is_there else self.report_lost)()


class Drives(esair.Behavior):
    """Writes to both of them, now and then with little patience."""

    one, two = esair.writes(float), esair.writes(float)

    def __init__(self, dice: random.Random) -> None:
        super().__init__()
        self.dice = dice

    async def run(self) -> None:
        while True:
            with contextlib.suppress(esair.EsairError, TimeoutError):
                async with asyncio.timeout(self.dice.choice([0.05, 0.3, 5.0])):
                    port = self.dice.choice([self.one, self.two])
                    await port.write(float(self.dice.randint(1, 9)))
            await asyncio.sleep(self.dice.choice([0.0, 0.01, 0.1, 0.4]))


async def something_happens(
    robot: esair.Robot, wheels: dict[str, Late], dice: random.Random
) -> None:
    name = dice.choice([*wheels])
    act = dice.choice(["lost", "back", "lost", "back", "halt", "replace", "nothing"])
    if act in {"lost", "back"}:
        wheels[name].plug(act == "back")
    elif act == "halt":
        robot.halt("to be safe")
        robot.resume()
    elif act == "replace" and dice.random() < 0.3:
        new = Late(name, dice, wheels[name].landed)
        with contextlib.suppress(esair.EsairError):
            await robot.resources.replace(name, new)
            wheels[name] = new


async def story(seed: int) -> list[Any]:
    """Return of which actuators the stop has said what is not so."""
    dice = random.Random(seed)
    landed: dict[str, list[float]] = {"one": [], "two": []}
    wheels = {name: Late(name, dice, landed[name]) for name in landed}
    drives = Drives(random.Random(seed))
    async with esair.Robot(
        resources=[*wheels.values()],
        behaviors=[drives],
        grace=dice.choice([0.1, 0.3, 1.0]),
    ) as robot:
        end = now() + dice.uniform(0.3, 4.0)
        while now() < end:
            await asyncio.sleep(dice.uniform(0.01, 0.6))
            await something_happens(robot, wheels, dice)
    answered = {told.resource for told in robot.stopped if told.safe and told.answered}
    wrong: list[Any] = []
    for when in ("at the stop", "in the end"):
        wrong += [
            (seed, when, name, commands[-1])
            for name, commands in landed.items()
            if name in answered and commands[-1] != 0.0
        ]
        await asyncio.sleep(5.0)
    return wrong


@pytest.mark.longer
@pytest.mark.promise("AC-4", "CALL-2", "ROB-2")
async def test_safe_is_last_or_it_is_told_that_it_may_not_be(
    request: pytest.FixtureRequest,
) -> None:
    """Losses, returns, halts and replacements amid late calls, and a stop amid it."""
    stories = 500 if request.config.getoption("--esair-long") else 25
    assert [wrong for seed in range(stories) for wrong in await story(seed)] == []


@pytest.mark.promise("CALL-1", "CALL-3", "RES-4")
async def test_no_command_goes_beside_a_question_that_does_not_end() -> None:
    """A device that is asked for its set-up, and answers too late, is busy until then."""

    class Deaf(FakeActuator[float]):
        set_up_period = 0.5
        deadline = 0.1
        asks = False

        async def is_set_up(self) -> bool:
            self.asks = True
            until = esair.now() + 0.6
            while (left := until - esair.now()) > 0:
                with contextlib.suppress(asyncio.CancelledError):
                    await asyncio.sleep(left)
            self.asks = False
            return True

    arm = Deaf("arm", safe=0.0)
    user: Any = esair.Behavior(name="user", writes={"arm": esair.writes(float)})
    async with esair.Robot(resources=[arm], behaviors=[user]):
        await asyncio.sleep(0.65)
        assert arm.asks
        with pytest.raises(esair.DeviceLostError, match=r"is_set_up.* does not end"):
            await user.arm.write(1.0)
        await asyncio.sleep(2.0)
    assert 1.0 not in arm.commands
