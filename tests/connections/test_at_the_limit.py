"""What holds at exactly a limit: the edges of moments, ages, bounds and budgets."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

import pytest

import esair
from esair.connections._calls import ABANDONED_LIMIT
from esair.loop import REACHED, READ_COST, WRITE_COST, Budget
from esair.messages import Stamped
from esair.testing import FakeActuator, FakeSensor

pytestmark = pytest.mark.virtual_clock

HAIR = 2.0**-20
"""Less than anybody measures, and more than a timer may be early; exact in a float."""


def whole_second() -> Awaitable[None]:
    """Wait for a moment from which sums of such fractions are exact."""
    return asyncio.sleep(-asyncio.get_running_loop().time() % 1.0 + 1.0)


# Moments.


@pytest.mark.promise("AC-1")
@pytest.mark.parametrize("is_guarded", [False, True])
@pytest.mark.parametrize(("ahead", "leaves"), [(0.0, True), (-HAIR, False)])
async def test_a_command_leaves_until_the_moment_when_it_expires(
    ahead: float, leaves: bool, is_guarded: bool, user_of: Any
) -> None:
    """In that moment still, also behind guards: what has expired is past."""

    class Guard(esair.Reaction):
        sonar = esair.reads(float)
        wheels = esair.guards(float)

        def react(self, sonar: float, wheels: float) -> float:
            return wheels

    wheels, user = FakeActuator("wheels", safe=0.0), user_of("user", wheels=WRITES)
    robot = esair.Robot(
        resources=[wheels, FakeSensor("sonar", 1.0)],
        behaviors=[user, *([Guard()] if is_guarded else [])],
    )
    async with robot:
        await whole_second()
        expires = asyncio.get_running_loop().time() + ahead
        assert bool(await user.wheels.write(0.5, expires=expires)) is leaves
        assert (0.5 in wheels.commands) is leaves


@pytest.mark.promise("AC-1", "AC-3")
@pytest.mark.parametrize("expires", [float("nan"), "12:00", True, [1.0], 1j])
@pytest.mark.parametrize("seconds", [0.0, 0.05])
async def test_a_moment_that_is_none_is_a_mistake_of_its_field(
    expires: Any, seconds: float, user_of: Any
) -> None:
    """Nothing was changed then: what stands does, and who holds it."""
    wheels, user = FakeActuator("wheels", safe=0.0), user_of("user", wheels=WRITES)
    high = user_of("high", wheels=esair.writes(float, priority=9))
    async with esair.Robot(resources=[wheels], behaviors=[user, high]):
        wheels.slow(seconds)
        assert await user.wheels.write(0.5)
        with pytest.raises(
            esair.BadValueError, match="wheels: expires: expected a moment"
        ):
            await high.wheels.write(1.0, expires=expires)
        assert user.wheels.why().holder == "user"
        assert wheels.commands == [0.0, 0.5]


@pytest.mark.promise("AC-3", "RS-6")
@pytest.mark.parametrize("left", [-HAIR, 0.0, REACHED / 2, 2 * REACHED])
async def test_a_hold_begins_anew_when_it_was_over(left: float, user_of: Any) -> None:
    """For whoever writes then, its holder too, it was over in the same moment."""
    wheels, user = FakeActuator("wheels", safe=0.0), user_of("user", wheels=WRITES)
    async with esair.Robot(resources=[wheels], behaviors=[user]) as robot:
        hold, loop = robot.actuators.channels["wheels"].hold, asyncio.get_running_loop()
        await whole_second()
        await user.wheels.write(0.5)
        began = hold.since
        await asyncio.sleep(0.125)
        hold.seconds = 0.125 + left
        is_held = hold.present(loop.time()) is not None
        assert is_held is (left > REACHED)
        await user.wheels.write(0.5)
        assert user.wheels.why().since == (began if is_held else loop.time())


# Ages.


WRITES = esair.writes(float)


async def newest(port: Any) -> Any:
    return port.newest.value


@pytest.mark.promise("SC-1")
@pytest.mark.parametrize(
    ("read", "limit"),
    [
        (lambda port: port.read(), 0.25),
        (lambda port: port.reading(), 0.25),
        (lambda port: port.read(max_age=0.125), 0.125),
        (newest, 0.5),
    ],
)
@pytest.mark.parametrize("older", [0.0, HAIR])
async def test_a_reading_is_good_until_it_has_its_greatest_age(
    read: Callable[[Any], Awaitable[Any]], limit: float, older: float, user_of: Any
) -> None:
    """With exactly that age it is; older, the device is asked, or it is stale."""
    sonar = FakeSensor("sonar", 1.0, rate=4.0)
    user = user_of("user", sonar=esair.reads(float, max_age=0.5))
    async with esair.Robot(resources=[sonar], behaviors=[user]):
        await whole_second()
        await user.sonar.read()
        await asyncio.sleep(limit + older)
        asked = sonar.reads
        if read is newest and older:
            with pytest.raises(esair.StaleReadingError):
                await read(user.sonar)
        else:
            await read(user.sonar)
            assert sonar.reads == asked + bool(older)


@pytest.mark.promise("SC-1")
@pytest.mark.parametrize("older", [0.0, HAIR])
async def test_an_answer_may_have_exactly_the_greatest_age(
    older: float, user_of: Any
) -> None:
    """By what its driver says of it; also in a loop over the values."""

    class Lidar(esair.Sensor[float]):
        rate = 4.0

        async def read(self) -> Any:
            return Stamped(1.0, age=0.25 + older)

    user = user_of("user", lidar=esair.reads(float, max_age=0.25))
    async with esair.Robot(resources=[Lidar()], behaviors=[user]):
        await whole_second()
        loop_over = aiter(user.lidar)
        following = asyncio.ensure_future(anext(loop_over))
        try:
            await asyncio.sleep(1.0)
            assert following.done() is not bool(older)
            if older:
                with pytest.raises(esair.StaleReadingError):
                    await user.lidar.read(fresh=True)
            else:
                assert await user.lidar.read(fresh=True) == 1.0
        finally:
            following.cancel()
            await asyncio.wait({following})
            await loop_over.aclose()


# Bounds.


@pytest.mark.promise("AC-1")
async def test_writes_that_wait_are_bounded(
    monkeypatch: pytest.MonkeyPatch, user_of: Any
) -> None:
    """As many as the bound wait; one more is told so, and counted."""
    monkeypatch.setattr("esair.connections._turns.WAITING_LIMIT", 2)
    motor = FakeActuator("motor", safe=0.0, command_timeout=5.0)
    user = user_of("user", motor=WRITES)
    async with esair.Robot(resources=[motor], behaviors=[user]) as robot:
        motor.slow(0.1)
        writes = [user.motor.write(float(n)) for n in range(1, 5)]
        told = await asyncio.gather(*writes, return_exceptions=True)
        assert [bool(each) for each in told[:3]] == [True] * 3
        assert isinstance(told[3], esair.BusyError)
        assert robot.journal.counts()["motor"]["turned_away"] == 1


@pytest.mark.promise("CALL-1")
async def test_as_many_calls_as_the_bound_may_be_abandoned(user_of: Any) -> None:
    """Then none is begun any more, until one of them has ended."""
    end = asyncio.Event()

    class Deaf(esair.Sensor[float]):
        rate = 1000.0
        deadline = 0.01
        fault_limit = 1000
        begun = 0

        async def read(self) -> float:
            self.begun += 1
            while not end.is_set():
                try:
                    await end.wait()
                except asyncio.CancelledError:
                    continue
            return 1.0

    deaf = Deaf()
    async with esair.Robot(resources=[deaf]) as robot:
        calls = robot.sensors.channels["deaf"].calls
        method = calls.driver.method("read")
        for _ in range(ABANDONED_LIMIT):
            with pytest.raises(esair.DriverStuckError):
                await calls.run("read", method, limit=0.01)
        with pytest.raises(esair.DriverStuckError, match="8 calls have not ended"):
            calls.begin("read", method, (), 0.01)
        assert deaf.begun == ABANDONED_LIMIT
        end.set()
        await asyncio.sleep(0.01)
        assert await calls.run("read", method, limit=0.01) == 1.0


# Budgets.


@pytest.mark.promise("AC-1", "SC-1")
@pytest.mark.parametrize(
    ("verb", "cost"),
    [
        (lambda user: user.sonar.read(), READ_COST),
        (lambda user: user.sonar.reading(), READ_COST),
        (lambda user: user.sonar.read(max_age=1.0), 2 * READ_COST),
        (lambda user: user.wheels.write(0.5), WRITE_COST),
    ],
)
async def test_a_verb_that_need_not_wait_costs_what_it_costs(
    verb: Callable[[Any], Awaitable[Any]], cost: float, user_of: Any
) -> None:
    """With just so much left it does not give way, with less it does."""
    sonar, wheels = FakeSensor("sonar", 1.0, rate=4.0), FakeActuator("wheels", safe=0.0)
    user = user_of("user", sonar=esair.reads(float), wheels=WRITES)
    async with esair.Robot(resources=[sonar, wheels], behaviors=[user]):
        await whole_second()
        await user.sonar.read()
        await asyncio.sleep(0.25)
        budget = Budget.of(asyncio.get_running_loop())
        for left, is_refilled in ((1.1 * cost, False), (0.9 * cost, True)):
            now = asyncio.get_running_loop().time()
            budget.late = now + left
            await verb(user)
            assert (budget.late > now + left) == is_refilled


# The shortcut.


@pytest.mark.promise("AC-3", "PRO-6")
async def test_a_write_takes_the_short_way_while_nothing_shuts_the_gate(
    user_of: Any,
) -> None:
    """Settled at each change: a verdict that nobody needs is dear."""
    wheels, user = FakeActuator("wheels", safe=0.0), user_of("user", wheels=WRITES)
    async with esair.Robot(resources=[wheels], behaviors=[user]) as robot:
        channel = robot.actuators.channels["wheels"]
        assert channel._is_plain
        await robot.halt("look")
        assert not channel._is_plain
        robot.resume()
        assert channel._is_plain
        wheels.unplug()
        await asyncio.sleep(0.01)
        assert not channel._is_plain
        wheels.plug()
        await asyncio.sleep(1.0)
        assert channel._is_plain
        assert await user.wheels.write(0.5)
    assert not channel._is_plain
