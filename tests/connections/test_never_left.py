"""A command that takes an actuator over and then does not leave: nothing moves on."""

from __future__ import annotations

import asyncio
import contextlib
import math
import threading
from collections.abc import AsyncIterator
from typing import Any

import pytest

import esair
from esair.loop import Executor
from esair.testing import FakeActuator, FakeSensor

pytestmark = pytest.mark.real_clock


class Blocking(esair.Actuator[float]):
    """Is written in a thread of its own."""

    safe = 0.0
    command_timeout = 5.0

    def __init__(self) -> None:
        super().__init__(name="motor")
        self.done: list[float] = []

    def write(self, command: float) -> None:
        self.done.append(command)


async def told(commands: list[float], count: int) -> None:
    """Wait until an actuator was told so much."""
    for _ in range(400):
        if len(commands) >= count:
            return
        await asyncio.sleep(0.005)


@contextlib.asynccontextmanager
async def busy(robot: esair.Robot) -> AsyncIterator[threading.Event]:
    """Have the thread of the motor do something else meanwhile."""
    go = threading.Event()
    executor = robot.actuators.channels["motor"].driver.executor
    other = asyncio.create_task(executor.call(go.wait, timeout=5.0))
    await asyncio.sleep(0.02)
    try:
        yield go
    finally:
        go.set()
        await other


def low_and_high(name: str) -> tuple[Any, Any]:
    return (
        esair.Behavior(name="low", writes={name: esair.writes(float)}),
        esair.Behavior(name="high", writes={name: esair.writes(float, priority=9)}),
    )


@pytest.mark.promise("AC-2", "AC-3")
@pytest.mark.parametrize("command", [2.0, 0.0])
@pytest.mark.parametrize("way", ["expired", "cancelled"])
async def test_what_does_not_leave_its_line_ends_the_motion_that_it_took_over(
    way: str, command: float
) -> None:
    """It has held the actuator: the motion of who held it before has nobody any more."""
    motor, (low, high) = Blocking(), low_and_high("motor")
    async with esair.Robot(resources=[motor], behaviors=[low, high]) as robot:
        assert await low.motor.write(1.0)
        async with busy(robot):
            soon = asyncio.get_running_loop().time() + 0.2
            expires = soon if way == "expired" else None
            writing = asyncio.create_task(high.motor.write(command, expires=expires))
            if way == "cancelled":
                await asyncio.sleep(0.05)
                writing.cancel()
            await asyncio.wait({writing}, timeout=4.0)
        assert writing.done()
        await told(motor.done, 3)
        assert motor.done == [0.0, 1.0, 0.0]
        assert low.motor.why().holder is None
        assert await low.motor.write(1.0)


@pytest.mark.promise("AC-2", "AC-3", "PRO-8")
async def test_what_expires_behind_guards_ends_the_motion_that_it_took_over() -> None:
    """It holds nothing, and no guard is asked about it again."""

    class Slow(esair.Reaction):
        eye = esair.reads(float)
        wheels = esair.guards(float)
        takes = 0.0

        def react(self, eye: float, wheels: float) -> float:
            threading.Event().wait(self.takes)
            return min(eye, wheels)

    wheels = FakeActuator("wheels", safe=0.0, command_timeout=5.0)
    eye, slow, (low, high) = FakeSensor("eye", 9.0), Slow(), low_and_high("wheels")
    async with esair.Robot(resources=[wheels, eye], behaviors=[low, high, slow]):
        assert await low.wheels.write(1.0)
        slow.takes = 0.3
        expires = asyncio.get_running_loop().time() + 0.2
        assert not await high.wheels.write(2.0, expires=expires)
        slow.takes = 0.0
        eye.feed(1.5)
        await told(wheels.commands, 3)
        await asyncio.sleep(0.02)
        assert wheels.commands == [0.0, 1.0, 0.0]
        assert low.wheels.why().holder is None


@pytest.mark.promise("AC-2", "CALL-3")
async def test_what_a_full_bus_does_not_take_ends_the_motion_that_it_took_over() -> (
    None
):
    """The device was not asked: tries that end so are no writes."""
    motor, (low, high) = Blocking(), low_and_high("motor")
    async with esair.Robot(resources=[motor], behaviors=[low, high]) as robot:
        assert await low.motor.write(1.0)
        executor = robot.actuators.channels["motor"].driver.executor
        async with busy(robot):
            executor.limit = 1
            waits = asyncio.create_task(executor.call(str, timeout=5.0))
            await asyncio.sleep(0.01)
            with pytest.raises(esair.DriverStuckError, match="no turn"):
                await high.motor.write(2.0)
        await waits
        await told(motor.done, 3)
        assert motor.done == [0.0, 1.0, 0.0]


@pytest.mark.promise("AC-2", "CALL-2")
async def test_what_is_given_up_on_its_way_ends_the_motion_that_it_took_over() -> None:
    """Nobody knows what became of it, however often it is tried."""
    motor = FakeActuator("motor", safe=0.0, command_timeout=5.0)
    low, high = low_and_high("motor")
    async with esair.Robot(resources=[motor], behaviors=[low, high]):
        assert await low.motor.write(1.0)
        motor.slow(0.1)
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.02):
                await high.motor.write(2.0)
        motor.slow(0.0)
        await motor.until(0.0, timeout=2.0)
        assert low.motor.why().holder is None


@pytest.mark.promise("CALL-1", "AC-3")
async def test_a_write_does_not_wait_for_its_turn_for_ever() -> None:
    """The one before it is given up in a thread's line, and keeps its place there."""
    motor, (low, _) = Blocking(), low_and_high("motor")
    motor.deadline = 0.2
    async with esair.Robot(resources=[motor], behaviors=[low]) as robot:
        async with busy(robot):
            writes = [asyncio.create_task(low.motor.write(n)) for n in (1.0, 2.0)]
            _, late = await asyncio.wait(writes, timeout=4.0)
            assert not late
            for each in writes:
                with pytest.raises(esair.DriverStuckError, match="got no turn"):
                    await each
        await asyncio.sleep(0.05)
        assert set(motor.done) == {0.0}


class Patient(Blocking):
    """Waits for its turn on a line by itself, in the loop."""

    async def write(self, command: float) -> None:  # type: ignore[override]
        await self._line.call(self.done.append, command, timeout=5.0)

    @property
    def _line(self) -> Executor:
        if not hasattr(self, "line"):
            self.line = Executor("line")
        return self.line


@pytest.mark.promise("CALL-1", "CALL-2")
@pytest.mark.parametrize("way", ["safe", "cancelled", "late", "expired"])
async def test_what_is_given_up_in_a_line_is_never_begun(way: str) -> None:
    """Also where a driver waits for its turn by itself: its caller was told so."""
    motor, (low, _), go = Patient(), low_and_high("motor"), threading.Event()
    motor.deadline = 0.2 if way == "late" else 5.0
    async with esair.Robot(resources=[motor], behaviors=[low]) as robot:
        other = asyncio.create_task(motor.line.call(go.wait, timeout=5.0))
        await asyncio.sleep(0.02)
        soon = asyncio.get_running_loop().time() + 0.2 if way == "expired" else None
        writing = asyncio.create_task(low.motor.write(1.0, expires=soon))
        await asyncio.sleep(0.02)
        if way == "safe":
            robot.actuators.channels["motor"].make_safe()
        elif way == "cancelled":
            writing.cancel()
        await asyncio.wait({writing}, timeout=4.0)
        go.set()
        await other
        await told(motor.done, 2)
        assert writing.done()
        assert await low.motor.write(0.0, expires=math.inf)
    motor.line.close()
    assert set(motor.done) == {0.0}
