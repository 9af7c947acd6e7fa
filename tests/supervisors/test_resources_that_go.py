"""What becomes of an action whose resources come and go."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest
from tests.supervisors.actors import Driver, Idle, State, wheels

import esair
from esair.supervisors._grants import Step
from esair.testing import FakeActuator, FakeSensor

pytestmark = pytest.mark.virtual_clock


@pytest.mark.fault("L07")
async def test_a_reaction_parks_when_its_sensor_is_removed_and_comes_back() -> None:
    """It gives its actuator back, and is bound anew to the sensor that comes."""
    device, sonar = wheels(), FakeSensor("sonar", 1.0)

    class Follow(esair.Reaction):
        sonar = esair.reads(float)
        wheels = esair.writes(float)

        def react(self, sonar: float) -> float:
            return sonar

    async with esair.Robot(resources=[device, sonar], behaviors=[Follow()]) as robot:
        await device.until(1.0)
        await robot.resources.remove("sonar")
        await device.until(0.0)
        assert robot.behaviors.query("follow").state is State.PARKED
        assert "sonar" in robot.behaviors.query("follow").detail
        await robot.resources.add(FakeSensor("sonar", 2.0))
        await device.until(2.0)
        assert robot.behaviors.query("follow").state is State.RUNNING


@pytest.mark.promise("SUP-5")
@pytest.mark.fault("B02")
async def test_a_behavior_whose_device_is_lost_waits_for_it() -> None:
    """An absent device is not the behavior's fault: its budget stays whole."""
    device = wheels()
    async with esair.Robot(resources=[device], behaviors=[Driver()]) as robot:
        await asyncio.sleep(0.1)
        for _ in range(5):
            device.unplug()
            await asyncio.sleep(0.2)
            assert robot.behaviors.query("driver").state is State.PARKED
            device.plug()
            await device.until(1.0)
        assert robot.behaviors.query("driver").restarts == 0


@pytest.mark.promise("SUP-5")
@pytest.mark.fault("B02")
async def test_a_loss_in_a_task_of_a_behavior_is_not_its_fault_either() -> None:
    """Its task group raises the same as a group."""
    device = wheels()

    class Grouped(esair.Behavior):
        wheels = esair.writes(float)

        async def run(self) -> None:
            async with asyncio.TaskGroup() as tasks:
                tasks.create_task(self.drive())

        async def drive(self) -> None:
            async for _ in esair.every(0.05):
                await self.wheels.write(1.0)

    async with esair.Robot(resources=[device], behaviors=[Grouped()]) as robot:
        for _ in range(5):
            await device.until(1.0)
            device.unplug()
            await asyncio.sleep(2.0)
            assert robot.behaviors.query("grouped").state is State.PARKED
            device.plug()
        assert robot.behaviors.query("grouped").restarts == 0


@pytest.mark.promise("SUP-4")
async def test_a_fault_of_one_device_does_not_wait_for_another() -> None:
    """It can do without what is not there: it is restarted by its policy."""
    device, gps = wheels(), FakeSensor("gps", 1.0)

    class Roam(Driver):
        gps = esair.reads(float)

    gps.unplug()
    async with esair.Robot(resources=[device, gps], behaviors=[Roam()]) as robot:
        await device.until(1.0)
        device.fail(OSError("glitch"))
        await asyncio.sleep(1.0)
        status = robot.behaviors.query("roam")
        assert (status.state, status.restarts) == (State.RUNNING, 1)


@pytest.mark.promise("SUP-5")
async def test_a_removed_resource_tells_its_users_at_once() -> None:
    """Waiting reads end at once, and the actuator is safe before it is gone."""
    device = wheels()
    sonar: FakeSensor[float] = FakeSensor("sonar")
    told: list[BaseException] = []

    class Both(esair.Behavior):
        sonar = esair.reads(float)
        wheels = esair.writes(float)

        async def run(self) -> None:
            await self.wheels.write(1.0, hold=9.0)
            try:
                await self.sonar.read(timeout=60.0)
            except esair.ResourceRemovedError as error:
                told.append(error)
            try:
                await self.wheels.write(2.0)
            except esair.ResourceRemovedError as error:
                told.append(error)

    loop = asyncio.get_running_loop()
    async with esair.Robot(resources=[device, sonar], behaviors=[Both()]) as robot:
        await device.until(1.0)
        await robot.resources.remove("wheels")
        assert device.commands[-1] == 0.0
        await robot.resources.remove("sonar")
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        assert [type(error) for error in told] == [esair.ResourceRemovedError] * 2
        assert loop.time() < 0.5


class Follow(esair.Reaction):
    """Writes what it reads."""

    sonar = esair.reads(float)
    wheels = esair.writes(float)

    def react(self, sonar: float) -> float:
        return sonar


async def test_a_reaction_can_be_added_and_replaced() -> None:
    """A reaction is a component like any other."""
    device, sonar = wheels(), FakeSensor("sonar", 1.0)
    async with esair.Robot(resources=[device, sonar]) as robot:
        await robot.behaviors.add(Follow())
        await device.until(1.0)

        class Double(Follow):
            def react(self, sonar: float) -> float:
                return 2 * sonar

        await robot.behaviors.replace("follow", Double())
        await device.until(2.0)
        await robot.behaviors.remove("follow")
        assert device.commands[-1] == 0.0


async def test_a_reaction_is_left_alone_by_changes_of_other_resources() -> None:
    """It keeps its registrations and its steps."""
    device, sonar = wheels(), FakeSensor("sonar", 1.0)
    async with esair.Robot(resources=[device, sonar], behaviors=[Follow()]) as robot:
        await device.until(1.0)
        before = set(robot._resources.registrations.live)
        await robot.resources.add(FakeSensor("other", 1.0))
        assert set(robot._resources.registrations.live) == before


async def test_a_reaction_whose_sensor_becomes_an_actuator_waits() -> None:
    """It cannot be bound to what took the place of its sensor; that is visible."""
    device, sonar = wheels(), FakeSensor("sonar", 1.0)
    async with esair.Robot(resources=[device, sonar], behaviors=[Follow()]) as robot:
        await device.until(1.0)
        await robot.resources.replace("sonar", FakeActuator("sonar", safe=0.0))
        await asyncio.sleep(5.0)
        status = robot.behaviors.query("follow")
        assert status.state is State.PARKED
        assert status.detail.startswith("it reads 'sonar', which is an actuator")
        assert device.commands[-1] == 0.0


async def test_a_reaction_that_says_its_device_is_lost_has_failed() -> None:
    """Only behaviors ask devices; a reaction's error is its own."""

    class Bad(Follow):
        restart = esair.Restart(max=0)

        def react(self, sonar: float) -> float:
            raise esair.DeviceLostError("sonar")

    device, sonar = wheels(), FakeSensor("sonar", 1.0)
    async with esair.Robot(resources=[device, sonar], behaviors=[Bad()]) as robot:
        await asyncio.sleep(1.0)
        assert robot.behaviors.query("bad").state is State.FAILED


async def test_the_first_end_of_a_performed_reaction_counts() -> None:
    """What comes in the same tick changes nothing any more."""
    device, sonar = wheels(), FakeSensor("sonar", 1.0)
    idle = Idle()
    async with esair.Robot(resources=[device, sonar], behaviors=[idle]) as robot:
        performing = asyncio.ensure_future(idle.perform(Follow()))
        await device.until(1.0)
        (perform,) = robot._behaviors.members["idle"].steps
        assert isinstance(perform, Step)
        perform.end(True)
        perform.end(False)
        perform.crash(RuntimeError("late"))
        assert await performing is True


async def test_query_tells_why_a_behavior_is_parked() -> None:
    """The detail is part of the answer."""
    device = wheels()
    async with esair.Robot(resources=[device], behaviors=[Driver()]) as robot:
        await asyncio.sleep(0.1)
        device.unplug()
        await asyncio.sleep(0.2)
        assert "wheels is not there" in await robot.behaviors.command("query driver")


@pytest.mark.promise("SC-1")
@pytest.mark.parametrize("seconds", [-1.0, 0.0, float("nan"), "x"])
async def test_a_bad_time_limit_of_a_read_is_refused_always(seconds: Any) -> None:
    """Also where the newest reading is good enough and nobody would wait."""

    class Reads(esair.Behavior):
        sonar = esair.reads(float)

    behavior = Reads()
    async with esair.Robot(resources=[FakeSensor("sonar", 1.0)], behaviors=[behavior]):
        assert await behavior.sonar.read() == 1.0
        with pytest.raises(esair.BadValueError, match="timeout"):
            await behavior.sonar.read(timeout=seconds)


class Watch(esair.Behavior):
    """Writes what it reads, and catches nothing."""

    sonar = esair.reads(float, max_age=0.5)
    wheels = esair.writes(float)

    async def run(self) -> None:
        async for _ in esair.every(0.05):
            await self.wheels.write(await self.sonar.read())


def pushing() -> FakeSensor[float]:
    """Make a sensor that says something when it is fed, every second at least."""
    sonar: FakeSensor[float] = FakeSensor("sonar", type=float)
    sonar.period = 1.0
    return sonar


@pytest.mark.promise("RES-3", "SUP-4")
async def test_a_behavior_whose_sensor_is_silent_waits_for_its_next_reading() -> None:
    """Silence is not its fault: it spends no restart, and goes on by itself."""
    device, sonar = wheels(), pushing()
    async with esair.Robot(resources=[device, sonar], behaviors=[Watch()]) as robot:
        for value in (1.0, 2.0, 3.0, 4.0, 5.0):
            sonar.feed(value)
            await device.until(value)
            await asyncio.sleep(0.7)
            status = robot.behaviors.query("watch")
            assert (status.state, status.detail) == (State.PARKED, "sonar is silent")
            assert device.commands[-1] == 0.0
        assert status.restarts == 0


@pytest.mark.promise("RES-3", "SUP-4")
async def test_silence_that_becomes_a_loss_ends_with_it() -> None:
    """It waits for what is missing last, also if others come back before."""
    device, sonar = wheels(), pushing()
    async with esair.Robot(resources=[device, sonar], behaviors=[Watch()]) as robot:
        sonar.feed(1.0)
        await device.until(1.0)
        await asyncio.sleep(0.7)
        device.unplug()
        await asyncio.sleep(0.2)
        device.plug()
        await asyncio.sleep(1.0)
        assert robot.behaviors.query("watch").state is State.PARKED
        sonar.unplug()
        await asyncio.sleep(1.0)
        sonar.plug()
        await asyncio.sleep(0.5)
        assert robot.behaviors.query("watch").state is State.RUNNING
        sonar.feed(2.0)
        await device.until(2.0)


@pytest.mark.promise("RES-3", "SUP-4")
async def test_who_has_heard_its_sensor_waits_for_the_rest_only() -> None:
    """The sensor spoke while another device was missing: it need not speak again."""
    device, sonar = wheels(), pushing()
    async with esair.Robot(resources=[device, sonar], behaviors=[Watch()]) as robot:
        sonar.feed(1.0)
        await device.until(1.0)
        await asyncio.sleep(0.7)
        device.unplug()
        await asyncio.sleep(0.2)
        sonar.feed(2.0)
        await asyncio.sleep(0.1)
        assert robot.behaviors.query("watch").state is State.PARKED
        device.plug()
        await asyncio.sleep(0.3)
        assert robot.behaviors.query("watch").state is State.RUNNING


@pytest.mark.promise("SUP-4")
async def test_a_limit_of_its_own_that_no_reading_can_meet_is_its_fault() -> None:
    """Asked for what is not promised, a sensor is not silent: that is a crash."""

    class Hasty(Watch):
        restart = esair.Restart(max=0)

        async def run(self) -> None:
            await asyncio.sleep(0.1)
            await self.sonar.read(max_age=0.01)

    device, sonar = wheels(), pushing()
    async with esair.Robot(resources=[device, sonar], behaviors=[Hasty()]) as robot:
        sonar.feed(1.0)
        await asyncio.sleep(0.2)
        assert robot.behaviors.query("hasty").state is State.FAILED


@pytest.mark.promise("RS-3")
async def test_a_right_of_a_run_that_has_ended_names_its_resource() -> None:
    """What it was used for says which device, not "resource"."""
    device, driver = wheels(), Driver()
    async with esair.Robot(resources=[device], behaviors=[driver]) as robot:
        await device.until(1.0)
        port: Any = driver.wheels
        await robot.behaviors.restart("driver")
        with pytest.raises(esair.NotRegisteredError, match="uses 'wheels'"):
            raise port.registration.reason()


@pytest.mark.promise("RES-3", "SUP-4")
async def test_silence_that_a_task_of_its_own_meets_is_silence() -> None:
    """It comes in a group of errors then."""

    class Group(Watch):
        async def run(self) -> None:
            async with asyncio.TaskGroup() as group:
                group.create_task(super().run())

    device, sonar = wheels(), pushing()
    async with esair.Robot(resources=[device, sonar], behaviors=[Group()]) as robot:
        sonar.feed(1.0)
        await device.until(1.0)
        await asyncio.sleep(0.7)
        status = robot.behaviors.query("group")
        assert (status.state, status.detail) == (State.PARKED, "sonar is silent")


@pytest.mark.promise("BS-4", "BS-10")
async def test_who_waits_for_one_that_is_parked_hears_that_it_has_failed() -> None:
    """Not at the end of the interval: who knows when the sensor is back."""
    device, sonar = wheels(), FakeSensor("sonar", 1.0, rate=20.0)
    asks = esair.Behavior(name="asks")
    actors = [Watch(), asks]
    async with esair.Robot(resources=[device, sonar], behaviors=actors) as robot:
        getting = asyncio.ensure_future(asks.get("watch", interval=60.0))
        await asyncio.sleep(0.5)
        sonar.unplug()
        async with asyncio.timeout(1.0):
            with pytest.raises(esair.BehaviorFailedError, match="sonar"):
                await getting
        assert robot.behaviors.query("watch").state is State.PARKED
