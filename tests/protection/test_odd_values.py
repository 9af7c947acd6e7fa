"""Values, errors and streams of any class: what they do when looked at stays in."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from typing import Any

import pytest

import esair
from esair import BehaviorState
from esair.testing import FakeActuator, FakeSensor

pytestmark = pytest.mark.virtual_clock


class Ends:
    """Ends the program when its text is wanted."""

    def __init__(self, error: BaseException) -> None:
        self.error = error

    def __repr__(self) -> str:
        raise self.error


class Lies(float):
    """Is less than nothing, and more than nothing."""

    def __lt__(self, other: object) -> bool:
        return False

    __le__ = __gt__ = __ge__ = __lt__

    def __float__(self) -> float:
        return -7.0


class NamelessError(Exception):
    """Raises when it is asked for its class."""

    @property  # type: ignore[misc]
    def __class__(self) -> Any:  # type: ignore[override]
        raise RuntimeError("no class")


class Returns(esair.Reaction):
    sonar = esair.reads(float)
    wheels = esair.writes(float)
    gives: Any = 0.5

    def react(self, sonar: float) -> Any:
        return self.gives if sonar > 1.0 else 0.5


class Drive(esair.Behavior):
    wheels = esair.writes(float)

    async def run(self) -> None:
        await asyncio.sleep(1e6)


class Raises(esair.Behavior):
    async def run(self) -> None:
        await asyncio.sleep(0.1)
        raise NamelessError("odd")


class Floods(esair.Sensor[float]):
    """Has always one more value, and never waits."""

    async def stream(self) -> AsyncIterator[float]:
        number = 0.0
        while True:
            number += 1.0
            yield number


@pytest.mark.promise("ROB-3", "AC-1")
@pytest.mark.parametrize("error", [SystemExit(2), KeyboardInterrupt(), OSError("odd")])
@pytest.mark.parametrize("inside", [False, True])
async def test_what_a_reaction_returns_ends_no_robot(
    error: BaseException, *, inside: bool
) -> None:
    """Its text is wanted for the error that names it."""
    sonar = FakeSensor("sonar", 1.0, type=float)
    wheels: FakeActuator[float] = FakeActuator("wheels", safe=0.0)
    returns = Returns()
    returns.gives = {"wheel": Ends(error)} if inside else Ends(error)
    async with esair.Robot(resources=[sonar, wheels], behaviors=[returns]) as robot:
        await asyncio.sleep(0.05)
        assert wheels.commands[-1] == 0.5
        sonar.feed(2.0)
        await asyncio.sleep(0.05)
        assert wheels.commands[-1] == 0.0
        sonar.feed(1.0)
        await asyncio.sleep(1.0)
        assert robot.behaviors.query("returns").state is BehaviorState.RUNNING
        assert wheels.commands[-1] == 0.5


@pytest.mark.promise("AC-1", "AC-5")
async def test_a_number_of_a_class_of_its_own_is_a_plain_one() -> None:
    """It may compare as it likes: what is checked is what leaves."""
    wheels: FakeActuator[float] = FakeActuator(
        "wheels", safe=0.0, limits=(-1.0, 1.0), clamp=True
    )
    drive = Drive()
    async with esair.Robot(resources=[wheels], behaviors=[drive]):
        assert await drive.wheels.write(Lies(5.0))
        assert wheels.commands[-1] == 1.0
        assert await drive.wheels.write(Lies(0.25))
        assert wheels.commands[-1] == 0.25
        assert type(wheels.commands[-1]) is float


@pytest.mark.promise("SUP-4")
async def test_an_error_that_cannot_be_asked_for_its_class_is_a_failure() -> None:
    """Of its component, which begins anew."""
    raises = Raises()
    async with esair.Robot(behaviors=[raises]) as robot:
        await asyncio.sleep(0.15)
        assert robot.behaviors.query("raises").state is BehaviorState.RESTARTING
        assert "NamelessError" in str(robot.behaviors.query("raises").error)


@pytest.mark.real_clock
@pytest.mark.promise("TURN-4", "BUS-1")
@pytest.mark.fault("D13")
async def test_a_stream_that_never_waits_keeps_nobody_waiting() -> None:
    """What comes in at once is bounded; the newest wins."""
    loop = asyncio.get_running_loop()
    async with esair.Robot(resources=[Floods()]):
        late = 0.0
        for _ in range(30):
            asked = loop.time() + 0.01
            await asyncio.sleep(0.01)
            late = max(late, loop.time() - asked)
    assert late < 0.2
