"""An actuator that somebody moves while another takes its place."""

import asyncio
import contextlib
from typing import Any

import pytest

import esair


class Slow(esair.Actuator[float]):
    """Its driver takes 10 ms for each command."""

    safe = 0.0

    def __init__(self) -> None:
        super().__init__(name="motor")
        self.commands: list[float] = []

    async def write(self, command: float) -> None:
        self.commands.append(command)
        await asyncio.sleep(0.01)


class Drive(esair.Behavior):
    """Writes whenever it can."""

    motor = esair.writes(float)

    async def run(self) -> None:
        while True:
            if not await self.motor.write(0.5):
                await asyncio.sleep(0.001)


@pytest.mark.virtual_clock
@pytest.mark.promise("AC-4", "RS-5")
async def test_a_write_that_waits_does_not_follow_the_safe_command() -> None:
    """The old one is left safe; the new one moves on a fresh command."""
    old, new = Slow(), Slow()

    async with esair.Robot(resources=[old], behaviors=[Drive()]) as robot:
        await asyncio.sleep(0.105)  # amid a write
        await robot.resources.replace("motor", new)
        await asyncio.sleep(0.1)
        assert robot.resources.why("motor").holder == "drive"

    assert old.commands[-2:] == [0.5, 0.0]
    assert new.commands[0] == new.commands[-1] == 0.0
    assert 0.5 in new.commands


class Idle(esair.Behavior):
    """Lets others write for it."""

    motor = esair.writes(float)

    async def run(self) -> None:
        await asyncio.Future()


@pytest.mark.virtual_clock
@pytest.mark.parametrize("passes", range(12))
@pytest.mark.promise("AC-4", "RS-5")
async def test_a_write_of_just_then_does_not_follow_the_safe_command(
    passes: int,
) -> None:
    """However few passes of the loop it comes after the safe command has ended."""
    old, new, user = Slow(), Slow(), Idle()

    async with esair.Robot(resources=[old], behaviors=[user]) as robot:
        await user.motor.write(0.5)
        replacing = asyncio.create_task(robot.resources.replace("motor", new))
        await asyncio.sleep(0.01)
        for _ in range(passes):
            await asyncio.sleep(0)
        with contextlib.suppress(esair.DeviceLostError):
            await user.motor.write(0.7)
        await replacing

    assert old.commands == [0.0, 0.5, 0.0]


class Beat(esair.Behavior):
    """Writes on and on, and catches nothing."""

    restart = esair.Restart(max=0)
    motor = esair.writes(float)

    def __init__(self) -> None:
        super().__init__()
        self.answers: list[Any] = []

    async def run(self) -> None:
        async for _ in esair.every(0.01):
            self.answers.append(await self.motor.write(0.5))


class SlowToOpen(Slow):
    """It takes a while to come and to go."""

    async def open(self) -> None:
        await asyncio.sleep(0.2)

    async def close(self) -> None:
        await asyncio.sleep(0.2)


@pytest.mark.virtual_clock
@pytest.mark.promise("SUP-2", "RS-5", "AC-1")
async def test_who_writes_meanwhile_is_refused_and_crashes_not() -> None:
    """The user's will is no loss of a device: it costs its writers no restart."""
    beat = Beat()

    async with esair.Robot(resources=[SlowToOpen()], behaviors=[beat]) as robot:
        await asyncio.sleep(0.5)
        replacing = asyncio.create_task(robot.resources.replace("motor", SlowToOpen()))
        await asyncio.sleep(0.1)
        (refused,) = {each for each in beat.answers if not each}
        assert (refused.holder, refused.rule) == ("user", "it is being replaced")
        why = robot.resources.why("motor")
        assert (why.holder, why.rule, why.since) == (
            refused.holder,
            refused.rule,
            refused.since,
        )
        await replacing
        await asyncio.sleep(0.3)
        assert beat.answers[-1]
        status = robot.behaviors.query("beat")
        assert (status.state, status.restarts) == (esair.BehaviorState.RUNNING, 0)


class NotThere(Slow):
    """It cannot be opened."""

    async def open(self) -> None:
        raise esair.DeviceLostError("motor", "not plugged in")


@pytest.mark.virtual_clock
@pytest.mark.promise("AC-1", "RS-5")
async def test_a_replacement_that_is_not_there_is_lost() -> None:
    """From when that is known its writers are told so, as of any device."""
    user: Any = esair.Behavior(name="user", writes={"motor": esair.writes(float)})

    async with esair.Robot(resources=[Slow()], behaviors=[user]) as robot:
        await user.motor.write(0.5)
        await robot.resources.replace("motor", NotThere())
        await asyncio.sleep(1.0)
        with pytest.raises(esair.DeviceLostError, match="not plugged in"):
            await user.motor.write(0.5)


@pytest.mark.virtual_clock
@pytest.mark.promise("RS-5")
async def test_what_nothing_took_the_place_of_is_lost(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A replacement that fails half way leaves no device, and nobody waits for one."""
    user: Any = esair.Behavior(name="user", writes={"motor": esair.writes(float)})

    def fails(*_args: object) -> None:
        raise OSError("no process can be made")

    async with esair.Robot(resources=[Slow()], behaviors=[user]) as robot:
        monkeypatch.setattr(robot.resources._deployment, "deploy", fails)
        with pytest.raises(OSError, match="no process"):
            await robot.resources.replace("motor", Slow())
        with pytest.raises(esair.DeviceLostError, match="nothing took its place"):
            await user.motor.write(0.5)


@pytest.mark.virtual_clock
@pytest.mark.promise("SUP-2")
async def test_a_replacement_was_tried_when_the_command_returns() -> None:
    """Who has replaced a device may use the new one then."""

    class Late(Slow):
        async def open(self) -> None:
            await asyncio.sleep(0.5)

    async with esair.Robot(resources=[Slow()]) as robot:
        await robot.resources.replace("motor", Late())
        assert robot.resources.query("motor").state is esair.ResourceState.READY


@pytest.mark.virtual_clock
@pytest.mark.promise("ROB-2", "SUP-1")
async def test_a_stop_amid_a_replacement_lets_the_old_device_be_closed() -> None:
    """What goes away goes to its end, though nothing takes its place any more."""
    closed: list[str] = []

    class Closes(Slow):
        async def close(self) -> None:
            await asyncio.sleep(0.3)
            closed.append(self.name)

    async with esair.Robot(resources=[Closes()]) as robot:
        replacing = asyncio.ensure_future(robot.resources.replace("motor", Slow()))
        await asyncio.sleep(0.1)
        assert closed == []
        await robot.stop("amid it")
        assert closed == ["motor"]
        with pytest.raises(esair.StoppingError):
            await replacing


class Closing(Slow):
    """Takes its time to close, too."""

    async def close(self) -> None:
        await asyncio.sleep(0.3)


@pytest.mark.virtual_clock
@pytest.mark.promise("ROB-2", "CALL-2")
async def test_a_stop_knows_that_the_old_one_is_safe() -> None:
    """It was told so and has answered, before it was closed."""
    old = Closing()
    async with esair.Robot(resources=[old], behaviors=[Drive()]) as robot:
        await asyncio.sleep(0.1)
        replacing = asyncio.ensure_future(robot.resources.replace("motor", Slow()))
        await asyncio.sleep(0.2)
        await robot.stop("amid its close")
        with pytest.raises(esair.StoppingError):
            await replacing

    assert old.commands[-1] == 0.0
    assert robot.stopped[0].answered


@pytest.mark.virtual_clock
@pytest.mark.promise("SUP-3", "SUP-5")
async def test_what_goes_when_its_time_is_over_is_told_to_be_safe(
    fake_actuator: Any,
) -> None:
    """The command before, for the same name, has taken all of it."""

    old, new = (fake_actuator("motor", safe=0.0) for _ in range(2))
    robot = esair.Robot(resources=[old], behaviors=[Beat()], grace=0.1)
    async with robot:
        await asyncio.sleep(0.1)
        old.silence()
        old.unplug()
        await asyncio.sleep(0.1)
        replacing = asyncio.ensure_future(robot.resources.replace("motor", new))
        await asyncio.sleep(0)
        await robot.resources.remove("motor")
        await replacing
        assert new.commands[-2:] == [0.5, 0.0]


@pytest.mark.virtual_clock
@pytest.mark.promise("SUP-3", "SUP-5")
@pytest.mark.parametrize("waits", [False, True])
@pytest.mark.parametrize("way", ["removed", "replaced"])
async def test_what_goes_in_little_time_is_told_to_be_safe(
    way: str, waits: bool, fake_actuator: Any
) -> None:
    """Beside a command that takes longer than the grace period, which it may wait for."""
    old, new = (fake_actuator("motor", safe=0.0) for _ in range(2))
    old.slow(0.01)
    robot = esair.Robot(resources=[old], behaviors=[Drive()], grace=0.1)
    async with robot:
        await asyncio.sleep(0.1)
        old.slow(0.0, acknowledge=0.31)
        await asyncio.sleep(0.1)
        if waits:
            robot.halt("it is about to go")
        if way == "removed":
            await robot.resources.remove("motor")
        else:
            await robot.resources.replace("motor", new)

        assert old.commands[-2:] == [0.5, 0.0]
