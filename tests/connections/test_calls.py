"""Driver calls: one outcome in time, whatever the driver does; safe lands last."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections.abc import AsyncIterator
from typing import Any

import pytest

import esair
from esair import ResourceState
from esair.connections._calls import ABANDONED_LIMIT, Calls, Driver

pytestmark = pytest.mark.virtual_clock


def now() -> float:
    return asyncio.get_running_loop().time()


class Motor(esair.Actuator[float]):
    """Writes down when a command lands, not when its call begins."""

    safe = 0.0
    safe_takes = 0.0

    def __init__(self, takes: float, *, deaf: bool = False, **options: Any) -> None:
        super().__init__(**options)
        self.takes = takes
        self.deaf = deaf
        self.landed: list[float] = []

    async def write(self, command: float) -> None:
        until = now() + (self.takes if command else self.safe_takes)
        while (left := until - now()) > 1e-9:
            try:
                await asyncio.sleep(left)
            except asyncio.CancelledError:
                if not self.deaf:
                    raise
        self.landed.append(command)


async def until_landed(motor: Any, command: float, times: int = 1) -> None:
    while motor.landed.count(command) < times:  # noqa: ASYNC110 - nobody is told
        await asyncio.sleep(0.01)


@pytest.mark.promise("CALL-2", "AC-4")
async def test_a_slow_motion_is_followed_by_safe_even_if_safe_was_sent_before(
    user_of: Any,
) -> None:
    """The motion lands at 0.5 s, after the safe command of the command time-out."""
    motor, user = Motor(0.5), user_of("user", motor=esair.writes(float))
    async with esair.Robot(resources=[motor], behaviors=[user]):
        writing = asyncio.create_task(user.motor.write(1.0))
        await asyncio.sleep(0.45)
        assert motor.landed == [0.0, 0.0]  # safe has overtaken the motion
        await until_landed(motor, 1.0)
        await asyncio.sleep(0.01)
        assert motor.landed[-1] == 0.0
        await asyncio.wait({writing})


@pytest.mark.promise("CALL-2")
async def test_a_stop_waits_for_a_motion_that_is_on_its_way(user_of: Any) -> None:
    """It says "answered" because the last thing that has landed is safe."""
    motor, user = Motor(0.5), user_of("user", motor=esair.writes(float))
    async with esair.Robot(resources=[motor], behaviors=[user]) as robot:
        writing = asyncio.create_task(user.motor.write(1.0))
        await asyncio.sleep(0.01)
    await asyncio.wait({writing})
    await asyncio.sleep(1.0)

    assert robot.stopped[0].answered
    assert motor.landed[motor.landed.index(1.0) + 1] == motor.landed[-1] == 0.0


@pytest.mark.promise("CALL-1", "CALL-2")
async def test_a_stop_names_the_motion_that_it_could_not_wait_for(user_of: Any) -> None:
    """While a call from before safe is alive, nobody says that safe was answered."""
    motor = Motor(30.0, deaf=True)
    user = user_of("user", motor=esair.writes(float))
    began = now()
    async with esair.Robot(resources=[motor], behaviors=[user]) as robot:
        writing = asyncio.create_task(user.motor.write(1.0))
        await asyncio.sleep(0.01)
    assert now() - began < 5.0
    (told,) = robot.stopped
    assert told.safe
    assert not told.answered
    assert "write" in told.error
    assert "1.0" in told.error
    assert [str(call) for call in robot.resources.abandoned()] == ["write 1 (1.0)"]
    with pytest.raises(esair.DriverStuckError):
        await writing
    await asyncio.sleep(40.0)
    assert robot.resources.abandoned() == ()


@pytest.mark.promise("AC-4", "CALL-1")
async def test_a_stop_tells_what_is_back_to_be_safe_beside_a_motion_that_lives(
    user_of: Any,
) -> None:
    """It was unplugged amid a motion, and is there again when the robot stops."""
    motor, user = Motor(0.0, deaf=True), user_of("user", motor=esair.writes(float))
    async with esair.Robot(resources=[motor], behaviors=[user]) as robot:
        await user.motor.write(1.0)
        motor.takes = 30.0
        writing = asyncio.create_task(user.motor.write(2.0))
        await asyncio.sleep(0.01)
        motor.report_lost(ConnectionResetError("unplugged"))
        await asyncio.sleep(0.01)
        assert robot.resources.query("motor").state is ResourceState.LOST

    assert motor.landed == [0.0, 1.0, 0.0]
    (told,) = robot.stopped
    assert told.safe
    assert not told.answered  # the motion may still land, and the report names it
    assert "2.0" in told.error
    with pytest.raises(esair.DeviceLostError):
        await writing


@pytest.mark.promise("AC-4", "CALL-2")
async def test_nothing_but_safe_is_sent_when_an_old_motion_ends_beside_a_new_one(
    user_of: Any,
) -> None:
    """The old one is of a device that was taken away; a halt waits for the new one."""
    old, new = Motor(1.2, deaf=True), Motor(0.9)
    user = user_of("user", motor=esair.writes(float))
    async with esair.Robot(resources=[old], behaviors=[user], grace=0.1) as robot:
        first = asyncio.create_task(user.motor.write(1.0))
        await asyncio.sleep(0.01)
        await robot.resources.replace("motor", new)
        await asyncio.sleep(1.05 - now())
        second = asyncio.create_task(user.motor.write(2.0))
        await asyncio.sleep(0.1)
        robot.halt("enough")
        await until_landed(old, 1.0)
        await asyncio.sleep(0.05)
        assert not new.landed[1:]  # both of them wait
        await asyncio.sleep(3.0)
        assert new.landed.count(2.0) == 1
        assert new.landed[-1] == 0.0
        await asyncio.wait({first, second})
        assert isinstance(first.exception(), esair.EsairError)


@pytest.mark.promise("CALL-2", "AC-4")
async def test_a_motion_that_ends_amid_an_opening_is_followed_by_safe(
    user_of: Any,
) -> None:
    """It is from before the loss; the opening has told safe, and waits for the answer."""

    class Slow(esair.Actuator[float]):
        safe = 0.0

        def __init__(self) -> None:
            super().__init__(name="motor")
            self.landed: list[float] = []
            self.ends = asyncio.Event()
            self.answers = asyncio.Event()
            self.answers.set()

        async def write(self, command: float) -> None:
            if command:
                while not self.ends.is_set():
                    with contextlib.suppress(asyncio.CancelledError):
                        await self.ends.wait()
            self.landed.append(command)
            await self.answers.wait()

    motor = Slow()
    user = user_of("user", motor=esair.writes(float))
    async with esair.Robot(resources=[motor], behaviors=[user]) as robot:
        writing = asyncio.create_task(user.motor.write(1.0))
        await asyncio.sleep(0.01)
        motor.answers.clear()
        motor.report_lost(ConnectionResetError("unplugged"))
        await until_landed(motor, 0.0, times=2)
        motor.ends.set()
        await asyncio.sleep(0.1)
        assert motor.landed == [0.0, 0.0, 1.0]
        motor.answers.set()
        await asyncio.sleep(0.1)
        assert robot.resources.query("motor").state is ResourceState.READY
        assert motor.landed == [0.0, 0.0, 1.0, 0.0]
        with pytest.raises(esair.DeviceLostError):
            await writing


@pytest.mark.promise("CALL-2", "AC-4", "ROB-2")
@pytest.mark.parametrize("safe_takes", [0.0, 30.0])
async def test_a_motion_that_ends_after_the_last_try_of_a_stop_is_no_answer(
    user_of: Any, safe_takes: float
) -> None:
    """It lands between that and the report, which waits for another actuator."""
    motor, other = Motor(0.9, deaf=True, name="motor"), Motor(0.0, name="other")
    motor.deadline, other.deadline = 0.15, 2.0
    user = user_of("user", motor=esair.writes(float))
    robot = esair.Robot(resources=[motor, other], behaviors=[user])
    async with robot:
        writing = asyncio.create_task(user.motor.write(1.0))
        await asyncio.sleep(0.01)
        motor.report_lost(ConnectionResetError("unplugged"))
        await asyncio.sleep(0.01)
        other.safe_takes = 1.2
        loop = asyncio.get_running_loop()
        loop.call_at(0.85, lambda: setattr(motor, "safe_takes", safe_takes))
    assert motor.landed[-2:] == ([1.0, 0.0] if not safe_takes else [0.0, 1.0])
    told = next(each for each in robot.stopped if each.resource == "motor")
    assert told.safe
    assert told.answered is (not safe_takes)
    with pytest.raises(esair.EsairError):
        await writing
    await asyncio.sleep(40.0)


@pytest.mark.promise("CALL-2", "AC-4", "ROB-2")
@pytest.mark.parametrize("takes", [0.61, 0.9, 1.17])
@pytest.mark.parametrize("stops", [0.053, 0.2, 0.45])
async def test_a_motion_that_ends_while_the_stop_waits_for_it_is_followed_by_safe(
    user_of: Any, takes: float, stops: float
) -> None:
    """The stop has told safe, and has said that nobody answers for what still lives."""
    motor = Motor(takes, deaf=True)
    motor.deadline = 0.15
    user = user_of("user", motor=esair.writes(float))
    async with esair.Robot(resources=[motor], behaviors=[user]):
        writing = asyncio.create_task(user.motor.write(1.0))
        await asyncio.sleep(stops)
    assert 1.0 in motor.landed
    assert motor.landed[-1] == 0.0
    with pytest.raises(esair.DriverStuckError):
        await writing


@pytest.mark.promise("AC-4", "ROB-2")
async def test_a_safe_command_that_fails_once_at_an_opening_is_tried_again(
    user_of: Any,
) -> None:
    """The device is there, and moves: its next opening may be seconds away."""

    class Fails(Motor):
        fails = 0

        async def write(self, command: float) -> None:
            if not command and self.fails:
                self.fails -= 1
                raise ValueError("its answer makes no sense")
            await super().write(command)

    motor = Fails(0.0, name="motor")
    user = user_of("user", motor=esair.writes(float))
    async with esair.Robot(resources=[motor], behaviors=[user]) as robot:
        await user.motor.write(1.0)
        motor.fails = 2
        motor.report_lost(ConnectionResetError("unplugged"))
        await asyncio.sleep(0.2)
        assert motor.landed == [0.0, 1.0, 0.0]
        assert robot.resources.query("motor").state is ResourceState.READY
        assert robot.resources.query("motor").losses == 1


@pytest.mark.promise("CALL-1", "CALL-2")
@pytest.mark.parametrize(("takes", "answered"), [(30.0, False), (3.0, True)])
async def test_a_motion_given_up_before_the_stop_is_named_while_it_lives(
    takes: float, answered: bool, user_of: Any
) -> None:
    """Though wheels answer again: what it does late may undo what they have answered."""
    motor = Motor(takes, deaf=True)
    user = user_of("user", motor=esair.writes(float))
    async with esair.Robot(resources=[motor], behaviors=[user]) as robot:
        with pytest.raises(esair.DriverStuckError):
            await user.motor.write(1.0)
        motor.takes = 0.0
        await asyncio.sleep(3.0)
    (told,) = robot.stopped
    assert told.safe
    assert motor.landed[-1] == 0.0
    assert told.answered is answered
    assert ("(1.0), begun before it, has not ended" in told.error) is not answered
    await asyncio.sleep(40.0)
    assert robot.resources.abandoned() == ()


@pytest.mark.promise("CALL-1", "CALL-2")
@pytest.mark.parametrize(("takes", "answered"), [(30.0, False), (3.0, True)])
async def test_a_safe_command_given_up_before_the_stop_is_named_while_it_lives(
    takes: float, answered: bool, user_of: Any
) -> None:
    """It lands late, after the one that the wheels have answered since."""
    motor = Motor(0.0, deaf=True)
    user = user_of("user", motor=esair.writes(float))
    async with esair.Robot(resources=[motor], behaviors=[user]) as robot:
        await user.motor.write(1.0)
        motor.safe_takes = takes
        await robot.halt("to be safe")
        motor.safe_takes = 0.0
        await asyncio.sleep(5.0)
    (told,) = robot.stopped
    landed = list(motor.landed)
    assert told.safe
    assert told.answered is answered
    assert ("(0.0), begun before it, has not ended" in told.error) is not answered
    await asyncio.sleep(40.0)
    assert (motor.landed == landed) is answered
    assert robot.resources.abandoned() == ()


@pytest.mark.promise("CALL-2")
async def test_of_what_is_alive_a_motion_is_named_before_a_safe_command(
    user_of: Any,
) -> None:
    """Whichever of them was begun first: the motion is what is worse."""
    motor = Motor(30.0, deaf=True)
    motor.safe_takes = 30.0
    user = user_of("user", motor=esair.writes(float))
    async with esair.Robot(resources=[motor], behaviors=[user]) as robot:
        motor.safe_takes = 0.0
        await asyncio.sleep(5.0)  # an opening has ended that had nothing to wait for
        motor.safe_takes = 30.0
        await robot.halt("to be safe")
        motor.safe_takes = 0.0
        await asyncio.sleep(5.0)
        robot.resume()
        with pytest.raises(esair.DriverStuckError):
            await user.motor.write(1.0)
        motor.takes = 0.0
        await asyncio.sleep(5.0)
        left = [str(call) for call in robot.resources.abandoned()]
        assert any("safe" in each for each in left)
        assert any("write" in each for each in left)
    assert "write" in robot.stopped[0].error


class Refuses(Motor):
    """Its device says no to the safe command."""

    says_no = False
    tries = 0

    async def write(self, command: float) -> None:
        if self.says_no and not command:
            self.tries += 1
            raise OSError("no")
        await super().write(command)


@pytest.mark.promise("AC-4")
async def test_a_safe_command_is_tried_three_times(user_of: Any) -> None:
    """Then the actuator counts as unsafe: it is lost, and opened anew."""
    motor = Refuses(0.0, name="motor")
    user = user_of("user", motor=esair.writes(float))
    async with esair.Robot(resources=[motor], behaviors=[user]) as robot:
        await user.motor.write(1.0)
        motor.says_no = True
        await robot.halt("to be safe")
        assert motor.tries == 3
        assert robot.resources.query("motor").state is ResourceState.LOST
        motor.says_no = False


@pytest.mark.promise("CALL-1")
async def test_a_writer_gets_its_outcome_at_the_deadline(user_of: Any) -> None:
    """Though the driver swallows its cancellation, and goes on for a minute."""
    motor = Motor(60.0, deaf=True)
    user = user_of("user", motor=esair.writes(float))
    async with esair.Robot(resources=[motor], behaviors=[user]) as robot:
        began = now()
        with pytest.raises(esair.DriverStuckError):
            await user.motor.write(1.0)
        assert now() - began == pytest.approx(1.0, abs=0.01)
        motor.takes = 0.0
        await asyncio.sleep(3.0)
        began = now()
        assert await user.motor.write(2.0)
        assert now() - began < 0.1
        assert robot.journal.counts()["motor"]["abandoned"] == 1


@pytest.mark.promise("CALL-2")
async def test_an_abandoned_motion_that_lands_late_is_followed_by_safe(
    user_of: Any,
) -> None:
    """Also if others have written since: who knows which of them was the last."""
    motor = Motor(6.0, deaf=True)
    user = user_of("user", motor=esair.writes(float))
    async with esair.Robot(resources=[motor], behaviors=[user]):
        with pytest.raises(esair.DriverStuckError):
            await user.motor.write(1.0)
        motor.takes = 0.0
        await asyncio.sleep(3.0)
        while 1.0 not in motor.landed:
            await user.motor.write(2.0)
            await asyncio.sleep(0.05)
        landed = motor.landed[motor.landed.index(1.0) :]
        assert landed[:2] == [1.0, 0.0]


@pytest.mark.promise("CALL-2", "CALL-3")
async def test_no_motion_begins_while_a_safe_command_is_in_flight(user_of: Any) -> None:
    """A write waits for the safe command, though the one it overtook has ended."""
    begun: list[tuple[str, float]] = []

    class Slow(esair.Actuator[float]):
        safe = 0.0
        command_timeout = 0.05

        async def write(self, command: float) -> None:
            begun.append(("begin", command))
            await asyncio.sleep(0.08 if command else 0.3)
            begun.append(("land", command))

    user = user_of("user", slow=esair.writes(float))
    async with esair.Robot(resources=[Slow()], behaviors=[user]):
        writes = []
        for command in (1.0, 2.0, 3.0):
            writes.append(asyncio.create_task(user.slow.write(command)))
            await asyncio.sleep(0.07)
        await asyncio.sleep(3.0)
        await asyncio.wait(writes)

    open_safes = 0
    for what, command in begun:
        if command == 0.0:
            open_safes += 1 if what == "begin" else -1
        elif what == "begin":
            assert open_safes == 0, begun


@pytest.mark.promise("CALL-3")
async def test_no_motion_begins_while_an_abandoned_safe_command_is_alive(
    user_of: Any,
) -> None:
    """The next try was taken at once, but the driver still has the first."""
    alive: list[float] = []
    beside: dict[float, list[float]] = {}

    class Deaf(Motor):
        async def write(self, command: float) -> None:
            beside[command] = list(alive)
            alive.append(command)
            await super().write(command)
            alive.remove(command)

    motor = Deaf(0.0, name="motor", deaf=True)
    user = user_of("user", motor=esair.writes(float))
    motor.deadline = 0.1
    async with esair.Robot(resources=[motor], behaviors=[user]):
        await user.motor.write(1.0)
        motor.safe_takes = 0.15
        await asyncio.sleep(0.25)
        motor.safe_takes = 0.0
        await asyncio.sleep(0.06)
        assert beside[0.0] == [0.0]  # the first try was given up at 0.3 s
        await user.motor.write(2.0)
        assert beside[2.0] == []


@pytest.mark.promise("CALL-3", "AC-2")
async def test_a_loser_of_the_arbitration_is_never_sent(user_of: Any) -> None:
    """Of those that wait for a busy device the highest priority goes first."""
    motor = Motor(0.1, name="motor")
    low = user_of("low", motor=esair.writes(float, priority=1))
    high = user_of("high", motor=esair.writes(float, priority=9))
    async with esair.Robot(resources=[motor], behaviors=[low, high]):
        first = asyncio.create_task(low.motor.write(1.0))
        await asyncio.sleep(0.01)
        loser = asyncio.create_task(low.motor.write(2.0))
        await asyncio.sleep(0.01)
        winner = asyncio.create_task(high.motor.write(3.0))
        await asyncio.sleep(0.5)
        assert first.result()
        assert winner.result()
        assert not loser.result()
        assert 2.0 not in motor.landed


@pytest.mark.promise("CALL-1", "ROB-2")
@pytest.mark.parametrize("swallows", [1, 1000])
async def test_a_robot_starts_though_an_opening_swallows_its_cancellation(
    swallows: int,
) -> None:
    """The device is LOST; everything else runs."""
    left = swallows

    class Deaf(esair.Sensor[float]):
        async def open(self) -> None:
            nonlocal left
            while True:
                try:
                    await asyncio.sleep(50.0)
                except asyncio.CancelledError:
                    left -= 1
                    if left < 0:
                        raise
                else:
                    return

        async def read(self) -> float:
            return 1.0

    began = now()
    async with esair.Robot(resources=[Deaf()]) as robot:
        assert now() - began < 2.0
        assert robot.resources.query("deaf").state is ResourceState.LOST
        began = now()
    assert now() - began < 2.0


@pytest.mark.promise("CALL-1", "SC-3")
async def test_a_sensor_that_hangs_does_not_stay_ready(user_of: Any) -> None:
    """Nothing drives on its last reading: it is LOST when its call does not end."""

    class Deaf(esair.Sensor[float]):
        hangs = False

        async def read(self) -> float:
            while self.hangs:
                try:
                    await asyncio.sleep(100.0)
                except asyncio.CancelledError:
                    continue
            return 1.0

    deaf, user = Deaf(rate=20.0), user_of("user", deaf=esair.reads(float))
    async with esair.Robot(resources=[deaf], behaviors=[user]) as robot:
        assert await user.deaf.read() == 1.0
        deaf.hangs = True
        with pytest.raises((esair.StaleReadingError, esair.DriverStuckError)):
            await user.deaf.read(fresh=True, timeout=5.0)
        await asyncio.sleep(0.2)
        assert robot.resources.query("deaf").state is not ResourceState.READY
        with pytest.raises(ConnectionError):
            await user.deaf.read()


@pytest.mark.promise("CALL-1", "SC-3")
async def test_what_an_earlier_opening_answers_is_never_a_reading(user_of: Any) -> None:
    """A value that comes after the loss of the device is counted, and that is all."""
    values = [1.0, 2.0, 3.0, 4.0]

    class Slow(esair.Sensor[float]):
        async def read(self) -> float:
            value = values.pop(0)
            try:
                await asyncio.sleep(0.3)
            except asyncio.CancelledError:
                await asyncio.sleep(0.3)
            return value

    slow, user = Slow(), user_of("user", slow=esair.reads(float))
    async with esair.Robot(resources=[slow], behaviors=[user]) as robot:
        asking = asyncio.create_task(user.slow.read())
        await asyncio.sleep(0.1)
        slow.report_lost()
        with pytest.raises(esair.DeviceLostError):
            await asking
        await asyncio.sleep(1.0)
        assert robot.sensors.channels["slow"].newest is None
        assert await user.slow.read() == 2.0
        assert robot.journal.counts()["slow"]["late"] == 1


@pytest.mark.promise("CALL-1")
async def test_a_stream_that_goes_on_after_the_loss_is_not_heard(user_of: Any) -> None:
    """It swallows its end and yields; only the stream of the new opening counts."""
    streams = 0

    class Bumper(esair.Sensor[int]):
        async def stream(self) -> AsyncIterator[int]:
            nonlocal streams
            streams += 1
            mine = streams
            while True:
                with contextlib.suppress(asyncio.CancelledError):
                    await asyncio.sleep(0.05)
                yield mine

    bumper, user = Bumper(), user_of("user", bumper=esair.reads(int))
    async with esair.Robot(resources=[bumper], behaviors=[user]) as robot:
        await asyncio.sleep(0.2)
        bumper.report_lost()
        await asyncio.sleep(1.0)
        seen = {reading.value for reading in user.bumper.history(3)}
        assert seen == {2}
        # A value, and the end of the call that yields it.
        assert robot.journal.counts()["bumper"]["late"] == 2


@pytest.mark.promise("CALL-1")
async def test_the_life_of_a_replaced_device_leaves_its_successor_alone(
    fake_actuator: Any,
) -> None:
    """What it still opens late is its own, and closed; the new one hears nothing."""
    go = asyncio.Event()

    class Deaf(esair.Actuator[float]):
        safe = 0.0

        def __init__(self) -> None:
            super().__init__(name="wheels")
            self.log: list[str] = []

        async def open(self) -> None:
            while not go.is_set():
                try:
                    await go.wait()
                except asyncio.CancelledError:
                    continue
            self.log.append("open")

        async def close(self) -> None:
            self.log.append("close")

        async def write(self, command: float) -> None:
            self.log.append(f"write {command}")

    old, new = Deaf(), fake_actuator("wheels", safe=0.0)
    async with esair.Robot(resources=[old]) as robot:
        await robot.resources.replace("wheels", new)
        assert (new.opened, new.is_open) == (1, True)
        go.set()
        await asyncio.sleep(2.0)
        assert (new.opened, new.is_open) == (1, True)
        assert robot.resources.query("wheels").state is ResourceState.READY
    assert old.log[-2:] == ["open", "close"]
    assert "write 0.0" not in old.log


@pytest.mark.promise("CALL-1")
async def test_the_stream_of_a_replaced_sensor_is_not_heard(user_of: Any) -> None:
    """It swallows its end and goes on; no value of it is taken for its successor's."""

    class Bumper(esair.Sensor[int]):
        def __init__(self, value: int, *, deaf: bool) -> None:
            super().__init__(name="bumper")
            self.value = value
            self.deaf = deaf

        async def stream(self) -> AsyncIterator[int]:
            for _ in range(100):
                with contextlib.suppress(
                    asyncio.CancelledError if self.deaf else ZeroDivisionError
                ):
                    yield self.value
                    await asyncio.sleep(0.05)

    user = user_of("user", bumper=esair.reads(int))
    async with esair.Robot(resources=[Bumper(1, deaf=True)], behaviors=[user]) as robot:
        await asyncio.sleep(0.2)
        assert await user.bumper.read() == 1
        await robot.resources.replace("bumper", Bumper(2, deaf=False))
        seen = []
        for _ in range(20):
            await asyncio.sleep(0.03)
            seen += [reading.value for reading in user.bumper.history(10)]
        assert set(seen) == {2}


@pytest.mark.promise("CALL-1", "CALL-2")
async def test_a_replaced_actuator_that_heard_nothing_has_not_answered(
    fake_actuator: Any,
) -> None:
    """What the old one was told says nothing of the new one."""
    old, new = fake_actuator("wheels", safe=0.0), fake_actuator("wheels", safe=0.0)
    async with esair.Robot(resources=[old]) as robot:
        new.unplug()
        await robot.resources.replace("wheels", new)
        assert new.commands == []
        assert not robot.actuators.channels["wheels"].told().answered
    assert not robot.stopped[0].answered


@pytest.mark.promise("CALL-1")
async def test_the_end_of_a_safe_task_by_a_stranger_does_not_spin(
    fake_actuator: Any,
) -> None:
    """Whoever waits for the safe command goes on; it is sent again by the stop."""
    wheels = fake_actuator("wheels", safe=0.0)
    async with esair.Robot(resources=[wheels]) as robot:
        channel = robot.actuators.channels["wheels"]
        channel.make_safe().cancel()
        async with asyncio.timeout(1.0):
            await channel.safe.settled()
    assert robot.stopped[0].answered


@pytest.mark.promise("CALL-2")
@pytest.mark.real_clock
async def test_a_motion_that_a_thread_lands_late_is_followed_by_safe() -> None:
    """A blocking driver cannot be cancelled: its end is heard of, and safe sent again."""
    go, landed = threading.Event(), []

    class Blocking(esair.Actuator[float]):
        safe = 0.0
        deadline = 0.2

        def write(self, command: float) -> None:
            if command:
                go.wait(10.0)
            landed.append(command)

    user = esair.Behavior(name="user", writes={"blocking": esair.writes(float)})
    async with esair.Robot(resources=[Blocking()], behaviors=[user]) as robot:
        with pytest.raises(esair.DriverStuckError):
            await user.blocking.write(1.0)  # type: ignore[attr-defined]
        await asyncio.sleep(0.2)
        assert robot.resources.query("blocking").state is ResourceState.LOST
        assert not robot.actuators.channels["blocking"].told().answered
        go.set()
        for _ in range(300):
            if robot.resources.query("blocking").state is ResourceState.READY:
                break
            await asyncio.sleep(0.01)
        assert robot.resources.query("blocking").state is ResourceState.READY
    assert 1.0 in landed
    assert landed[-1] == 0.0
    assert robot.stopped[0].answered


@pytest.mark.promise("CALL-1")
async def test_calls_that_never_end_are_bounded() -> None:
    """An opening that swallows its end is not begun for ever, one beside the other."""

    class Deaf(esair.Sensor[float]):
        deadline = 0.05
        restart = esair.Restart(max=10_000, within=1e9, delay=0.1, max_delay=0.1)
        begun = 0

        async def open(self) -> None:
            self.begun += 1
            for _ in range(10_000):
                with contextlib.suppress(asyncio.CancelledError):
                    await asyncio.sleep(1e6)

        async def read(self) -> float:
            return 1.0

    deaf = Deaf()
    async with esair.Robot(resources=[deaf]) as robot:
        await asyncio.sleep(600.0)
        assert deaf.begun == ABANDONED_LIMIT
        status = robot.resources.query("deaf")
        assert "calls have not ended" in str(status.error)


@pytest.mark.promise("RES-1")
@pytest.mark.real_clock
async def test_a_computer_without_another_thread_is_told_so(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Nothing of such a call is left; with a thread again the device is there."""
    start, refused = threading.Thread.start, list[str]()

    def none_left(thread: threading.Thread) -> None:
        if thread.name == "esair-sonar" and not refused:
            refused.append(thread.name)
            raise RuntimeError("can't start new thread")
        start(thread)

    class Sonar(esair.Sensor[float]):
        def open(self) -> None: ...

        def read(self) -> float:
            return 1.0

    monkeypatch.setattr(threading.Thread, "start", none_left)
    user: Any = esair.Behavior(name="user", reads={"sonar": esair.reads(float)})
    async with esair.Robot(resources=[Sonar()], behaviors=[user]) as robot:
        assert refused
        for _ in range(1000):
            if robot.resources.query("sonar").state is ResourceState.READY:
                break
            await asyncio.sleep(0.01)
        assert await user.sonar.read() == 1.0
        assert not robot.sensors.channels["sonar"].calls.alive


@pytest.mark.promise("RES-1")
async def test_tools_see_whose_driver_runs(user_of: Any) -> None:
    """In its first step and afterwards."""
    names: list[str] = []

    class Sonar(esair.Sensor[float]):
        async def read(self) -> float:
            task = asyncio.current_task()
            assert task is not None
            names.append(task.get_name())
            await asyncio.sleep(0.01)
            names.append(task.get_name())
            return 1.0

    user = user_of("user", sonar=esair.reads(float))
    async with esair.Robot(resources=[Sonar()], behaviors=[user]):
        assert await user.sonar.read() == 1.0
    assert all("sonar" in name for name in names)


@pytest.mark.promise("CALL-1")
async def test_calls_that_overlap_have_each_its_own_deadline() -> None:
    """Whichever began first, and also when one of them has ended meanwhile."""
    motor = Motor(10.0, name="motor")
    calls = Calls(
        Driver(motor),
        asyncio.get_running_loop(),
        on_late=lambda _call: None,
        on_stuck=lambda _call: None,
        left=set(),
    )
    told: list[tuple[float, float]] = []

    async def call(limit: float) -> None:
        method = calls.driver.method("write")
        with pytest.raises(esair.DriverStuckError, match=f"{limit:g}"):
            await calls.run("write", method, 1.0, limit=limit)
        told.append((limit, round(now(), 6)))

    async def short() -> None:
        await calls.run("safe", calls.driver.method("write"), 0.0, limit=0.05)

    motor.safe_takes = 0.02
    await asyncio.gather(*(call(limit) for limit in (0.3, 0.1, 0.2)), short())

    assert told == [(0.1, 0.1), (0.2, 0.2), (0.3, 0.3)]
