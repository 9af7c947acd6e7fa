"""What a robot counts, by one for each."""

from __future__ import annotations

import asyncio
import math
from typing import Any

import pytest

import esair
from esair.testing import FakeActuator, FakeSensor

pytestmark = [pytest.mark.virtual_clock, pytest.mark.promise("TURN-5")]

NONE_OF_A_SENSOR = dict.fromkeys(
    (
        "readings",
        "transactions",
        "missed",
        "bad",
        "dropped",
        "abandoned",
        "late",
        "turned_away",
    ),
    0,
)
NONE_OF_AN_ACTUATOR = dict.fromkeys(
    ("writes", "refusals", "timeouts", "abandoned", "late", "turned_away"), 0
)


def parts(user_of: Any, **options: Any) -> tuple[Any, Any]:
    sonar = FakeSensor("sonar", 1.0, type=float, rate=10.0, **options)
    return sonar, user_of("user", sonar=esair.reads(float))


async def test_readings_and_transactions(user_of: Any) -> None:
    """What is known already asks nobody; what is pushed is no transaction."""
    sonar, user = parts(user_of)
    async with esair.Robot(resources=[sonar], behaviors=[user]) as robot:
        channel = robot.sensors.channel("sonar")
        assert channel.counts() == NONE_OF_A_SENSOR
        await user.sonar.read()
        await user.sonar.read()
        await user.sonar.read(fresh=True)
        assert channel.counts() == NONE_OF_A_SENSOR | {"readings": 2, "transactions": 2}
        sonar.feed(2.0)
        await asyncio.sleep(0.01)
        assert channel.counts() == NONE_OF_A_SENSOR | {"readings": 3, "transactions": 2}
        assert (await user.sonar.reading()).sequence == 3


async def test_bad_readings(user_of: Any) -> None:
    """Pushed or asked for, each is counted once, and is no reading."""
    sonar, user = parts(user_of)
    async with esair.Robot(resources=[sonar], behaviors=[user]) as robot:
        channel = robot.sensors.channel("sonar")
        sonar.feed(math.nan)
        await asyncio.sleep(0.01)
        with pytest.raises(esair.DeviceFaultError, match="nan"):
            await user.sonar.read()
        assert channel.counts() == NONE_OF_A_SENSOR | {"bad": 2, "transactions": 1}


async def test_polls_that_come_while_it_has_not_answered(
    fake_actuator: Any,
) -> None:
    """Each is left out, and counted."""
    sonar = FakeSensor("sonar", 1.0, type=float, rate=10.0)
    wheels = fake_actuator("wheels", safe=0.0)

    class Reflex(esair.Reaction):
        sonar = esair.reads(float)
        wheels = esair.writes(float)

        def react(self, sonar: float) -> None: ...

    async with esair.Robot(resources=[sonar, wheels], behaviors=[Reflex()]) as robot:
        channel = robot.sensors.channel("sonar")
        await asyncio.sleep(0.25)
        before = channel.counts()
        assert before["missed"] == 0
        sonar.slow(0.35)
        await asyncio.sleep(0.1)
        sonar.slow(0.0)
        await asyncio.sleep(0.31)
        after = channel.counts()
        assert after["missed"] == 3
        assert after["transactions"] == before["transactions"] + 1
        assert after["readings"] == before["readings"] + 1


async def test_calls_that_are_given_up_and_end_late(user_of: Any) -> None:
    """Each once: when it is given up, and when it ends."""
    sonar, user = parts(user_of)
    sonar.deadline = 0.2
    async with esair.Robot(resources=[sonar], behaviors=[user]) as robot:
        channel = robot.sensors.channel("sonar")
        sonar.slow(0.25)
        sonar.swallow(1)
        with pytest.raises(esair.DriverStuckError):
            await user.sonar.read()
        assert channel.counts()["abandoned"] == 1
        assert channel.counts()["late"] == 0
        await asyncio.sleep(0.1)
        assert channel.counts()["abandoned"] == 1
        assert channel.counts()["late"] == 1
        assert channel.counts()["readings"] == 0


async def test_writes_refusals_and_time_outs(user_of: Any) -> None:
    """The safe command is no write; the writes that nobody renews time out once."""
    wheels = FakeActuator("wheels", safe=0.0, command_timeout=0.2)
    high = user_of("high", wheels=esair.writes(float, priority=5))
    low = user_of("low", wheels=esair.writes(float))
    async with esair.Robot(resources=[wheels], behaviors=[high, low]) as robot:
        channel = robot.actuators.channels["wheels"]
        assert channel.counts() == NONE_OF_AN_ACTUATOR
        await high.wheels.write(1.0)
        assert not await low.wheels.write(2.0)
        assert channel.counts() == NONE_OF_AN_ACTUATOR | {"writes": 1, "refusals": 1}
        await asyncio.sleep(1.0)
        assert wheels.commands == [0.0, 1.0, 0.0]
        assert channel.counts()["timeouts"] == 1
        wheels.slow(0.01)
        await low.wheels.write(2.0)
        assert channel.counts()["writes"] == 2
        wheels.fail(ValueError("no"))
        with pytest.raises(esair.DeviceFaultError):
            await low.wheels.write(3.0)
        assert channel.counts()["writes"] == 2


async def test_readings_that_a_loop_has_not_taken(user_of: Any) -> None:
    """The newest wins; the others are counted as dropped."""
    sonar, user = parts(user_of)
    async with esair.Robot(resources=[sonar], behaviors=[user]) as robot:
        values = aiter(user.sonar)
        taking = asyncio.create_task(anext(values))
        await asyncio.sleep(0.01)
        await taking
        for value in (1.5, 2.5, 3.5):
            sonar.feed(value)
            await asyncio.sleep(0.001)
        assert await anext(values) == 3.5
        counts = robot.sensors.channel("sonar").counts()
        once = {"readings": 4, "dropped": 2, "transactions": 1}
        assert counts == NONE_OF_A_SENSOR | once
        assert robot.resources.query("sonar").faults == 0
        await values.aclose()


class Telling(esair.Actuator[float]):
    """Says in its own way what it has applied."""

    safe = 0.0

    def __init__(self, says: Any = None, seconds: float | None = None) -> None:
        super().__init__(name="wheels")
        self.says, self.seconds = says, seconds

    async def write(self, command: float) -> Any:
        if self.seconds is not None:
            await asyncio.sleep(self.seconds)
        return self.says


@pytest.mark.parametrize("seconds", [None, 0.0, 0.01])
@pytest.mark.parametrize("says", [None, 0.25])
@pytest.mark.parametrize("is_read", [False, True])
async def test_each_write_is_counted_once(
    seconds: float | None, says: float | None, is_read: bool
) -> None:
    """However its driver answers, and whether somebody reads what it has applied."""
    reads = {"applied": esair.reads(float, name="wheels.applied")} if is_read else {}
    writes = {"wheels": esair.writes(float)}
    user: Any = esair.Behavior(name="user", reads=reads, writes=writes)
    wheels = Telling(says, seconds)
    async with esair.Robot(resources=[wheels], behaviors=[user]) as robot:
        channel = robot.actuators.channels["wheels"]
        assert channel.counts()["writes"] == 0
        for number in (1, 2, 3):
            await user.wheels.write(0.5)
            assert channel.counts()["writes"] == number
