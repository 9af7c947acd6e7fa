"""What is removed ends, whatever it does, and moves nothing any more."""

from __future__ import annotations

import asyncio
import gc
import threading
from collections.abc import Awaitable, Callable
from typing import Any

import pytest
from tests.supervisors.actors import (
    Driver,
    Idle,
    Scripted,
    Ticker,
    for_ever,
    raises,
    registered,
    seeds,
    swallow,
    wheels,
)

import esair
from esair.supervisors._behavior_deployment import ZOMBIE_LIMIT
from esair.testing import FakeActuator

pytestmark = pytest.mark.virtual_clock


@pytest.mark.fault("L05")
async def test_an_unknown_name_is_not_found() -> None:
    """Removing twice is an error that says so, not a hang."""
    async with esair.Robot(behaviors=[Idle(name="a")]) as robot:
        await robot.behaviors.remove("a")
        for what in (
            robot.behaviors.remove("a"),
            robot.behaviors.replace("a", Idle()),
        ):
            with pytest.raises(esair.UnknownNameError):
                await what
        with pytest.raises(esair.UnknownNameError):
            robot.behaviors.query("a")


@pytest.mark.promise("SUP-5")
@pytest.mark.fault("B19")
async def test_removal_ends_rights_at_once_and_makes_safe() -> None:
    """What it wrote is undone before remove returns, and its port is void."""
    device, driver = wheels(), Driver()
    async with esair.Robot(resources=[device], behaviors=[driver]) as robot:
        await asyncio.sleep(0.12)
        assert device.commands[-1] == 1.0
        port = driver.wheels
        await robot.behaviors.remove("driver")

        assert device.commands[-1] == 0.0
        count = len(device.commands)
        with pytest.raises(esair.BehaviorRemovedError):
            await port.write(1.0)
        with pytest.raises(esair.NotRegisteredError):
            await driver.put("driver", 1)
        assert len(device.commands) == count
        assert registered(robot) == {}


@pytest.mark.promise("SUP-5")
@pytest.mark.fault("B19")
async def test_what_a_crashed_one_wrote_is_undone_before_its_removal_returns() -> None:
    """Its rights ended with the crash; the safe command was still under way."""
    device = wheels()

    async def drives(behavior: Any) -> None:
        await behavior.wheels.write(1.0)
        device.slow(0.03)
        raise RuntimeError("crashed")

    driver = Scripted(drives, name="driver", writes={"wheels": esair.writes(float)})
    async with esair.Robot(resources=[device], behaviors=[driver]) as robot:
        await asyncio.sleep(0.01)
        assert device.commands[-1] == 1.0
        await robot.behaviors.remove("driver")

        assert device.commands[-1] == 0.0


@pytest.mark.promise("SUP-3")
@pytest.mark.fault("B10")
@pytest.mark.parametrize("seed", seeds)
async def test_removal_ends_though_cancellation_is_ignored(seed: int) -> None:
    """What would not die is fenced off, listed and counted; the name is free."""
    device = wheels()

    class Stubborn(Driver):
        async def run(self) -> None:
            port = self.wheels
            while True:
                try:
                    await asyncio.sleep(0.05)
                    await port.write(1.0)
                except (asyncio.CancelledError, esair.BehaviorRemovedError):
                    if asyncio.get_running_loop().time() > 10.0:
                        return

    loop = asyncio.get_running_loop()
    async with esair.Robot(resources=[device], behaviors=[Stubborn()]) as robot:
        await asyncio.sleep(0.2)
        before = loop.time()
        await robot.behaviors.remove("stubborn")

        assert loop.time() - before <= 1.1
        assert [zombie.behavior for zombie in robot.behaviors.zombies] == ["stubborn"]
        assert robot._behaviors.zombie_count == 1
        count = len(device.commands)
        await asyncio.sleep(5.0)
        assert len(device.commands) == count
        assert device.commands[-1] == 0.0
        await robot.behaviors.add(Idle(name="stubborn"))
        await asyncio.sleep(10.0)


@pytest.mark.promise("SUP-3")
@pytest.mark.fault("B11")
async def test_removal_ends_though_the_clean_up_never_does() -> None:
    """A teardown that waits for ever costs the grace period."""
    behavior = Scripted(for_ever, teardown=for_ever, name="slow")
    loop = asyncio.get_running_loop()
    async with esair.Robot(behaviors=[behavior]) as robot:
        before = loop.time()
        await robot.behaviors.remove("slow")
        assert loop.time() - before <= 1.1
        assert robot.behaviors.zombies == ()


@pytest.mark.promise("SUP-3")
@pytest.mark.fault("B14")
async def test_a_thread_that_does_not_end_is_listed() -> None:
    """A plain run that blocks is fenced off with its thread's name."""
    go = threading.Event()
    written: list[object] = []

    class Blocks(esair.Behavior):
        wheels = esair.writes(float)

        def run(self: Any) -> None:
            self.wheels.write(1.0)
            self.put("idle", "begun")
            go.wait(20.0)
            try:
                written.append(self.wheels.write(1.0))
            except esair.BehaviorRemovedError as error:
                written.append(error)

    idle, device = Idle(), wheels()
    robot = esair.Robot(resources=[device], behaviors=[idle, Blocks()], grace=0.05)
    loop: Any = asyncio.get_running_loop()
    async with robot:
        await idle.receive()
        loop.threads_in_flight -= 1  # time goes on though the thread blocks
        await robot.behaviors.remove("blocks")
        loop.threads_in_flight += 1

        assert [zombie.task for zombie in robot.behaviors.zombies] == ["esair-blocks"]
        assert device.commands[-1] == 0.0
        go.set()
        while not written:  # noqa: ASYNC110 - a thread writes
            await asyncio.sleep(0.001)
    assert isinstance(written[0], esair.BehaviorRemovedError)
    assert device.commands.count(1.0) == 1


@pytest.mark.promise("SUP-3")
@pytest.mark.fault("B12", "B13")
async def test_forgotten_tasks_end_with_their_behavior() -> None:
    """Tasks that it started and forgot live as long as it, and no longer."""
    ticks: list[float] = []

    async def tick() -> None:
        async for _ in esair.every(0.1):
            ticks.append(1.0)
            gc.collect()

    async def run(_behavior: object) -> None:
        asyncio.ensure_future(tick())  # noqa: RUF006 - forgotten on purpose
        await for_ever()

    async with esair.Robot(behaviors=[Scripted(run, name="a")]) as robot:
        await asyncio.sleep(0.55)
        assert len(ticks) == 6
        await robot.behaviors.remove("a")
        await asyncio.sleep(1.0)
        assert len(ticks) == 6


@pytest.mark.fault("B12")
async def test_a_task_that_outlives_a_crash_is_listed_at_the_removal() -> None:
    """A survivor of an earlier run is not forgotten by the restart."""

    async def run(behavior: Any) -> None:
        if len(behavior.begun) == 1:
            asyncio.ensure_future(swallow()).set_name("survivor")
            await asyncio.sleep(0)
            raise RuntimeError("first run")
        await for_ever()

    async with esair.Robot(behaviors=[Scripted(run, name="a")]) as robot:
        await asyncio.sleep(1.0)
        await robot.behaviors.remove("a")
        assert [zombie.task for zombie in robot.behaviors.zombies] == ["survivor"]
        await asyncio.sleep(200.0)


@pytest.mark.promise("SUP-3")
@pytest.mark.fault("B03", "B04")
async def test_errors_in_the_clean_up_do_not_stop_the_removal(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """The first error is kept, the second one is reported."""
    behavior = Scripted(for_ever, teardown=raises(RuntimeError("dirty")), name="a")
    async with esair.Robot(behaviors=[behavior]) as robot:
        await robot.behaviors.remove("a")
        assert robot.behaviors.names() == []
    assert "teardown failed too: RuntimeError: dirty" in caplog.text


async def test_the_list_of_zombies_is_bounded() -> None:
    """All are counted, the newest are listed."""
    async with esair.Robot(grace=0.01) as robot:
        for _ in range(ZOMBIE_LIMIT + 3):
            await robot.behaviors.add(Scripted(swallow, name="a"))
            await robot.behaviors.remove("a")
        assert len(robot.behaviors.zombies) == ZOMBIE_LIMIT
        assert robot._behaviors.zombie_count == ZOMBIE_LIMIT + 3
        await asyncio.sleep(200.0)


async def test_a_behavior_may_remove_itself() -> None:
    """The desk does not wait for a task that waits for the desk."""
    robot: esair.Robot

    async def run(_behavior: object) -> None:
        await robot.behaviors.remove("a")

    robot = esair.Robot(behaviors=[Scripted(run, name="a"), Idle(name="b")])
    async with robot:
        await asyncio.sleep(0.1)
        assert robot.behaviors.names() == ["b"]
        assert robot.behaviors.zombies == ()


@pytest.mark.fault("L03", "B19")
async def test_the_same_name_again_is_a_new_behavior() -> None:
    """Old ports stay void and old messages stay away."""
    device, driver = wheels(), Driver()
    async with esair.Robot(resources=[device], behaviors=[driver]) as robot:
        await asyncio.sleep(0.1)
        port = driver.wheels
        await robot.behaviors.put("old", sender="user", receiver="driver")
        assert await robot.behaviors.remove("driver") == ["old"]
        await robot.behaviors.add(driver)
        await robot.behaviors.put("new", sender="user", receiver="driver")
        with pytest.raises(esair.BehaviorRemovedError):
            await port.write(1.0)

        assert driver.wheels is not port
        assert await driver.receive() == "new"


@pytest.mark.fault("L04")
@pytest.mark.parametrize("seed", seeds)
async def test_adding_while_the_removal_runs_waits_for_it(seed: int) -> None:
    """There are never two behaviors with one name."""

    async def slow(_behavior: object) -> None:
        await asyncio.sleep(0.5)

    old, new = Scripted(for_ever, teardown=slow, name="a"), Ticker(name="a")
    async with esair.Robot(behaviors=[old]) as robot:
        removing = asyncio.ensure_future(robot.behaviors.remove("a"))
        await asyncio.sleep(0)
        await robot.behaviors.add(new)

        assert removing.done()
        assert asyncio.get_running_loop().time() >= 0.5


async def test_a_setup_that_ignores_its_end_does_not_come_to_life() -> None:
    """A behavior that is on its way out never counts as running."""

    async def stubborn(_behavior: object) -> None:
        try:
            await for_ever()
        except asyncio.CancelledError:
            return

    behavior = Scripted(for_ever, setup=stubborn, name="a")
    async with esair.Robot() as robot:
        adding = asyncio.ensure_future(robot.behaviors.add(behavior))
        await asyncio.sleep(0.1)
        adding.cancel()
        await asyncio.wait({adding})
        assert adding.cancelled()
        assert robot.behaviors.names() == []


async def test_a_zombie_that_ends_at_last_is_no_trouble() -> None:
    """However it ends, nobody is told, because nobody waits."""

    def late(error: BaseException) -> Callable[[object], Awaitable[None]]:
        async def run(_behavior: object) -> None:
            async def child() -> None:
                await swallow()
                raise error

            asyncio.ensure_future(child())  # noqa: RUF006 - forgotten on purpose
            await for_ever()

        return run

    async with esair.Robot() as robot:
        for error in (RuntimeError("late"), asyncio.CancelledError()):
            await robot.behaviors.add(Scripted(late(error), name="a"))
            await robot.behaviors.remove("a")
        await asyncio.sleep(200.0)
        gc.collect()
        assert robot._behaviors.zombie_count == 2


async def test_two_who_wait_are_both_woken_by_the_removal() -> None:
    """Whether they were woken by data already or not."""
    idle = Idle()
    async with esair.Robot(behaviors=[idle]) as robot:
        waiting = [asyncio.ensure_future(idle.receive()) for _ in range(2)]
        await asyncio.sleep(0)
        removing = asyncio.ensure_future(robot.behaviors.remove("idle"))
        await asyncio.sleep(0)
        await robot.behaviors.put(1, sender="user", receiver="idle")
        results = await asyncio.gather(*waiting, return_exceptions=True)
        left = await removing
        taken = [result for result in results if result == 1]
        assert len(taken) + len(left) == 1


@pytest.mark.promise("SUP-5", "SUP-3")
@pytest.mark.parametrize("takes", [0.1, 0.5])
async def test_who_goes_without_its_safe_command_is_told(
    takes: float, caplog: pytest.LogCaptureFixture
) -> None:
    """The removal does not wait for it for ever; it says so, and no more than is true."""
    wheels = FakeActuator("wheels", safe=0.0)
    user: Any = esair.Behavior(name="user", writes={"wheels": esair.writes(float)})
    async with esair.Robot(resources=[wheels], behaviors=[user], grace=0.3) as robot:
        wheels.slow(takes)
        writing = asyncio.ensure_future(user.wheels.write(1.0))
        await asyncio.sleep(0.01)
        await robot.resources.remove("wheels")
        await asyncio.gather(writing, return_exceptions=True)
    told = [each for each in caplog.messages if each.endswith("may move on")]
    assert len(told) == (takes == 0.5)
    assert all(each.startswith("wheels: safe 0.0: NOT ANSWERED") for each in told)


async def test_who_waits_for_its_setup_is_told_that_it_was_removed() -> None:
    """Also if it swallows its cancellation: its setup ends then as if it were well."""

    class Deaf(esair.Behavior):
        async def setup(self) -> None:
            try:
                await asyncio.sleep(10.0)
            except asyncio.CancelledError:
                await asyncio.sleep(0.43)

        async def run(self) -> None:
            """It never comes to that."""

    async with esair.Robot() as robot:
        adding = asyncio.create_task(robot.behaviors.add(Deaf()))
        await asyncio.sleep(0.11)
        removing = asyncio.create_task(robot.behaviors.remove("deaf"))
        await asyncio.sleep(0.01)
        assert not removing.done()
        with pytest.raises(esair.BehaviorRemovedError):
            await adding
        await removing
