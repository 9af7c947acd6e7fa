"""Drivers whose plain methods do not block: called in the loop, with all that holds."""

from __future__ import annotations

import asyncio
import math
import threading
from collections.abc import Awaitable
from typing import Any

import pytest

import esair

pytestmark = [pytest.mark.virtual_clock, pytest.mark.promise("RES-1")]


class Register(esair.Actuator[float]):
    """A register in memory: it notes what it was told, and on which thread."""

    blocking = False
    safe = 0.0
    limits = (-1.0, 1.0)
    fails = False

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.log: list[Any] = []
        self.threads: set[int] = set()

    def open(self) -> None:
        self.log.append("open")

    def close(self) -> None:
        self.log.append("close")

    def write(self, command: float) -> None:
        self.threads.add(threading.get_ident())
        if self.fails and command:
            raise OSError("no acknowledge")
        self.log.append(command)


class Counter(esair.Sensor[float]):
    """A counter in memory."""

    blocking = False
    rate = 10.0
    value = 1.0

    def read(self) -> float:
        return self.value


async def test_they_are_called_in_the_loop_from_open_to_close(user_of: Any) -> None:
    """No thread is made for them, and safe is the last command on the wire."""
    register, user = (
        Register(),
        user_of("user", cell=esair.writes(float, name="register")),
    )
    async with esair.Robot(resources=[register], behaviors=[user]):
        assert await user.cell.write(0.5)
        assert not [each for each in threading.enumerate() if "register" in each.name]
    assert register.log[:3] == ["open", 0.0, 0.5]
    assert register.log[-2:] == [0.0, "close"]
    assert register.threads == {threading.get_ident()}


async def test_a_reading_is_there_without_a_turn_of_the_loop(user_of: Any) -> None:
    """It is asked within the call of who asks for it."""
    counter = Counter()
    user = user_of("user", counter=esair.reads(float))
    async with esair.Robot(resources=[counter], behaviors=[user]):
        counter.value = 7.0
        assert await user.counter.read(fresh=True) == 7.0


@pytest.mark.promise("AC-1", "AC-2")
async def test_what_is_checked_for_others_is_checked_for_them(user_of: Any) -> None:
    """Limits, NaN, priority, and the time without a write."""
    register = Register()
    user = user_of("user", cell=esair.writes(float, name="register"))
    strong = user_of("strong", cell=esair.writes(float, name="register", priority=5))
    async with esair.Robot(resources=[register], behaviors=[user, strong]):
        for bad in (math.nan, 2.0, "0.5"):
            with pytest.raises(esair.BadValueError):
                await user.cell.write(bad)
        assert await strong.cell.write(0.5)
        assert not await user.cell.write(0.1)
        await asyncio.sleep(1.0)
        assert register.log == ["open", 0.0, 0.5, 0.0]


async def test_what_they_raise_is_a_fault_of_the_device(user_of: Any) -> None:
    """With the cause; what leaves next is what is asked next."""
    register, user = (
        Register(),
        user_of("user", cell=esair.writes(float, name="register")),
    )
    async with esair.Robot(resources=[register], behaviors=[user]):
        register.fails = True
        with pytest.raises(esair.DeviceFaultError, match="no acknowledge"):
            await user.cell.write(0.5)
        register.fails = False
        assert await user.cell.write(0.4)
        assert register.log[-1] == 0.4


async def test_what_they_return_is_awaited_if_it_can_be(user_of: Any) -> None:
    """A plain method may hand on the coroutine of another object."""

    class Handed(Register):
        def write(self, command: float) -> Any:  # type: ignore[override]
            return self._later(command)

        async def _later(self, command: float) -> None:
            await asyncio.sleep(0.1)
            self.log.append(command)

    register, user = (
        Handed(name="register"),
        user_of("user", cell=esair.writes(float, name="register")),
    )
    async with esair.Robot(resources=[register], behaviors=[user]):
        written = await user.cell.write(0.5)
        assert written
        assert register.log[-1] == 0.5


@pytest.mark.promise("ROB-5")
async def test_what_they_start_belongs_to_nobody_who_happens_to_write() -> None:
    """It goes on when the behavior has ended, as what other drivers start does."""
    tasks: list[asyncio.Task[None]] = []

    class Starter(Register):
        def write(self, command: float) -> None:
            if command:
                tasks.append(asyncio.create_task(asyncio.sleep(60.0)))

    class Once(esair.Behavior):
        starter = esair.writes(float)

        async def run(self) -> None:
            await self.starter.write(0.5)

    async with esair.Robot(resources=[Starter()], behaviors=[Once()]) as robot:
        await asyncio.sleep(0.5)
        await robot.behaviors.remove("once")
        assert [task.done() for task in tasks] == [False]
    tasks[0].cancel()


class Handed(esair.Actuator[float]):
    """Its plain method hands out what there is to await, as a wrapper does."""

    safe = 0.0

    def __init__(self, pause: float = 0.0) -> None:
        super().__init__(name="handed")
        self.pause = pause
        self.log: list[float] = []

    def write(self, command: float) -> Awaitable[None]:  # type: ignore[override]
        return self.later(command)

    async def later(self, command: float) -> None:
        if self.pause:
            await asyncio.sleep(self.pause)
        if command > 1.0:
            raise OSError("no acknowledge")
        self.log.append(command)


@pytest.mark.parametrize("pause", [0.0, 0.05])
async def test_what_a_method_on_a_thread_hands_out_is_awaited(
    user_of: Any, pause: float
) -> None:
    """In the loop, whether it ends at once or later; its error is the driver's."""
    handed, user = Handed(pause), user_of("user", handed=esair.writes(float))
    async with esair.Robot(resources=[handed], behaviors=[user]):
        assert await user.handed.write(0.5)
        assert handed.log[-1] == 0.5
        with pytest.raises(esair.DeviceFaultError, match="no acknowledge"):
            await user.handed.write(2.0)
    assert handed.log[-1] == 0.0


async def test_what_a_method_hands_out_has_the_drivers_deadline(user_of: Any) -> None:
    """It is cancelled then, as any call of a driver."""
    handed, user = Handed(), user_of("user", handed=esair.writes(float))
    async with esair.Robot(resources=[handed], behaviors=[user]):
        handed.pause = 100.0
        with pytest.raises(esair.DriverStuckError):
            await user.handed.write(0.5)
        handed.pause = 0.0
    assert 0.5 not in handed.log
