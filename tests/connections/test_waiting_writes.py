"""Writes that wait for their turn: what becomes of them meanwhile."""

from __future__ import annotations

import asyncio
import threading
from typing import Any

import pytest

import esair
from esair.buses import Bus
from esair.journal import Event, Kind
from esair.loop import Deadlines
from esair.testing import FakeActuator, FakeSensor

pytestmark = [pytest.mark.virtual_clock, pytest.mark.promise("AC-1")]


class Motor(FakeActuator[float]):
    """A motion takes it a second, unless it is told otherwise."""

    deadline = 5.0

    def __init__(self) -> None:
        super().__init__("motor", safe=0.0, command_timeout=5.0)
        self.slow(1.0)


async def soon() -> None:
    await asyncio.sleep(0.01)


async def test_one_that_the_device_refuses_at_once_is_told_why(user_of: Any) -> None:
    """Its turn comes when nobody awaits the driver; the next one has its turn too."""

    class Picky(Motor):
        def write(self, command: float) -> Any:
            if command == 2.0:
                raise ValueError("not two")
            return super().write(command)

    motor, user = Picky(), user_of("user", motor=esair.writes(float))
    async with esair.Robot(resources=[motor], behaviors=[user]):
        writes = [asyncio.create_task(user.motor.write(n)) for n in (1.0, 2.0, 3.0)]
        await soon()
        motor.slow(0.0)
        with pytest.raises(esair.DeviceFaultError, match="not two"):
            await writes[1]
        assert (await writes[2]).command == 3.0
        await writes[0]


async def test_one_that_is_cancelled_in_its_turn_leaves_it_to_the_next(
    user_of: Any,
) -> None:
    """In the very instant in which the device is free; nothing of it is sent."""
    motor, user = Motor(), user_of("user", motor=esair.writes(float))

    class Cancels(Motor):
        async def write(self, command: float) -> None:
            await super().write(command)
            if command == 1.0:
                writes[1].cancel()

    motor = Cancels()
    async with esair.Robot(resources=[motor], behaviors=[user]):
        writes = [asyncio.create_task(user.motor.write(n)) for n in (1.0, 2.0, 3.0)]
        await asyncio.wait(writes)
        assert writes[1].cancelled()
        assert writes[2].result()
        assert motor.commands == [0.0, 1.0, 3.0]


@pytest.mark.real_clock
@pytest.mark.parametrize("way", ["safe", "halted", "cancelled", "expired", "stopped"])
async def test_one_that_waits_in_a_thread_is_overtaken_by_safe(
    way: str, user_of: Any
) -> None:
    """Who wrote it is told so, also if the halt is over; it never reaches the device."""
    go, done = threading.Event(), list[float]()

    class Blocking(esair.Actuator[float]):
        safe = 0.0
        deadline = command_timeout = 30.0

        def write(self, command: float) -> None:
            done.append(command)

    class Slow(esair.Sensor[float]):
        deadline = 30.0

        def read(self) -> float:
            go.wait(30.0)
            return 1.0

    class Wire(Bus):
        """Both devices have one thread."""

        async def _open(self) -> None: ...

        async def _close(self) -> None: ...

    wire = Wire(name="wire")
    user = user_of("user", motor=esair.writes(float), eye=esair.reads(float))
    robot = esair.Robot(
        resources=[Blocking(name="motor", bus=wire), Slow(name="eye", bus=wire)],
        behaviors=[user],
    )
    told: list[Event] = []
    robot.journal.listen(told.append, kinds=[Kind.SENT, Kind.REFUSED])
    async with robot:
        reading = asyncio.create_task(user.eye.read())
        await asyncio.sleep(0.05)
        ends = way in {"expired", "stopped"}
        soon = asyncio.get_running_loop().time() + 0.05 if ends else None
        writing = asyncio.create_task(user.motor.write(1.0, expires=soon))
        await asyncio.sleep(0.06 if way != "stopped" else 0.01)
        if way == "stopped":  # the process, amid a turn: its clock stands still
            assert not threading.Event().wait(0.06)
            go.set()
            assert not threading.Event().wait(0.1)
        elif way == "cancelled":
            writing.cancel()
            await asyncio.wait({writing})
        elif way == "safe":
            robot.actuators.channels["motor"].make_safe()
        elif way == "halted":
            robot.halt("enough")
            robot.resume()
        go.set()
        if way == "cancelled":
            with pytest.raises(asyncio.CancelledError):
                await writing
        else:
            refused = await writing
            why = {
                "safe": "made safe, or this expired, before",
                "halted": "before the robot was",
                "expired": "made safe, or this expired, before",
                "stopped": "made safe, or this expired, before",
            }
            assert not refused
            assert why[way] in refused.rule
        await reading
        assert await user.motor.write(2.0)
    assert 1.0 not in done
    assert 2.0 in done
    about = [each.kind for each in told if each.peer == "user"]
    assert about == [Kind.SENT, Kind.REFUSED, Kind.SENT]  # also if who asked has gone


async def test_a_command_that_cannot_be_copied_is_told_as_it_is(user_of: Any) -> None:
    """An object of any class may be a command."""

    class Stubborn:
        single = False

        def __deepcopy__(self, _memo: object) -> Any:
            if self.single:
                raise TypeError("one of a kind")
            return self

    oven = FakeActuator("oven", safe=Stubborn())
    user, told = user_of("user", oven=esair.writes(Stubborn)), list[Event]()
    async with esair.Robot(resources=[oven], behaviors=[user]) as robot:
        robot.journal.listen(told.append)
        command = Stubborn()
        command.single = True
        robot.halt("a test")
        assert not await user.oven.write(command)
        await soon()
    (asked,) = [each for each in told if each.kind is Kind.COMMAND]
    assert asked.value is command


async def test_one_that_has_expired_leaves_no_more(user_of: Any) -> None:
    """Neither after a wait, nor at once: the moment in which it would leave counts."""
    motor, user = Motor(), user_of("user", motor=esair.writes(float))
    async with esair.Robot(resources=[motor], behaviors=[user]):
        now = asyncio.get_running_loop().time()
        writes = [
            asyncio.create_task(user.motor.write(value, expires=now + seconds))
            for value, seconds in ((1.0, 0.5), (2.0, 0.5), (3.0, 1.5))
        ]
        first, second, third = await asyncio.gather(*writes)
        assert first
        assert third
        assert not second
        assert "expired" in second.rule
        assert not await user.motor.write(4.0, expires=now)
        assert motor.commands == [0.0, 1.0, 3.0]


async def test_one_that_expires_in_an_hour_is_not_kept_so_long(user_of: Any) -> None:
    """Once the device has it, nothing waits for that moment."""
    motor, user = Motor(), user_of("user", motor=esair.writes(float))
    motor.slow(0.001)
    async with esair.Robot(resources=[motor], behaviors=[user]):
        loop = asyncio.get_running_loop()
        before, hour = len(Deadlines.of(loop).waiting), loop.time() + 3600.0
        for number in range(50):
            assert await user.motor.write(float(number), expires=hour)
        assert len(Deadlines.of(loop).waiting) < before + 10


async def test_one_that_has_lost_meanwhile_is_refused_when_its_time_is_over(
    user_of: Any,
) -> None:
    """A higher priority has had the device all the time: that is an answer, no error."""
    motor, low = Motor(), user_of("low", motor=esair.writes(float))
    high = user_of("high", motor=esair.writes(float, priority=9))
    motor.deadline = 1.2
    async with esair.Robot(resources=[motor], behaviors=[low, high]):
        first = asyncio.create_task(low.motor.write(1.0))
        await soon()
        loses = asyncio.create_task(low.motor.write(2.0))
        wins = asyncio.create_task(high.motor.write(3.0))
        began = esair.now()
        refused = await loses
        assert not refused
        assert refused.holder == "high"
        assert esair.now() - began < motor.deadline + 0.1  # the device is busy still
        assert await first
        assert await wins
    assert 2.0 not in motor.commands


async def test_one_that_meets_a_safe_command_has_its_time_after_that(
    user_of: Any,
) -> None:
    """The device takes its time for both; neither is late."""
    motor, user = Motor(), user_of("user", motor=esair.writes(float))
    motor.deadline = 1.2
    async with esair.Robot(resources=[motor], behaviors=[user]) as robot:
        first = asyncio.create_task(user.motor.write(1.0))
        await soon()
        waits = asyncio.create_task(user.motor.write(2.0))
        await asyncio.sleep(0.8)
        robot.actuators.channels["motor"].make_safe()
        assert await waits
        assert await first
        assert motor.commands == [0.0, 1.0, 0.0, 2.0]


async def test_one_that_meets_a_safe_command_that_hangs_waits_no_longer(
    user_of: Any,
) -> None:
    """It has its time once more, as long as that may take, and then no other."""

    class Hangs(Motor):
        async def write(self, command: float) -> None:
            await super().write(command)
            if command == 0.0 and len(self.commands) > 1:
                await asyncio.sleep(100.0)

    motor, user = Hangs(), user_of("user", motor=esair.writes(float))
    motor.deadline = 1.2
    async with esair.Robot(resources=[motor], behaviors=[user]) as robot:
        first = asyncio.create_task(user.motor.write(1.0))
        await soon()
        began = asyncio.get_running_loop().time()
        waits = asyncio.create_task(user.motor.write(2.0))
        await asyncio.sleep(0.8)
        robot.actuators.channels["motor"].make_safe()
        with pytest.raises(esair.NoTurnError):
            await waits
        waited = asyncio.get_running_loop().time() - began
        assert waited == pytest.approx(3 * 1.2, abs=0.01)
        await first


async def test_one_that_is_no_good_any_more_when_its_turn_comes_is_told_so(
    user_of: Any,
) -> None:
    """The device may have changed what it can take; the next one has its turn."""

    class Picky(Motor):
        most = 10.0

        def check(self, command: float) -> None:
            if command > self.most:
                raise esair.BadValueError(self.name, "", f"at most {self.most}")

    motor, user = Picky(), user_of("user", motor=esair.writes(float))
    async with esair.Robot(resources=[motor], behaviors=[user]):
        writes = [asyncio.create_task(user.motor.write(n)) for n in (1.0, 5.0, 2.0)]
        await asyncio.sleep(0)
        motor.most = 3.0
        first, second, third = await asyncio.gather(*writes, return_exceptions=True)
        assert first
        assert isinstance(second, esair.BadValueError)
        assert third
        assert motor.commands == [0.0, 1.0, 2.0]


async def test_what_was_applied_of_one_that_has_waited_is_told(user_of: Any) -> None:
    """As the device has said, not as it was asked for."""

    class Weak(Motor):
        async def write(self, command: float) -> float:  # type: ignore[override]
            await super().write(command)
            return command / 2

    told: list[Event] = []
    motor, user = Weak(), user_of("user", motor=esair.writes(float))
    async with esair.Robot(resources=[motor], behaviors=[user]) as robot:
        robot.journal.listen(told.append, kinds=(Kind.APPLIED,))
        assert await user.motor.write(1.0)
        await asyncio.sleep(0.01)
        assert [(each.peer, each.value) for each in told] == [("user", 0.5)]


@pytest.mark.promise("PRO-1")
async def test_what_a_reaction_wanted_next_is_not_sent_once_it_is_blind() -> None:
    """Its command was on its way when the sensor was lost: what follows is safe alone."""

    class Follow(esair.Reaction):
        sonar = esair.reads(float)
        motor = esair.writes(float, blind="release")

        def react(self, sonar: float) -> float:
            return sonar

    motor, sonar = Motor(), FakeSensor("sonar", 1.0, type=float)
    async with esair.Robot(resources=[motor, sonar], behaviors=[Follow()]):
        await motor.until(1.0, timeout=1.0)
        sonar.feed(2.0)
        await soon()
        sonar.unplug()
        await asyncio.sleep(4.0)
        assert motor.commands[-1] == 0.0
        assert 2.0 not in motor.commands
