"""Writing an actuator: what is sent, what is refused, and when it is made safe."""

from __future__ import annotations

import asyncio
import math
from typing import Any

import pytest

import esair
from esair.testing import FakeActuator

pytestmark = pytest.mark.virtual_clock


def priority(value: int, hold: float | None = None) -> Any:
    return esair.writes(float, name="wheels", priority=value, hold=hold)


@pytest.mark.promise("AC-1")
async def test_write_returns_what_was_sent(fake_actuator: Any, user_of: Any) -> None:
    """The answer is true and holds the command that the device got."""
    wheels = fake_actuator("wheels", safe=0.0, limits=(-1.0, 1.0), clamp=True)
    user = user_of("user", wheels=esair.writes(float))

    async with esair.Robot(resources=[wheels], behaviors=[user]):
        written = await user.wheels.write(3.0)

        assert written
        assert written.command == 1.0
        assert wheels.commands == [0.0, 1.0]


@pytest.mark.promise("AC-1")
async def test_write_returns_what_the_driver_says_it_applied(
    fake_actuator: Any, user_of: Any
) -> None:
    """A driver that can do less than was asked says so, and the writer learns it."""

    class Weak(esair.Actuator[float]):
        safe = 0.0

        async def write(self, command: float) -> float:
            if command > 1.0:
                await asyncio.sleep(0.01)
            return command / 2

    user = user_of("user", weak=esair.writes(float))
    async with esair.Robot(resources=[Weak()], behaviors=[user]):
        assert (await user.weak.write(1.0)).command == 0.5
        assert (await user.weak.write(2.0)).command == 1.0


@pytest.mark.promise("AC-1")
@pytest.mark.fault("V01")
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, "fast", None, True])
async def test_a_bad_value_never_reaches_the_device(
    fake_actuator: Any, user_of: Any, value: object
) -> None:
    """It is refused, and the command before it expires into the safe one."""
    wheels = fake_actuator("wheels", safe=0.0)
    user = user_of("user", wheels=esair.writes(float))

    async with esair.Robot(resources=[wheels], behaviors=[user]):
        await user.wheels.write(0.5)
        with pytest.raises(esair.BadValueError):
            await user.wheels.write(value)
        await asyncio.sleep(0.21)

        assert wheels.commands == [0.0, 0.5, 0.0]


@pytest.mark.promise("AC-1", "RS-6")
async def test_a_refusal_says_who_holds_the_actuator(
    fake_actuator: Any, user_of: Any
) -> None:
    """Holder, priority, rule, since and until come with the refusal and with why."""
    wheels = fake_actuator("wheels", safe=0.0)
    high, low = (
        user_of("high", wheels=priority(5, 0.15)),
        user_of("low", wheels=priority(1)),
    )

    async with esair.Robot(resources=[wheels], behaviors=[high, low]) as robot:
        await asyncio.sleep(1.0)
        began = asyncio.get_running_loop().time()
        await high.wheels.write(1.0)
        refused = await low.wheels.write(-1.0)
        why = robot.resources.why("wheels")

        assert not refused
        assert (refused.holder, refused.priority) == ("high", 5)
        assert (refused.since, refused.until) == (began, began + 0.15)
        assert "priority 5 of 'high'" in refused.rule
        assert (why.holder, why.priority, why.rule) == ("high", 5, refused.rule)
        assert (why.since, why.until, why.last) == (began, began + 0.15, 1.0)
        assert "release" in why.frees
        assert "held by high" in str(why)
        assert wheels.commands == [0.0, 1.0]


@pytest.mark.promise("RS-6")
async def test_why_says_that_nobody_holds_it(fake_actuator: Any, user_of: Any) -> None:
    """A free actuator has no holder, and why says whether it is safe."""
    wheels = fake_actuator("wheels", safe=0.0, command_timeout=1.0)
    user = user_of("user", wheels=priority(0, 0.1))

    async with esair.Robot(resources=[wheels], behaviors=[user]) as robot:
        safe = robot.resources.why("wheels")
        await user.wheels.write(1.0)
        await asyncio.sleep(0.2)
        free = user.wheels.why()

    assert safe.holder is None
    assert safe.rule == "it was told its safe command"
    assert "free" in str(safe)
    assert free.holder is None
    assert free.rule == "no hold is in force"


@pytest.mark.promise("AC-2")
@pytest.mark.fault("R13")
async def test_silence_for_the_command_timeout_makes_it_safe(
    fake_actuator: Any, user_of: Any
) -> None:
    """The safe command comes after exactly the time-out, once."""
    wheels = fake_actuator("wheels", safe=0.0, command_timeout=0.3)
    user = user_of("user", wheels=esair.writes(float))

    async with esair.Robot(resources=[wheels], behaviors=[user]):
        for _ in range(5):
            await user.wheels.write(1.0)
            await asyncio.sleep(0.25)
        await asyncio.sleep(0.04)
        assert wheels.commands[-1] == 1.0
        await asyncio.sleep(0.02)
        assert wheels.commands == [0.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.0]
        await asyncio.sleep(2.0)
        assert len(wheels.commands) == 7


@pytest.mark.promise("AC-2", "RS-4")
@pytest.mark.parametrize(
    ("timeout", "after"), [(0.5, 0.5), (0.05, 0.1), (20.0, 20.0), (10.0, 10.0)]
)
async def test_a_time_out_that_is_changed_counts_for_what_stands(
    timeout: float, after: float, user_of: Any
) -> None:
    """From the last write on, or at once if that is long ago."""
    told: list[tuple[float, float]] = []

    class Wheels(esair.Actuator[float]):
        safe = 0.0
        command_timeout = esair.setting(10.0, unit="s", min=0.01, max=60.0)

        async def write(self, command: float) -> None:
            told.append((command, esair.now()))

    user = user_of("user", wheels=esair.writes(float, configure=True))
    async with esair.Robot(resources=[Wheels()], behaviors=[user]):
        await user.wheels.write(0.5)
        await asyncio.sleep(0.1)
        await user.wheels.configure(command_timeout=timeout)
        await asyncio.sleep(30.0)
        (_, _), (moves, began), (safe, ended) = told
        assert (moves, safe) == (0.5, 0.0)
        assert ended - began == pytest.approx(after, abs=1e-6)


@pytest.mark.promise("AC-2")
@pytest.mark.fault("R13")
async def test_a_long_hold_keeps_others_away_but_does_not_keep_it_moving(
    fake_actuator: Any, user_of: Any
) -> None:
    """After the command time-out it is safe, and still held until the hold ends."""
    wheels = fake_actuator("wheels", safe=0.0)
    high, low = user_of("high", wheels=priority(5)), user_of("low", wheels=priority(1))

    async with esair.Robot(resources=[wheels], behaviors=[high, low]):
        await high.wheels.write(1.0, hold=1.0)
        await asyncio.sleep(0.3)
        assert wheels.commands == [0.0, 1.0, 0.0]
        assert not await low.wheels.write(0.5)
        await asyncio.sleep(0.75)
        assert await low.wheels.write(0.5)


@pytest.mark.promise("AC-2")
async def test_release_lets_lower_priorities_through_at_once(
    fake_actuator: Any, user_of: Any
) -> None:
    """What it was told stays until the time-out; only the hold ends."""
    wheels = fake_actuator("wheels", safe=0.0)
    high, low = user_of("high", wheels=priority(5)), user_of("low", wheels=priority(1))

    async with esair.Robot(resources=[wheels], behaviors=[high, low]):
        await high.wheels.write(1.0)
        low.wheels.release()  # it holds nothing: nothing happens
        assert not await low.wheels.write(0.5)
        high.wheels.release()
        assert wheels.commands == [0.0, 1.0]
        assert await low.wheels.write(0.5)
        assert not await user_of_same_priority(low, high)


async def user_of_same_priority(low: Any, high: Any) -> object:
    """Low holds now, and high has given it back: high takes it again."""
    await high.wheels.write(1.0)
    return await low.wheels.write(0.5)


@pytest.mark.promise("AC-2")
async def test_the_same_priority_does_not_get_through(
    fake_actuator: Any, user_of: Any
) -> None:
    """First come, first served, until the holder is silent for its hold."""
    wheels = fake_actuator("wheels", safe=0.0)
    first, second = (
        user_of("first", wheels=priority(1)),
        user_of("second", wheels=priority(1)),
    )

    async with esair.Robot(resources=[wheels], behaviors=[first, second]):
        assert await first.wheels.write(1.0)
        assert not await second.wheels.write(0.5)
        await asyncio.sleep(0.2)
        assert await second.wheels.write(0.5)


@pytest.mark.promise("AC-2")
@pytest.mark.fault("R04")
async def test_the_old_owner_is_finished_before_the_new_one_begins(
    fake_actuator: Any, user_of: Any
) -> None:
    """A write in flight ends before that of a higher priority is sent."""
    log: list[str] = []

    class Slow(esair.Actuator[float]):
        safe = 0.0

        async def write(self, command: float) -> None:
            log.append(f"begin {command}")
            if command:
                await asyncio.sleep(0.05)
            log.append(f"end {command}")

    low = user_of("low", slow=esair.writes(float, priority=1))
    high = user_of("high", slow=esair.writes(float, priority=2))
    async with esair.Robot(resources=[Slow()], behaviors=[low, high]):
        first = asyncio.create_task(low.slow.write(1.0))
        await asyncio.sleep(0.01)
        assert await high.slow.write(2.0)
        assert await first
        assert not await low.slow.write(1.0)

    assert log[2:6] == ["begin 1.0", "end 1.0", "begin 2.0", "end 2.0"]
    assert log[-1] == "end 0.0"


@pytest.mark.fault("V03")
async def test_after_a_pause_it_ramps_from_the_safe_command(
    fake_actuator: Any, user_of: Any
) -> None:
    """A long silence does not turn the slew limit into a jump."""
    wheels = fake_actuator("wheels", safe=0.0, slew=1.0)
    user = user_of("user", wheels=esair.writes(float))

    async with esair.Robot(resources=[wheels], behaviors=[user]):
        await asyncio.sleep(100.0)
        assert (await user.wheels.write(5.0)).command == pytest.approx(0.2)
        await asyncio.sleep(0.1)
        assert (await user.wheels.write(5.0)).command == pytest.approx(0.3)
        await asyncio.sleep(100.0)
        assert (await user.wheels.write(5.0)).command == pytest.approx(0.2)


@pytest.mark.promise("ROB-4")
async def test_right_after_a_halt_it_ramps_from_that_moment(
    fake_actuator: Any, user_of: Any
) -> None:
    """From when it was told safe, not from when somebody wrote last."""
    wheels = fake_actuator("wheels", safe=0.0, slew=1.0)
    user = user_of("user", wheels=esair.writes(float))

    async with esair.Robot(resources=[wheels], behaviors=[user]) as robot:
        await asyncio.sleep(1.0)
        await user.wheels.write(5.0)
        await asyncio.sleep(0.19)
        await robot.halt("a cat")
        robot.resume()
        await asyncio.sleep(0.01)
        assert (await user.wheels.write(5.0)).command == pytest.approx(0.01)


@pytest.mark.promise("AC-1")
@pytest.mark.fault("M17")
@pytest.mark.parametrize("hold", [0, -1.0, math.nan, math.inf, True, "long"])
async def test_a_hold_is_a_number_of_seconds(
    fake_actuator: Any, user_of: Any, hold: Any
) -> None:
    """A hold that never ends, or never began, is refused on both ways to write."""
    wheels = fake_actuator("wheels", safe=0.0)
    user = user_of("user", wheels=esair.writes(float))

    async with esair.Robot(resources=[wheels], behaviors=[user]) as robot:
        with pytest.raises(esair.BadValueError, match="hold"):
            await user.wheels.write(1.0, hold=hold)
        with pytest.raises(esair.BadValueError, match="hold"):
            await robot.actuators.write(user.wheels.registration, 1.0, hold=hold)
        assert wheels.commands == [0.0]


@pytest.mark.promise("AC-1")
async def test_the_connection_writes_what_the_port_would(
    fake_actuator: Any, user_of: Any
) -> None:
    """`robot.actuators.write` takes a registration, and has the same answers."""
    wheels = fake_actuator("wheels", safe=0.0)
    user = user_of("user", wheels=esair.writes(float))

    async with esair.Robot(resources=[wheels], behaviors=[user]) as robot:
        assert robot.actuators.names() == ["wheels"]
        assert await robot.actuators.write(user.wheels.registration, 1.0, hold=0.5)
        wheels.stall()
        writing = asyncio.create_task(
            robot.actuators.write(user.wheels.registration, 0.5)
        )
        await asyncio.sleep(0.01)
        wheels.resume()
        assert await writing
        with pytest.raises(esair.UnknownNameError, match="whels"):
            robot.actuators.channel("whels")


@pytest.mark.fault("M11")
async def test_waiting_writes_are_bounded(fake_actuator: Any, user_of: Any) -> None:
    """Over the bound a write is refused at once, and the others get their outcome."""
    wheels = fake_actuator("wheels", safe=0.0, command_timeout=5.0)
    user = user_of("user", wheels=esair.writes(float))

    async with esair.Robot(resources=[wheels], behaviors=[user]):
        wheels.stall()
        writes = [asyncio.create_task(user.wheels.write(1.0)) for _ in range(257)]
        await asyncio.sleep(0.01)
        with pytest.raises(esair.BusyError, match="256"):
            await user.wheels.write(1.0)
        wheels.resume()
        assert all(await asyncio.gather(*writes))
        assert len(wheels.commands) == 258


@pytest.mark.fault("X07")
async def test_a_write_cancelled_while_it_waits_is_never_sent(
    fake_actuator: Any, user_of: Any
) -> None:
    """The next one in line is served."""
    wheels = fake_actuator("wheels", safe=0.0, command_timeout=5.0)
    user = user_of("user", wheels=esair.writes(float))

    async with esair.Robot(resources=[wheels], behaviors=[user]):
        wheels.stall()
        first, second, third = (
            asyncio.create_task(user.wheels.write(value)) for value in (1.0, 2.0, 3.0)
        )
        await asyncio.sleep(0.01)
        second.cancel()
        await asyncio.wait({second})
        wheels.resume()
        await asyncio.gather(first, third)

        assert second.cancelled()
        assert wheels.commands == [0.0, 1.0, 3.0]


@pytest.mark.promise("REA-1", "AC-2")
async def test_a_release_withdraws_the_writes_that_wait(
    fake_actuator: Any, user_of: Any
) -> None:
    """A command that waits for its turn is not sent after its sender gave way."""
    wheels = fake_actuator("wheels", safe=0.0)
    user = user_of("user", wheels=esair.writes(float))
    other = user_of("other", wheels=priority(-1))

    async with esair.Robot(resources=[wheels], behaviors=[user, other]):
        wheels.stall()
        first, second = (
            asyncio.create_task(user.wheels.write(command)) for command in (1.0, 2.0)
        )
        await asyncio.sleep(0.01)
        third = asyncio.create_task(other.wheels.write(3.0))
        await asyncio.sleep(0)
        user.wheels.release()
        wheels.resume()

        assert await first
        refused = await second
        assert not refused
        assert "gave it back" in refused.rule
        await third
        assert wheels.commands[:2] == [0.0, 1.0]
        assert 2.0 not in wheels.commands


@pytest.mark.promise("REA-3")
async def test_a_parked_reaction_sends_nothing_that_waited(
    fake_sensor: Any, fake_actuator: Any, user_of: Any
) -> None:
    """After the safe command of its parking none of its commands comes."""

    class Follow(esair.Reaction):
        sonar = esair.reads(float)
        wheels = esair.writes(float)

        def react(self, sonar: float) -> float | None:
            return sonar if sonar > 1.0 else None

    sonar, wheels = fake_sensor("sonar"), fake_actuator("wheels", safe=0.0)
    user = user_of("user", wheels=esair.writes(float, priority=-1))
    async with esair.Robot(resources=[sonar, wheels], behaviors=[Follow(), user]):
        sonar.feed(1.0)
        await asyncio.sleep(0.01)
        wheels.stall()
        writing = asyncio.create_task(user.wheels.write(7.0))
        await asyncio.sleep(0.01)
        sonar.feed(5.0)  # its command waits behind the one in flight
        await asyncio.sleep(0.01)
        sonar.unplug()
        wheels.resume()
        await writing
        await asyncio.sleep(1.0)

    assert 5.0 not in wheels.commands
    assert wheels.commands[-1] == 0.0


@pytest.mark.promise("AC-1")
@pytest.mark.fault("D02")
@pytest.mark.parametrize("sent", range(5))
@pytest.mark.parametrize("pause", [0.0, 0.01])
async def test_a_write_that_the_unplugging_cut_off_is_never_repeated(
    user_of: Any, sent: int, pause: float
) -> None:
    """Nobody knows whether it was applied: the caller is told just that."""
    wire: list[int] = []

    class Arm(esair.Actuator[int]):
        safe = 0
        cut: int | None = None

        async def write(self, command: int) -> None:
            for index, byte in enumerate(command.to_bytes(4, "big")):
                if index == self.cut:
                    raise ConnectionResetError("unplugged")
                wire.append(byte)
                await asyncio.sleep(pause)
            if self.cut == 4:
                raise ConnectionResetError("unplugged")

    arm, user = Arm(), user_of("user", arm=esair.writes(int))
    async with esair.Robot(resources=[arm], behaviors=[user]) as robot:
        wire.clear()
        arm.cut = sent
        with pytest.raises(esair.DeviceLostError, match="unknown whether 16909060 was"):
            await user.arm.write(0x01020304)
        assert wire == [1, 2, 3, 4][:sent]
        with pytest.raises(esair.DeviceLostError) as caught:
            await user.arm.write(5)
        assert "unknown" not in str(caught.value)  # that one was not sent at all
        assert robot.resources.query("arm").state is esair.ResourceState.LOST
        arm.cut = None
        await asyncio.sleep(10.0)
        assert robot.resources.query("arm").state is esair.ResourceState.READY

    assert set(wire[sent:]) == {0}


@pytest.mark.promise("AC-1")
async def test_what_is_in_flight_is_not_answered_yet() -> None:
    """Who looks what an actuator was told sees that, also after one that was taken."""
    wheels = FakeActuator("wheels", safe=0.0)
    user: Any = esair.Behavior(name="user", writes={"wheels": esair.writes(float)})
    async with esair.Robot(resources=[wheels], behaviors=[user]) as robot:
        channel = robot.actuators.channels["wheels"]
        assert channel.told().answered
        wheels.slow(0.05)
        writing = asyncio.create_task(user.wheels.write(1.0))
        await asyncio.sleep(0.01)
        assert (channel.told().command, channel.told().answered) == (1.0, False)
        await writing
        assert channel.told().answered
