"""Another behavior takes the place of one, under the same name."""

from __future__ import annotations

import asyncio

import pytest
from tests.supervisors.actors import (
    Driver,
    Idle,
    Scripted,
    State,
    for_ever,
    raises,
    registered,
    seeds,
    wheels,
)

import esair
from esair.testing import FakeActuator, FakeSensor

pytestmark = pytest.mark.virtual_clock


class Copy(esair.Reaction):
    """Moves as fast as the sonar says."""

    sonar = esair.reads(float)
    wheels = esair.writes(float)

    def react(self, sonar: float) -> float:
        return sonar


class Slow(esair.Behavior):
    """Does the same, after a long setup."""

    sonar = esair.reads(float)
    wheels = esair.writes(float)

    async def setup(self) -> None:
        await asyncio.sleep(0.7)

    async def run(self) -> None:
        async for sonar in self.sonar:
            await self.wheels.write(sonar)


@pytest.mark.promise("SUP-2")
async def test_replace_puts_another_in_the_same_place() -> None:
    """The new one uses what the old one used; what was not taken is handed back."""
    device = wheels()
    fast = Driver()
    fast.speed = 2.0
    async with esair.Robot(resources=[device], behaviors=[Driver()]) as robot:
        await asyncio.sleep(0.1)
        await robot.behaviors.put(1, sender="user", receiver="driver")
        assert await robot.behaviors.replace("driver", fast) == [1]
        await asyncio.sleep(0.12)

        assert device.commands[-1] == 2.0
        assert registered(robot) == {"driver": 1}
        assert robot.behaviors.query("driver").state is State.RUNNING


@pytest.mark.promise("SUP-2")
async def test_who_takes_a_place_takes_its_name() -> None:
    """Whatever its class is called: in what it says of itself, too."""
    idle = Idle()
    async with esair.Robot(resources=[wheels()], behaviors=[Driver()]) as robot:
        await robot.behaviors.replace("driver", idle)
        assert idle.name == "driver"


@pytest.mark.promise("RS-5", "SUP-2")
@pytest.mark.parametrize("kind", [Copy, Slow])
async def test_a_device_that_goes_and_comes_while_one_stands_by_is_its_again(
    kind: type[esair.Behavior | esair.Reaction],
) -> None:
    """It cannot decide yet, or is being set up; once it is there it moves the device."""
    device, sonar = wheels(), FakeSensor("sonar", 0.5)
    async with esair.Robot(resources=[device, sonar], behaviors=[kind()]) as robot:
        await device.until(0.5, timeout=1.0)
        sonar.unplug()
        await asyncio.sleep(0.1)
        replace = asyncio.create_task(robot.behaviors.replace(kind().name, kind()))
        await asyncio.sleep(0.3)
        await robot.resources.remove("wheels")
        await robot.resources.add(other := wheels())
        await replace
        sonar.plug()
        await other.until(0.5, timeout=6.0)


@pytest.mark.promise("SUP-2", "AC-2")
@pytest.mark.parametrize("seed", seeds)
async def test_the_old_one_is_safe_before_the_new_one_moves(seed: int) -> None:
    """Between the last command of the old and the first of the new one is a stop."""
    device = wheels()
    fast = Driver()
    fast.speed = 2.0
    async with esair.Robot(resources=[device], behaviors=[Driver()]) as robot:
        await asyncio.sleep(0.12)
        await robot.behaviors.replace("driver", fast)
        await asyncio.sleep(0.12)

    moved = device.commands
    assert moved[moved.index(2.0) - 1] == 0.0
    assert 1.0 not in moved[moved.index(2.0) :]


@pytest.mark.promise("SUP-2")
async def test_a_replacement_that_cannot_be_set_up_changes_nothing() -> None:
    """The old one goes on, with its rights."""
    device = wheels()
    bad = Scripted(for_ever, setup=raises(RuntimeError("no")), name="bad")
    async with esair.Robot(resources=[device], behaviors=[Driver()]) as robot:
        with pytest.raises(esair.BehaviorFailedError, match="no"):
            await robot.behaviors.replace("driver", bad)
        await asyncio.sleep(0.2)

        assert device.commands[-1] == 1.0
        assert robot.behaviors.names() == ["driver"]


async def test_a_cancelled_replace_changes_nothing() -> None:
    """A set-up that hangs does not close the desk for good."""
    device = wheels()
    hangs = Scripted(for_ever, setup=for_ever)
    async with esair.Robot(resources=[device], behaviors=[Driver()]) as robot:
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(1.0):
                await robot.behaviors.replace("driver", hangs)
        await asyncio.sleep(0.2)
        assert device.commands[-1] == 1.0
        assert robot.behaviors.phase is esair.SupervisorPhase.WAIT_REQUEST


async def test_a_replacement_may_declare_more() -> None:
    """Its own class decides what it may write, not that of the old one."""

    class Arm(esair.Behavior):
        arm = esair.writes(float)

        async def run(self) -> None:
            await self.arm.write(3.0)
            await for_ever()

    arm = FakeActuator("arm", safe=0.0)
    async with esair.Robot(resources=[wheels(), arm], behaviors=[Driver()]) as robot:
        await robot.behaviors.replace("driver", Arm())
        assert await arm.until(3.0) == 3.0
        assert registered(robot) == {"driver": 1}


async def test_a_behavior_cannot_take_its_own_place() -> None:
    """Replacing something by itself is a mistake, and says so."""
    driver = Driver()
    async with esair.Robot(resources=[wheels()], behaviors=[driver]) as robot:
        with pytest.raises(esair.ConfigError, match="own place"):
            await robot.behaviors.replace("driver", driver)
        with pytest.raises(esair.ConfigError, match="expected an esair"):
            await robot.behaviors.replace("driver", 3)  # type: ignore[arg-type]


@pytest.mark.promise("BS-4")
async def test_requests_that_wait_go_on_to_the_replacement() -> None:
    """They keep their order, before what comes later."""

    class Small(Idle):
        inbox_size = 1

    class New(Small):
        async def setup(self) -> None:
            self.offer("offered")

    a, new = Idle(name="a"), New(name="b")
    async with esair.Robot(behaviors=[a, Small(name="b")]) as robot:
        await a.put("b", 0)
        puts = []
        for number in (1, 2):
            puts.append(asyncio.ensure_future(a.put("b", number)))
            await asyncio.sleep(0)
        get = asyncio.ensure_future(a.get("b"))
        await asyncio.sleep(0)
        assert await robot.behaviors.replace("b", new) == [0]
        puts.append(asyncio.ensure_future(a.put("b", 3)))

        assert [await new.receive() for _ in range(3)] == [1, 2, 3]
        assert await get == "offered"
        await asyncio.gather(*puts)


@pytest.mark.promise("BS-4")
async def test_a_get_that_is_being_answered_goes_on_to_the_replacement() -> None:
    """The old one's provide ends without an answer; the new one's answers."""

    class Slow(Idle):
        async def provide(self) -> str:
            await asyncio.sleep(5.0)
            return "old"

    class Fast(Idle):
        async def provide(self) -> str:
            return "new"

    a = Idle(name="a")
    async with esair.Robot(behaviors=[a, Slow(name="b")]) as robot:
        get = asyncio.ensure_future(a.get("b", interval=9.0))
        await asyncio.sleep(0.1)
        await robot.behaviors.replace("b", Fast())
        assert await get == "new"


async def test_a_stop_in_the_middle_of_a_replace_ends_both() -> None:
    """The one that is on its way out is not forgotten."""

    async def slow(_behavior: object) -> None:
        await asyncio.sleep(0.5)

    old = Scripted(for_ever, teardown=slow, name="a")
    async with esair.Robot(behaviors=[old]) as robot:
        replacing = asyncio.ensure_future(robot.behaviors.replace("a", Idle()))
        await asyncio.sleep(0.1)
    assert await replacing == []
    assert robot.behaviors.zombies == ()
