"""Code that outlives the run of its behavior speaks for nobody."""

from __future__ import annotations

import asyncio
import contextlib
import contextvars
import threading
import time

import pytest
from tests.supervisors.actors import Idle, State

import esair
from esair.testing import FakeSensor

pytestmark = pytest.mark.virtual_clock


@pytest.mark.promise("SUP-4")
@pytest.mark.fault("R14", "B10")
async def test_what_outlives_a_crash_speaks_for_nobody(fake_actuator):
    """A task of the run before finds the ports of the next one, and may not use them."""
    wheels = fake_actuator("wheels", safe=0.0)
    go = asyncio.Event()
    errors: list[Exception] = []

    class Job(esair.Request[int]):
        pass

    class Drive(esair.Behavior):
        wheels = esair.writes(float, configure=True)
        jobs = esair.takes(Job)
        inbox_size = 4
        runs = 0

        async def run(self) -> None:
            self.runs += 1
            if self.runs == 1:
                self.left = asyncio.create_task(self.stay())
                await asyncio.sleep(0.01)
                raise RuntimeError("crash")
            await asyncio.Event().wait()

        async def stay(self) -> None:
            while not go.is_set():
                with contextlib.suppress(asyncio.CancelledError):
                    await go.wait()
            for attempt in (
                lambda: self.wheels.write(1.0),
                self.wheels.configure,
                self.receive,
                lambda: self.put("drive", "from the dead"),
                lambda: self.get("other"),
                lambda: self.register("wheels", esair.Access.WRITE),
                lambda: self.perform(Nothing()),
                lambda: anext(aiter(self.jobs)),
                lambda: self.wheels.operate("home"),
            ):
                try:
                    await attempt()
                except esair.NotRegisteredError as error:
                    errors.append(error)
            try:
                self.offer("from the dead")
            except esair.NotRegisteredError as error:
                errors.append(error)

    class Nothing(esair.Reaction):
        rate = 1.0

        def react(self) -> None:
            return None

    drive = Drive()
    async with esair.Robot(resources=[wheels], behaviors=[drive, Idle(name="other")]):
        await asyncio.sleep(5.0)
        assert drive.runs == 2
        await drive.put("drive", "for the living")
        go.set()
        await drive.left
        assert len(errors) == 10
        assert all("has ended" in str(error) for error in errors)
        assert wheels.commands == [0.0]
        assert await drive.wheels.write(2.0)
        assert await drive.receive() == "for the living"


@pytest.mark.real_clock
@pytest.mark.promise("SUP-4")
@pytest.mark.fault("R14", "B14")
async def test_a_thread_that_outlives_a_crash_speaks_for_nobody(fake_actuator):
    """The same for a behavior whose run is a plain function."""
    wheels = fake_actuator("wheels", safe=0.0)
    go = threading.Event()
    errors: list[Exception] = []

    class Drive(esair.Behavior):
        wheels = esair.writes(float)
        runs = 0

        def run(self) -> None:
            self.runs += 1
            if self.runs == 1:
                context = contextvars.copy_context()
                self.left = threading.Thread(target=context.run, args=(self.stay,))
                self.left.start()
                raise RuntimeError("crash")
            go.wait(10.0)
            while len(errors) < 2:
                time.sleep(0.005)

        def stay(self) -> None:
            while self.runs < 2:
                time.sleep(0.005)
            for attempt in (
                lambda: self.wheels.write(1.0),
                lambda: self.put("drive", "from the dead"),
            ):
                try:
                    attempt()
                except esair.BehaviorRemovedError as error:
                    errors.append(error)
            go.set()

    drive = Drive()
    drive.restart = esair.Restart(max=3, within=30.0)
    async with esair.Robot(resources=[wheels], behaviors=[drive]) as robot:
        for _ in range(2000):
            if robot.behaviors.query("drive").state is State.FINISHED:
                break
            await asyncio.sleep(0.005)
        drive.left.join(5.0)

    assert len(errors) == 2
    assert set(wheels.commands) == {0.0}


async def test_what_has_failed_for_good_says_so_to_its_own_code() -> None:
    """Whoever still acts in its name hears that it failed, not that it was removed."""

    class Fails(esair.Behavior):
        restart = esair.Restart(max=0)

        async def run(self) -> None:
            raise RuntimeError("no")

    behavior = Fails()
    async with esair.Robot(behaviors=[behavior]) as robot:
        await asyncio.sleep(0.1)
        assert robot.behaviors.query("fails").state is esair.BehaviorState.FAILED
        for work in (behavior.get("fails"), behavior.put("fails", 1)):
            with pytest.raises(esair.BehaviorFailedError, match="RuntimeError: no"):
                await work
        with pytest.raises(esair.BehaviorFailedError, match="RuntimeError: no"):
            behavior.offer(1)


async def test_a_clean_up_has_its_grace_whoever_ends_the_behavior_again() -> None:
    """A stop during a removal cancels it no second time before that is over."""
    told: list[str] = []

    class Cleans(esair.Behavior):
        async def run(self) -> None:
            try:
                await asyncio.sleep(1000.0)
            finally:
                try:
                    await asyncio.sleep(0.5)
                    told.append("clean")
                except asyncio.CancelledError:
                    told.append("cut off")
                    raise

    async with esair.Robot(behaviors=[Cleans()], grace=1.0) as robot:
        await asyncio.sleep(0.1)
        removal = asyncio.create_task(robot.behaviors.remove("cleans"))
        await asyncio.sleep(0.2)
        await robot.stop("a test")
        await asyncio.wait({removal})
    assert told == ["clean"]


async def test_the_tasks_of_a_behavior_end_with_its_run() -> None:
    """Also where that has returned: nothing of it goes on."""
    ended: list[bool] = []

    async def child() -> None:
        try:
            await asyncio.sleep(1000.0)
        finally:
            ended.append(True)

    class Parent(esair.Behavior):
        async def run(self) -> None:
            self.child = asyncio.create_task(child())
            await asyncio.sleep(0.1)

    async with esair.Robot(behaviors=[Parent(), Idle(name="other")]) as robot:
        await asyncio.sleep(0.2)
        state = robot.behaviors.query("parent").state
        assert (state, ended) == (esair.BehaviorState.FINISHED, [True])


@pytest.mark.promise("RS-3", "SUP-3")
async def test_a_sensor_is_asked_no_more_for_one_that_was_removed() -> None:
    """Also if that does not end in the middle of its loop over the readings."""

    class Deaf(esair.Behavior):
        sonar = esair.reads(float)

        async def run(self) -> None:
            async for _ in self.sonar:
                until = esair.now() + 10.0
                while (left := until - esair.now()) > 0:
                    with contextlib.suppress(asyncio.CancelledError):
                        await asyncio.sleep(left)

    sonar = FakeSensor("sonar", 1.0, rate=20.0)
    async with esair.Robot(resources=[sonar], behaviors=[Deaf()]) as robot:
        await asyncio.sleep(1.0)
        await robot.behaviors.remove("deaf")
        asked = sonar.reads
        assert asked > 10
        await asyncio.sleep(1.0)
        assert sonar.reads == asked
