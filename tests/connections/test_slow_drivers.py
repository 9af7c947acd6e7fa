"""Drivers that take their time: whose time counts, and who waits for whom."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Iterator
from typing import Any

import pytest

import esair
from esair import ResourceState
from esair.loop import turn_of
from esair.testing import FakeActuator, FakeSensor

pytestmark = pytest.mark.virtual_clock


def now() -> float:
    return asyncio.get_running_loop().time()


@pytest.mark.promise("AC-2")
async def test_the_time_out_begins_when_the_write_has_ended(user_of: Any) -> None:
    """Not when it began: a slow device would stop between two writes."""
    motor = FakeActuator("motor", safe=0.0, command_timeout=0.2)
    user = user_of("user", motor=esair.writes(float))
    motor.slow(0.15)
    async with esair.Robot(resources=[motor], behaviors=[user]):
        began = now()
        await user.motor.write(1.0)
        assert now() - began == pytest.approx(0.15)
        motor.slow(0.0)
        await motor.until(0.0)
        assert now() - began == pytest.approx(0.35)


@pytest.mark.promise("AC-2")
async def test_a_late_end_is_no_renewal_for_somebody_else(user_of: Any) -> None:
    """What an earlier writer's call ends with says nothing of the present one."""
    motor = FakeActuator("motor", safe=0.0, command_timeout=0.2)
    low = user_of("low", motor=esair.writes(float))
    async with esair.Robot(resources=[motor], behaviors=[low]) as robot:
        motor.slow(0.0, acknowledge=0.19)
        writing = asyncio.create_task(low.motor.write(1.0))
        await asyncio.sleep(0.1)
        robot.resources.revoke(low.motor.registration)
        await asyncio.wait({writing})
        await motor.until(0.0)
        assert motor.commands == [0.0, 1.0, 0.0]


@pytest.mark.promise("TURN-2", "CALL-3")
async def test_each_output_of_a_reaction_waits_for_its_own_device(
    fake_sensor: Any,
) -> None:
    """A slow one takes the newest command when it is free; a quick one has them all."""
    eye = fake_sensor("eye", 1.0, rate=20.0)
    slow = FakeActuator("slow", safe=0.0)
    quick = FakeActuator("quick", safe=0.0)

    class Both(esair.Reaction):
        eye = esair.reads(float)
        slow = esair.writes(float)
        quick = esair.writes(float)
        steps = 0

        def react(self, eye: float) -> dict[str, float]:
            self.steps += 1
            return {"slow": float(self.steps), "quick": float(self.steps)}

    slow.slow(0.12)
    both = Both()
    async with esair.Robot(resources=[eye, slow, quick], behaviors=[both]) as robot:
        await asyncio.sleep(1.0)
        told = list(quick.commands[1:])
        assert told == [float(n + 1) for n in range(len(told))]
        assert len(told) >= 19
        late = slow.commands[1:]
        assert late == sorted(set(late))
        assert set(late) <= set(told)
        assert 6 <= len(late) <= 8
        waiting = both.steps - len(told) + 2
        conflated = robot.journal.counts()["both"]["conflated"]
        assert both.steps - len(late) - conflated <= waiting
        assert conflated >= 10


@pytest.mark.promise("SC-1", "RES-2")
@pytest.mark.parametrize("blocks", [True, False])
async def test_a_stream_that_ends_is_a_loss(blocks: bool, user_of: Any) -> None:
    """The device is opened again, and speaks again."""

    class Short(esair.Sensor[float]):
        opened = 0

        async def open(self) -> None:
            self.opened += 1

    class Blocking(Short):
        def stream(self) -> Iterator[float]:
            yield float(self.opened)

    class Waiting(Short):
        async def stream(self) -> Any:
            yield float(self.opened)

    short = (Blocking if blocks else Waiting)(name="short")
    user = user_of("user", short=esair.reads(float))
    async with esair.Robot(resources=[short], behaviors=[user]) as robot:
        values = [value async for value, _ in zip_with(user.short, 3)]
        assert values == [values[0], values[0] + 1.0, values[0] + 2.0]
        assert robot.resources.query("short").losses >= 2


async def zip_with(values: Any, count: int) -> Any:
    """Yield so many values, with their numbers."""
    number = 0
    async for value in values:
        yield value, number
        number += 1
        if number == count:
            return


@pytest.mark.promise("RS-5")
async def test_what_an_actuator_has_applied_goes_with_it(user_of: Any) -> None:
    """A new one of the name tells its own."""
    motor = FakeActuator("motor", safe=0.0)
    async with esair.Robot(resources=[motor]) as robot:
        mine = await robot.resources.register(
            "user", "motor.applied", esair.Access.READ
        )
        assert (await robot.sensors.read(mine)).value == 0.0
        await robot.resources.remove("motor")
        with pytest.raises(esair.EsairError):
            await robot.sensors.read(mine)
        assert "motor.applied" not in robot.sensors.channels
        await robot.resources.add(FakeActuator("motor", safe=0.5))
        again = await robot.resources.register(
            "user", "motor.applied", esair.Access.READ
        )
        assert (await robot.sensors.read(again)).value == 0.5


@pytest.mark.promise("SC-3")
async def test_after_a_sleep_of_the_computer_no_reading_is_current(
    user_of: Any,
) -> None:
    """The clock stood still, the world did not: the device is asked, and safe is told."""
    sonar = FakeSensor("sonar", 1.0, type=float, rate=1.0)
    motor = FakeActuator("motor", safe=0.0, command_timeout=5.0)
    user = user_of("user", sonar=esair.reads(float), motor=esair.writes(float))
    loop: Any = asyncio.get_running_loop()
    async with esair.Robot(resources=[sonar, motor], behaviors=[user]) as robot:
        await user.motor.write(1.0)
        await user.sonar.read()
        await user.sonar.read()
        assert sonar.reads == 1
        loop.suspend(3600.0)
        await motor.until(0.0, timeout=2.0)
        assert motor.commands == [0.0, 1.0, 0.0]
        with pytest.raises(esair.StaleReadingError):
            _ = user.sonar.newest
        await user.sonar.read()
        assert sonar.reads == 2
        assert robot.resources.query("sonar").state is ResourceState.READY


@pytest.mark.promise("SC-3")
@pytest.mark.fault("T02")
async def test_an_answer_to_a_question_from_before_a_sleep_is_old(
    user_of: Any,
) -> None:
    """The device had measured already when the computer fell asleep: it is asked again."""

    class Slow(esair.Sensor[float]):
        distance = 1.0

        async def read(self) -> float:
            measured = self.distance
            await asyncio.sleep(0.2)
            return measured

    slow = Slow()
    user = user_of("user", slow=esair.reads(float))
    loop: Any = asyncio.get_running_loop()
    async with esair.Robot(resources=[slow], behaviors=[user]):
        reading = asyncio.create_task(user.slow.read())
        await asyncio.sleep(0.1)
        slow.distance = 2.0
        loop.suspend(3600.0)
        turn_of(loop).suspends.look()
        assert await reading == 2.0


@pytest.mark.promise("AC-3")
@pytest.mark.fault("T02")
async def test_a_write_that_waits_when_the_computer_sleeps_is_refused(
    user_of: Any,
) -> None:
    """Nothing from before the sleep moves the device after it."""
    motor = FakeActuator("motor", safe=0.0, command_timeout=5.0)
    user = user_of("user", motor=esair.writes(float))
    loop: Any = asyncio.get_running_loop()
    async with esair.Robot(resources=[motor], behaviors=[user]):
        motor.slow(0.2)
        first = asyncio.create_task(user.motor.write(1.0))
        await asyncio.sleep(0.01)
        second = asyncio.create_task(user.motor.write(2.0))
        await asyncio.sleep(0.01)
        loop.suspend(3600.0)
        turn_of(loop).suspends.look()
        assert await first
        refused = await second
        assert not refused
        assert "slept" in refused.rule
        await asyncio.sleep(1.0)
        assert motor.commands == [0.0, 1.0, 0.0]
        assert await user.motor.write(3.0)


@pytest.mark.promise("CALL-2", "SUP-3")
async def test_a_new_device_owes_nothing_to_the_one_before(user_of: Any) -> None:
    """However many safe commands that had: a slow write of its own stands."""
    old = FakeActuator("motor", safe=0.0, command_timeout=0.1)
    new = FakeActuator("motor", safe=0.0, command_timeout=1.0)
    user = user_of("user", motor=esair.writes(float))
    async with esair.Robot(resources=[old], behaviors=[user]) as robot:
        for _ in range(5):
            await user.motor.write(1.0)
            await asyncio.sleep(0.3)
        assert old.commands == [0.0] + 5 * [1.0, 0.0]
        await robot.resources.replace("motor", new)
        new.slow(0.05)
        await user.motor.write(1.0)
        await asyncio.sleep(0.5)
        assert new.commands == [0.0, 1.0]


@pytest.mark.promise("SUP-3")
async def test_a_device_is_closed_when_its_last_call_has_ended(user_of: Any) -> None:
    """Not under the hands of its driver."""
    log: list[str] = []

    class Motor(FakeActuator[float]):
        async def write(self, command: float) -> None:
            await super().write(command)
            log.append(f"end {command}")

        async def close(self) -> None:
            log.append("close")

    motor = Motor("motor", safe=0.0, command_timeout=0.1)
    motor.deadline = 0.2
    user = user_of("user", motor=esair.writes(float))
    async with esair.Robot(resources=[motor], behaviors=[user]):
        motor.slow(0.25)
        motor.swallow(1)
        writing = asyncio.create_task(user.motor.write(1.0))
        await asyncio.sleep(0.01)
        motor.slow(0.0)
    with pytest.raises(esair.EsairError):
        await writing
    assert log.index("end 1.0") < log.index("close")


@pytest.mark.promise("AC-1", "CALL-3")
@pytest.mark.parametrize("takes", [0.0, 0.1])
async def test_a_writer_cancelled_in_the_instant_of_its_turn(
    takes: float, user_of: Any
) -> None:
    """Its call is ended with it, if there is one that waits; it is only cancelled."""

    class Motor(FakeActuator[float]):
        async def write(self, command: float) -> None:
            if command == 2.0:  # before its writer hears that it was its turn
                asyncio.get_running_loop().call_soon(second.cancel)
                self.slow(takes)
            await super().write(command)

    motor = Motor("motor", safe=0.0)
    user = user_of("user", motor=esair.writes(float))
    async with esair.Robot(resources=[motor], behaviors=[user]):
        motor.slow(0.05)
        first = asyncio.create_task(user.motor.write(1.0))
        await asyncio.sleep(0.01)
        second = asyncio.create_task(user.motor.write(2.0))
        await asyncio.wait({first, second})
        assert first.result()
        assert second.cancelled()
        await asyncio.sleep(0.15)
        assert (2.0 in motor.commands) is (takes == 0.0)


@pytest.mark.promise("CALL-2")
async def test_a_safe_command_that_is_not_answered_holds_up_no_other(
    user_of: Any,
) -> None:
    """It was on the wire before the motion; that has ended, and undone it, meanwhile."""
    told: list[tuple[float, float]] = []

    class Motor(esair.Actuator[float]):
        safe = 0.0
        deadline = 2.0

        async def write(self, command: float) -> None:
            if command:
                await asyncio.sleep(0.7)
            told.append((loop.time(), command))
            if not command and len(told) == 2:
                await asyncio.sleep(1.9)

    loop = asyncio.get_running_loop()
    user = user_of("user", motor=esair.writes(float))
    async with esair.Robot(resources=[Motor()], behaviors=[user]) as robot:
        begin = loop.time()
        await user.motor.write(1.0)
        assert [command for _, command in told] == [0.0, 0.0, 1.0]
        await asyncio.sleep(0.5)
        assert {command for _, command in told[3:]} == {0.0}
        assert told[3][0] - begin == pytest.approx(0.7 + 0.2)
        assert robot.resources.query("motor").state is esair.ResourceState.READY
        await user.motor.write(2.0)


@pytest.mark.promise("CALL-2")
async def test_a_safe_command_that_takes_long_is_not_ended_by_the_next(
    user_of: Any,
) -> None:
    """It lands, and so does what is sent after the motion; the device is free again."""
    told: list[tuple[float, float]] = []

    class Motor(esair.Actuator[float]):
        safe = 0.0

        async def write(self, command: float) -> None:
            await asyncio.sleep(0.5)
            told.append((now(), command))

    user = user_of("user", motor=esair.writes(float))
    async with esair.Robot(resources=[Motor()], behaviors=[user]) as robot:
        writing = asyncio.ensure_future(user.motor.write(1.0))
        await asyncio.sleep(0.2)
        halted = now()
        (answer,) = await robot.halt("enough")
        assert answer.answered
        assert told[1] == pytest.approx((halted + 0.3, 1.0))
        assert told[2] == pytest.approx((halted + 0.2 + 0.5, 0.0))
        await writing
        robot.resume()
        assert await user.motor.write(2.0)
        assert told[-1][1] == 2.0


@pytest.mark.promise("CALL-2", "SUP-5")
async def test_what_a_removed_device_does_late_is_undone_by_the_next(
    user_of: Any,
) -> None:
    """It may be the same motor: it has a new driver, and the old one's call goes on."""
    told: list[float] = []

    class Motor(esair.Actuator[float]):
        safe = 0.0

        async def write(self, command: float) -> None:
            lands = now() + (3.0 if command else 0.0)
            while now() < lands:
                with contextlib.suppress(asyncio.CancelledError):
                    await asyncio.sleep(lands - now())
            told.append(command)

    user = user_of("user", motor=esair.writes(float))
    async with esair.Robot(resources=[Motor()], behaviors=[user]) as robot:
        writing = asyncio.ensure_future(user.motor.write(1.0))
        await asyncio.sleep(0.1)
        await robot.resources.remove("motor")
        with pytest.raises(esair.DriverStuckError):
            await writing
        await robot.resources.add(Motor())
        assert set(told) == {0.0}
        await asyncio.sleep(3.0)
        assert told[-2:] == [1.0, 0.0]


@pytest.mark.promise("CALL-1")
@pytest.mark.parametrize("means", ["replace", "remove", "wait"])
async def test_what_was_given_up_before_its_turn_in_a_thread_is_not_begun(
    means: str, user_of: Any
) -> None:
    """Its caller was told that it failed, and the hardware may have another driver."""
    loop: Any = asyncio.get_running_loop()
    calls: list[str] = []  # of "apply"

    class Arm(esair.Actuator[float]):
        safe = 0.0
        deadline = 0.2
        speed = esair.setting(0.5, min=0.0, max=9.0)

        def write(self, command: float) -> None:
            if command:
                loop.wait_in_thread(1.6)

        def apply(self, speed: float) -> None:
            calls.append(f"speed {speed}")

    user = user_of("user", arm=esair.writes(float, configure=True))
    async with esair.Robot(resources=[Arm()], behaviors=[user]) as robot:
        writes = asyncio.ensure_future(user.arm.write(1.0))
        await asyncio.sleep(0.05)
        with pytest.raises(esair.DeviceLostError, match="was given up"):
            await user.arm.configure(speed=2.0)
        with pytest.raises(esair.DriverStuckError):
            await writes
        await asyncio.sleep(0.1)
        if means == "replace":
            await robot.resources.replace("arm", Arm(name="arm"))
        elif means == "remove":
            await robot.resources.remove("arm")
        await asyncio.sleep(3.0)
        assert calls == []
        if means == "wait":
            assert robot.resources.query("arm").losses == 1


@pytest.mark.promise("CALL-2", "CALL-3")
async def test_no_motion_leaves_beside_a_safe_command_that_was_sent_once_more(
    user_of: Any,
) -> None:
    """That would land after it, while it counts as what the device does."""
    takes, alive, beside = [0.0, 0.5, 0.6, 1.0], list[float](), list[float]()

    class Motor(esair.Actuator[float]):
        safe = 0.0
        deadline = 5.0

        async def write(self, command: float) -> None:
            if command == 2.0:
                beside.extend(alive)
            alive.append(command)
            await asyncio.sleep(takes.pop(0) if takes else 0.0)
            alive.remove(command)

    user = user_of("user", motor=esair.writes(float))
    async with esair.Robot(resources=[Motor()], behaviors=[user]) as robot:
        first = asyncio.ensure_future(user.motor.write(1.0))
        await asyncio.sleep(0.1)
        robot.halt("enough")
        robot.resume()
        assert await user.motor.write(2.0)
        assert await first
        assert takes == []
        assert beside == []


@pytest.mark.promise("AC-2", "AC-3")
@pytest.mark.virtual_clock
@pytest.mark.parametrize("seconds", [0.0, 0.01])
async def test_what_the_device_fails_at_ends_the_motion_that_it_took_over(
    seconds: float, user_of: Any
) -> None:
    """However often it is tried: else each try would renew the motion's time-out."""
    motor = FakeActuator("motor", safe=0.0, command_timeout=0.2)
    motor.fault_limit = 1000
    low = user_of("low", motor=esair.writes(float))
    high = user_of("high", motor=esair.writes(float, priority=9))
    async with esair.Robot(resources=[motor], behaviors=[low, high]):
        assert await low.motor.write(1.0)
        motor.slow(seconds)
        for _ in range(7):
            motor.fail(OSError("a spike"))
            with pytest.raises(esair.DeviceFaultError, match="a spike"):
                await high.motor.write(2.0)
            await asyncio.sleep(0.05)
        assert motor.commands == [0.0, 1.0, 0.0]
        assert motor.landed[-1] < 0.1
        assert await high.motor.write(2.0)


@pytest.mark.promise("AC-2")
@pytest.mark.virtual_clock
async def test_a_fault_at_a_command_of_the_same_writer_leaves_it_moving(
    user_of: Any,
) -> None:
    """It hears of it, and may try again: nobody else has lost the actuator."""
    motor = FakeActuator("motor", safe=0.0, command_timeout=0.2)
    user = user_of("user", motor=esair.writes(float))
    async with esair.Robot(resources=[motor], behaviors=[user]):
        assert await user.motor.write(1.0)
        motor.fail(OSError("a spike"))
        with pytest.raises(esair.DeviceFaultError, match="a spike"):
            await user.motor.write(2.0)
        assert await user.motor.write(3.0)
        assert motor.commands == [0.0, 1.0, 3.0]
