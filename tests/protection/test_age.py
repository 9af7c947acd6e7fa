"""When a reading is too old, or a hold over: at that moment, whoever steps when."""

from __future__ import annotations

import asyncio
import itertools
from typing import Any

import pytest

import esair
from esair.testing import FakeActuator, FakeSensor

pytestmark = [pytest.mark.virtual_clock, pytest.mark.promise("PRO-1")]


def motor(**options: Any) -> FakeActuator[float]:
    return FakeActuator("motor", safe=0.0, **{"command_timeout": 5.0, **options})


class Two(esair.Reaction):
    """Needs a slow sensor that may be old, and a quick one that may not."""

    slow = esair.reads(float, max_age=3.0)
    quick = esair.reads(float, max_age=0.1)
    motor = esair.writes(float)

    def react(self, slow: float, quick: float) -> float:
        return 0.5


@pytest.mark.parametrize("rate", [None, 2.0, 50.0])
async def test_the_first_reading_that_is_too_old_counts(rate: float | None) -> None:
    """Not the one that is waited for already, and not the reaction's next step."""
    slow = FakeSensor("slow", 1.0, type=float, rate=1.0)
    quick = FakeSensor("quick", 1.0, type=float, rate=50.0)
    wheels, two = motor(), Two()
    two.rate = rate
    async with esair.Robot(resources=[slow, quick, wheels], behaviors=[two]):
        await wheels.until(0.5, timeout=1.0)
        await asyncio.sleep(0.2)
        quick.stall()
        await asyncio.sleep(0.15)
        assert wheels.commands[-1] == 0.0


async def test_an_optional_reading_that_is_gone_hides_no_other() -> None:
    """The one that is needed is looked at as well, after it."""

    class Maybe(esair.Reaction):
        needed = esair.reads(float, max_age=0.2)
        extra = esair.reads(float, max_age=0.1, optional=True)
        motor = esair.writes(float)

        def react(self, needed: float, extra: float | None) -> float:
            return 0.5 if extra is None else 0.25

    needed = FakeSensor("needed", 1.0, type=float, rate=50.0)
    extra = FakeSensor("extra", 1.0, type=float, rate=50.0)
    wheels = motor()
    async with esair.Robot(resources=[needed, extra, wheels], behaviors=[Maybe()]):
        await wheels.until(0.25, timeout=1.0)
        await asyncio.sleep(0.41)
        needed.stall()
        extra.stall()
        await asyncio.sleep(0.12)
        assert wheels.commands[-1] == 0.5
        await asyncio.sleep(0.1)
        assert wheels.commands[-1] == 0.0


@pytest.mark.parametrize("rate", [5.0, 100.0])
async def test_a_rate_is_kept_when_an_optional_reading_is_gone(rate: float) -> None:
    """A reaction with a rate decides without it in its next step, as on a board."""
    times: list[int] = []

    class Maybe(esair.Reaction):
        needed = esair.reads(float)
        extra = esair.reads(float, max_age=0.1, optional=True)
        motor = esair.writes(float)

        def react(self, needed: float, extra: float | None) -> float:
            times.append(self.now_ms)
            return 0.5 if extra is None else 0.25

    Maybe.rate = rate
    needed = FakeSensor("needed", 1.0, type=float, rate=50.0)
    extra = FakeSensor("extra", 1.0, type=float, rate=50.0)
    wheels = motor()
    async with esair.Robot(resources=[needed, extra, wheels], behaviors=[Maybe()]):
        await wheels.until(0.25, timeout=1.0)
        extra.stall()
        await wheels.until(0.5, timeout=1.0)

    periods = [after - before for before, after in itertools.pairwise(times)]
    assert max(periods) <= 1500 / rate  # it waits for a poll half a period at most


@pytest.mark.promise("PRO-9")
async def test_a_guard_without_an_optional_reading_is_not_blind() -> None:
    """Not in the instant either in which that becomes too old: it latches at nothing."""

    class Guard(esair.Reaction):
        rate = 100.0
        extra = esair.reads(float, max_age=0.105, optional=True)
        motor = esair.guards(float, latch=True)

        def react(self, extra: float | None, motor: float) -> float:
            return motor

    drive = esair.Behavior(name="drive", writes={"motor": esair.writes(float)})
    extra = FakeSensor("extra", 1.0, type=float, rate=50.0)
    async with esair.Robot(resources=[extra, motor()], behaviors=[Guard(), drive]):
        await asyncio.sleep(0.1)
        extra.stall()
        for _ in range(300):
            assert await drive.motor.write(0.5)
            await asyncio.sleep(0.001)


class Blind(esair.Reaction):
    """Never sees anything."""

    gone = esair.reads(float, max_age=0.1)
    motor = esair.writes(float, priority=1)

    def react(self, gone: float) -> float | None:
        return None


async def test_a_hold_that_is_over_keeps_no_blind_one_away() -> None:
    """Also if it was blind before the higher priority wrote."""
    gone: FakeSensor[float] = FakeSensor("gone", type=float, rate=50.0)
    wheels = motor()
    user: Any = esair.Behavior(
        name="user", writes={"motor": esair.writes(float, priority=2, hold=0.2)}
    )
    async with esair.Robot(resources=[gone, wheels], behaviors=[Blind(), user]):
        await asyncio.sleep(0.5)
        assert await user.motor.write(0.5)
        await asyncio.sleep(0.15)
        assert wheels.commands[-1] == 0.5
        await asyncio.sleep(0.1)
        assert wheels.commands[-1] == 0.0


@pytest.mark.promise("REA-1", "PRO-5")
async def test_what_a_guard_has_stopped_is_given_back_too() -> None:
    """None gives the actuator back at once, whether the last command left or not."""

    class High(esair.Reaction):
        sonar = esair.reads(float)
        motor = esair.writes(float, priority=2, hold=3.0)

        def react(self, sonar: float) -> float | None:
            return -0.5 if sonar < 1.0 else None

    class Forward(esair.Reaction):
        sonar = esair.reads(float)
        motor = esair.guards(float)

        def react(self, sonar: float, motor: float) -> float | None:
            return None if motor < 0.0 else motor

    class Low(esair.Reaction):
        sonar = esair.reads(float)
        motor = esair.writes(float)

        def react(self, sonar: float) -> float:
            return 0.25

    sonar = FakeSensor("sonar", 0.5, type=float, rate=50.0)
    wheels = motor()
    async with esair.Robot(
        resources=[sonar, wheels], behaviors=[High(), Forward(), Low()]
    ):
        await asyncio.sleep(0.5)
        assert set(wheels.commands) == {0.0}
        sonar.feed(2.0)
        await wheels.until(0.25, timeout=0.1)


async def test_a_quicker_sensor_is_too_old_sooner() -> None:
    """Its newest reading too, which was to be good for three of the old periods."""

    class Go(esair.Reaction):
        eye = esair.reads(float)
        motor = esair.writes(float)

        def react(self, eye: float) -> float:
            return 0.5

    class Hurry(esair.Behavior):
        eye = esair.reads(float, configure=True)

        async def run(self) -> None:
            await asyncio.sleep(1.0)
            eye.stall()
            await self.eye.configure(rate=50.0)

    eye = FakeSensor("eye", 1.0, type=float, rate=5.0)
    wheels = motor()
    async with esair.Robot(resources=[eye, wheels], behaviors=[Go(), Hurry()]):
        await wheels.until(0.5, timeout=0.9)
        await asyncio.sleep(1.2)
        assert wheels.commands[-1] == 0.0
