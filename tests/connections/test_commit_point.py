"""The commit point, and the safe command as the last thing on the wire."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import threading
from typing import Any

import pytest

import esair
from esair.connections import Registration, Terms

pytestmark = pytest.mark.virtual_clock


@pytest.mark.promise("AC-3", "RS-3")
@pytest.mark.fault("R06")
async def test_a_write_revoked_while_it_waits_never_reaches_the_device(
    fake_actuator: Any, user_of: Any
) -> None:
    """It is told at once, long before the write in flight has ended."""
    wheels = fake_actuator("wheels", safe=0.0, command_timeout=5.0)
    user = user_of("user", wheels=esair.writes(float))

    async with esair.Robot(resources=[wheels], behaviors=[user]) as robot:
        wheels.stall()
        first = asyncio.create_task(user.wheels.write(1.0))
        second = asyncio.create_task(user.wheels.write(2.0))
        await asyncio.sleep(0.01)
        robot.resources.revoke(user.wheels.registration)
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        with pytest.raises(esair.NotRegisteredError, match="revoked"):
            second.result()
        wheels.resume()
        assert await first
        await asyncio.sleep(0.1)

        assert wheels.commands == [0.0, 1.0, 0.0]


@pytest.mark.promise("AC-3", "RS-3")
@pytest.mark.fault("R05", "R06")
@pytest.mark.real_clock
async def test_a_write_revoked_while_it_waits_for_the_thread_is_not_made() -> None:
    """The guard is asked in the thread, immediately before the driver is called."""
    go, calls = threading.Event(), []

    class Blocking(esair.Actuator[float]):
        safe = 0.0
        command_timeout = 5.0

        def write(self, command: float) -> None:
            calls.append(command)

    arm = Blocking(name="arm")
    user = esair.Behavior(name="user", writes={"arm": esair.writes(float)})
    async with esair.Robot(resources=[arm], behaviors=[user]) as robot:
        executor = robot.actuators.channels["arm"].driver.executor
        blocker = asyncio.create_task(executor.call(go.wait, timeout=5.0))
        await asyncio.sleep(0.02)
        writing = asyncio.create_task(user.arm.write(1.0))
        await asyncio.sleep(0.02)
        robot.resources.revoke(user.arm.registration)
        go.set()
        await blocker
        with pytest.raises(esair.NotRegisteredError):
            await writing
        await asyncio.sleep(0.05)

    assert 1.0 not in calls
    assert calls[-1] == 0.0


@pytest.mark.promise("AC-3", "ROB-2")
async def test_nothing_but_safe_leaves_once_the_robot_stops(
    fake_actuator: Any, user_of: Any
) -> None:
    """A write that waited when the stop began is refused, not sent."""
    wheels = fake_actuator("wheels", safe=0.0, command_timeout=0.5)
    outcomes: list[object] = []

    class Stubborn(esair.Behavior):
        wheels = esair.writes(float)

        async def run(self) -> None:
            await self.wheels.write(1.0)
            try:
                await asyncio.sleep(100)
            finally:
                try:
                    await self.wheels.write(1.0)
                except Exception as error:
                    outcomes.append(error)

        async def teardown(self) -> None:
            try:
                await self.wheels.write(1.0)
            except Exception as error:
                outcomes.append(error)

    async with esair.Robot(resources=[wheels], behaviors=[Stubborn()]):
        await asyncio.sleep(0.1)

    assert wheels.commands == [0.0, 1.0, 0.0, 0.0]
    assert [type(each) for each in outcomes] == [esair.StoppingError] * 2


@pytest.mark.promise("AC-3")
async def test_a_latched_actuator_takes_no_writes(fake_actuator: Any) -> None:
    """The latch holds even for a registration that is issued after it."""
    wheels = fake_actuator("wheels", safe=0.0)
    user = esair.Behavior(name="user", writes={"wheels": esair.writes(float)})
    async with esair.Robot(resources=[wheels], behaviors=[user]) as robot:
        robot._resources.latch()
        late = await robot.resources.register("user", "wheels", esair.Access.WRITE)
        with pytest.raises(esair.StoppingError):
            await robot.actuators.write(late, 1.0)


@pytest.mark.promise("AC-4")
@pytest.mark.fault("D22", "D29", "R10")
async def test_a_late_write_cannot_undo_the_safe_command(user_of: Any) -> None:
    """A write that ends after the safe command is followed by another safe command."""
    log: list[float] = []
    go = asyncio.Event()

    class Slow(esair.Actuator[float]):
        safe = 0.0

        async def write(self, command: float) -> None:
            if command:
                await go.wait()
            log.append(command)

    user = user_of("user", slow=esair.writes(float))
    async with esair.Robot(resources=[Slow()], behaviors=[user]) as robot:
        writing = asyncio.create_task(user.slow.write(1.0))
        await asyncio.sleep(0.45)  # 0.2 s to time out, 0.2 s of waiting for the write
        assert log == [0.0, 0.0]
        assert robot.actuators.channels["slow"].safe.state is None
        go.set()
        assert await writing
        await asyncio.sleep(0.01)

        assert log == [0.0, 0.0, 1.0, 0.0]


@pytest.mark.promise("AC-4", "SUP-5")
@pytest.mark.fault("R10")
async def test_a_removal_waits_for_the_write_in_flight(user_of: Any) -> None:
    """Safe is the last command, though the write would not end for a while."""
    log: list[float] = []

    class Slow(esair.Actuator[float]):
        safe = 0.0

        async def write(self, command: float) -> None:
            if command:
                await asyncio.sleep(0.6)
            log.append(command)

    user = user_of("user", slow=esair.writes(float))
    async with esair.Robot(resources=[Slow()], behaviors=[user]) as robot:
        writing = asyncio.create_task(user.slow.write(1.0))
        await asyncio.sleep(0.01)
        await robot.resources.remove("slow")
        assert log == [0.0, 0.0, 1.0, 0.0]
        assert await writing
        with pytest.raises(esair.ResourceRemovedError):
            await user.slow.write(1.0)


@pytest.mark.promise("AC-4")
async def test_a_successor_waits_for_the_write_in_flight_as_the_first_did(
    user_of: Any,
) -> None:
    """That the device before it had to go by a moment does not hurry it."""
    log: list[float] = []

    class Slow(esair.Actuator[float]):
        safe = 0.0

        async def write(self, command: float) -> None:
            if command:
                await asyncio.sleep(0.2)
            log.append(command)

    user = user_of("user", slow=esair.writes(float))
    async with esair.Robot(resources=[Slow()], behaviors=[user]) as robot:
        await robot.resources.replace("slow", Slow())
        await asyncio.sleep(5.0)
        log.clear()
        writing = asyncio.create_task(user.slow.write(1.0))
        await asyncio.sleep(0.1)
        robot.actuators.channels["slow"].make_safe()
        await writing
        await asyncio.sleep(0.5)
        assert log == [1.0, 0.0]


@pytest.mark.promise("AC-4")
@pytest.mark.fault("D04", "D22")
async def test_a_write_from_before_a_loss_does_not_move_the_device_after_it(
    user_of: Any,
) -> None:
    """The device is opened again only when the old call has ended; safe is last."""
    log: list[object] = []

    class Slow(esair.Actuator[float]):
        safe = 0.0

        async def open(self) -> None:
            log.append("open")

        async def write(self, command: float) -> None:
            if command:
                with contextlib.suppress(asyncio.CancelledError):
                    await asyncio.sleep(1.0)
                await asyncio.sleep(0.5)
            log.append(command)

    slow = Slow()
    user = user_of("user", slow=esair.writes(float))
    async with esair.Robot(resources=[slow], behaviors=[user]) as robot:
        writing = asyncio.create_task(user.slow.write(1.0))
        await asyncio.sleep(0.01)
        slow.report_lost()
        with pytest.raises(esair.DeviceLostError, match=r"unknown whether 1\.0"):
            await writing
        await asyncio.sleep(1.0)

        assert log == ["open", 0.0, 1.0, "open", 0.0]
        assert robot.resources.query("slow").state is esair.ResourceState.READY


@pytest.mark.fault("D22")
async def test_what_a_gone_device_answers_late_is_no_news(user_of: Any) -> None:
    """An error of a call from before the loss does not take the new device away."""

    class Dying(esair.Actuator[float]):
        safe = 0.0

        async def write(self, command: float) -> None:
            if command:
                try:
                    await asyncio.sleep(1.0)
                finally:
                    await asyncio.sleep(0.3)
                    raise ConnectionError("the old cable")

    dying = Dying()
    user = user_of("user", dying=esair.writes(float))
    async with esair.Robot(resources=[dying], behaviors=[user]) as robot:
        writing = asyncio.create_task(user.dying.write(1.0))
        await asyncio.sleep(0.01)
        dying.report_lost()
        with pytest.raises(esair.DeviceLostError, match="reported that it is gone"):
            await writing
        await asyncio.sleep(1.0)

        assert robot.resources.query("dying").losses == 1


@pytest.mark.promise("AC-4")
@pytest.mark.fault("D29")
async def test_a_safe_command_that_fails_is_tried_again(
    fake_actuator: Any, user_of: Any
) -> None:
    """A passing error does not keep the device moving."""
    wheels = fake_actuator("wheels", safe=0.0)
    user = user_of("user", wheels=esair.writes(float))

    async with esair.Robot(resources=[wheels], behaviors=[user]):
        await user.wheels.write(1.0)
        wheels.fail(OSError("noise"), times=2)
        await asyncio.sleep(0.25)

        assert wheels.commands == [0.0, 1.0, 0.0]


@pytest.mark.fault("D29")
async def test_a_device_that_takes_no_safe_command_is_never_called_safe(
    fake_actuator: Any, user_of: Any, caplog: pytest.LogCaptureFixture
) -> None:
    """An alarm is raised, and it is opened again until it takes its safe command."""
    wheels = fake_actuator("wheels", safe=0.0, command_timeout=0.2)
    wheels.fault_limit = 100
    user = user_of("user", wheels=esair.writes(float))

    async with esair.Robot(resources=[wheels], behaviors=[user]) as robot:
        await user.wheels.write(1.0)
        wheels.fail(OSError("relay welded"), times=None)
        await asyncio.sleep(0.3)
        told = robot.actuators.channels["wheels"].told()
        assert not told.answered
        assert "NOT ANSWERED" in str(told)
        assert robot.resources.query("wheels").state is esair.ResourceState.LOST
        assert any(r.levelno == logging.CRITICAL for r in caplog.records)
        wheels.fail(OSError("relay welded"), times=0)
        await asyncio.sleep(1.0)

        assert wheels.commands == [0.0, 1.0, 0.0]
        assert robot.resources.query("wheels").state is esair.ResourceState.READY


@pytest.mark.promise("ROB-2")
@pytest.mark.fault("D30", "O16")
async def test_one_actuator_that_hangs_does_not_delay_the_others(
    fake_actuator: Any, user_of: Any
) -> None:
    """Twenty are stopped at the same time; nineteen are safe at once."""
    arms = [fake_actuator(f"arm_{n}", safe=0.0) for n in range(20)]
    user = user_of("user", **{arm.name: esair.writes(float) for arm in arms})
    loop = asyncio.get_running_loop()

    async with esair.Robot(resources=arms, behaviors=[user]) as robot:
        for arm in arms:
            await getattr(user, arm.name).write(1.0)
        arms[7].stall()
        began = loop.time()
    took = loop.time() - began

    assert [arm.commands[-1] for arm in arms] == [0.0] * 7 + [1.0] + [0.0] * 12
    assert took < 2.0
    answered = {told.resource: told.answered for told in robot.stopped}
    assert answered == {arm.name: arm is not arms[7] for arm in arms}


@pytest.mark.promise("ROB-2")
async def test_the_stop_reports_each_actuator(fake_actuator: Any, user_of: Any) -> None:
    """What each was told last and whether it answered, also for one that is not there."""
    here, gone = fake_actuator("here", safe=0.0), fake_actuator("gone", safe=0.0)
    gone.unplug()

    async with esair.Robot(resources=[here, gone]) as robot:
        pass

    reports = {told.resource: told for told in robot.stopped}
    assert reports["here"].safe
    assert reports["here"].answered
    assert str(reports["here"]) == "here: safe 0.0: answered"
    assert not reports["gone"].answered


@pytest.mark.promise("RS-1")
@pytest.mark.fault("R01", "R07")
async def test_a_forged_registration_is_refused(
    fake_actuator: Any, user_of: Any
) -> None:
    """Names and numbers grant nothing: the object itself must be in the table."""
    wheels = fake_actuator("wheels", safe=0.0)
    user = user_of("user", wheels=esair.writes(float))

    async with esair.Robot(resources=[wheels], behaviors=[user]) as robot:
        real = user.wheels.registration
        terms = Terms("user", "wheels", esair.Access.WRITE, 1000)
        forged = Registration(real.number, terms)
        tokens: tuple[Any, ...] = (forged, "user", None, 7)
        for token in tokens:
            with pytest.raises(esair.NotRegisteredError):
                await robot.actuators.write(token, 1.0)
        strange = Registration(99, Terms("user", "nowhere", esair.Access.WRITE))
        with pytest.raises(esair.UnknownNameError):
            await robot.actuators.write(strange, 1.0)

        assert wheels.commands == [0.0]


@pytest.mark.fault("R07")
async def test_a_registration_cannot_be_edited(
    fake_actuator: Any, user_of: Any
) -> None:
    """Nobody raises his own priority, or makes a void right valid again."""
    wheels = fake_actuator("wheels", safe=0.0)
    user = user_of("user", wheels=esair.writes(float))

    async with esair.Robot(resources=[wheels], behaviors=[user]) as robot:
        registration = user.wheels.registration
        for field, value in (("priority", 9), ("usable", True), ("behavior", "x")):
            with pytest.raises(AttributeError, match="cannot be changed"):
                setattr(registration, field, value)
        with pytest.raises(AttributeError, match="cannot be changed"):
            del registration.reason
        robot.resources.revoke(registration)
        with pytest.raises(esair.NotRegisteredError):
            await user.wheels.write(1.0)
