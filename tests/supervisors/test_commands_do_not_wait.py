"""Commands change the table; nothing that hangs keeps another command waiting."""

from __future__ import annotations

import asyncio
import contextlib
import gc
from collections.abc import Awaitable, Callable, Iterator
from typing import Any

import pytest
from tests.supervisors.actors import Idle, soon

import esair
from esair.testing import FakeActuator

pytestmark = [pytest.mark.virtual_clock, pytest.mark.promise("SUP-3")]

GRACE = 0.3


class Hangs(esair.Behavior):
    """Its setup does not end."""

    async def setup(self) -> None:
        await asyncio.sleep(1000.0)


class Swallows(esair.Behavior):
    """Writes, and ignores its cancellation, in its run and its clean-up."""

    wheels = esair.writes(float)

    async def run(self) -> None:
        await self.wheels.write(1.0)
        await self.swallow()

    async def teardown(self) -> None:
        await self.swallow()

    async def swallow(self) -> None:
        for _ in range(3):
            with contextlib.suppress(asyncio.CancelledError):
                await asyncio.sleep(1.0)


class Calls(esair.Behavior):
    """Gives a command to its own robot in its setup."""

    robot: esair.Robot

    def __init__(self, command: Callable[[esair.Robot], Awaitable[Any]]) -> None:
        super().__init__()
        self.command = command

    async def setup(self) -> None:
        await self.command(self.robot)


@contextlib.contextmanager
def takes(least: float, most: float) -> Iterator[None]:
    loop = asyncio.get_running_loop()
    begin = loop.time()
    yield
    assert least <= loop.time() - begin <= most


@pytest.mark.parametrize("deadline", [1.0, 5.0])
@pytest.mark.parametrize("stalls", [True, False])
async def test_a_removal_takes_its_grace_period_at_most(
    deadline: float, stalls: bool
) -> None:
    """Whatever the behavior and its actuator do: deadlines do not add up."""
    wheels = FakeActuator("wheels", safe=0.0)
    wheels.deadline = deadline
    async with esair.Robot(
        resources=[wheels], behaviors=[Swallows()], grace=GRACE
    ) as robot:
        await asyncio.sleep(0.01)
        if stalls:
            wheels.stall()
        with takes(0.0, GRACE + 0.1):
            await robot.behaviors.remove("swallows")
        wheels.resume()
        assert robot.behaviors.names() == []
        await asyncio.sleep(10.0)  # the zombie ends


async def test_an_actuator_that_hangs_is_waited_for_no_longer() -> None:
    """Also where the behavior ends at once, its safe command has the grace period."""

    class Writes(esair.Behavior):
        wheels = esair.writes(float)

        async def run(self) -> None:
            await self.wheels.write(1.0)
            await asyncio.sleep(1000.0)

    wheels = FakeActuator("wheels", safe=0.0)
    wheels.deadline = 5.0
    async with esair.Robot(
        resources=[wheels], behaviors=[Writes()], grace=GRACE
    ) as robot:
        await asyncio.sleep(0.01)
        wheels.stall()
        with takes(0.0, GRACE + 0.1):
            await robot.behaviors.remove("writes")
        wheels.resume()
        await asyncio.sleep(0.01)
        assert wheels.commands[-1] == 0.0


async def test_a_setup_that_hangs_keeps_nobody_waiting() -> None:
    """Other commands are done at once; its own removal ends it, and tells the adder."""
    async with esair.Robot(behaviors=[Idle(name="a")], grace=GRACE) as robot:
        adding = await soon(robot.behaviors.add(Hangs()))
        with takes(0.0, 0.0):
            await robot.behaviors.remove("a")
            await robot.behaviors.add(Idle(name="b"))
            await robot.behaviors.replace("b", Idle())
            await robot.behaviors.remove("hangs")
            with pytest.raises(esair.BehaviorRemovedError, match="hangs"):
                await adding
        assert robot.behaviors.names() == ["b"]
        await robot.behaviors.add(Idle(name="hangs"))


async def test_a_setup_has_a_time_limit() -> None:
    """After that the behavior is not in the robot, and its adder knows why."""
    async with esair.Robot(behaviors=[Idle()], grace=GRACE) as robot:
        with (
            takes(5.0, 5.0 + GRACE + 0.1),
            pytest.raises(esair.BehaviorFailedError, match=r"setup .* 5 s"),
        ):
            await robot.behaviors.add(Hangs())
        with pytest.raises(esair.BehaviorFailedError, match="setup"):
            await robot.behaviors.replace("idle", Hangs())
        assert robot.behaviors.names() == ["idle"]
        state = robot.behaviors.query("idle").state
        assert state is esair.BehaviorState.RUNNING


@pytest.mark.parametrize("at_start", [True, False])
async def test_a_setup_may_give_commands(at_start: bool) -> None:
    """They are done at once, also while the robot starts."""
    calls = Calls(lambda robot: robot.behaviors.add(Idle()))
    robot = calls.robot = esair.Robot(behaviors=[calls] if at_start else [])
    with takes(0.0, 0.01):
        async with robot:
            if not at_start:
                await robot.behaviors.add(calls)
            assert sorted(robot.behaviors.names()) == ["calls", "idle"]


async def test_a_setup_may_remove_its_own_behavior() -> None:
    """Its adder learns that it was removed, and nothing is left."""
    calls = Calls(lambda robot: robot.behaviors.remove("calls"))
    async with esair.Robot(grace=GRACE) as robot:
        calls.robot = robot
        with takes(0.0, GRACE + 0.1), pytest.raises(esair.BehaviorRemovedError):
            await robot.behaviors.add(calls)
        assert robot.behaviors.names() == []


async def test_a_removal_ends_the_replacement_that_is_set_up() -> None:
    """Both are gone, and who replaces is told."""
    async with esair.Robot(behaviors=[Idle()], grace=GRACE) as robot:
        replacing = await soon(robot.behaviors.replace("idle", Hangs()))
        with takes(0.0, GRACE + 0.1):
            await robot.behaviors.remove("idle")
            with pytest.raises(esair.BehaviorRemovedError):
                await replacing
        assert robot.behaviors.names() == []


async def test_the_last_of_two_replacements_stays() -> None:
    """Each takes the place of whoever is there when its setup is done."""

    class Slow(Idle):
        def __init__(self, seconds: float) -> None:
            super().__init__()
            self.seconds = seconds

        async def setup(self) -> None:
            await asyncio.sleep(self.seconds)

    first, second, third = Idle(name="idle"), Slow(2.0), Slow(1.0)
    async with esair.Robot(behaviors=[first], grace=GRACE) as robot:
        replaces = [
            await soon(robot.behaviors.replace("idle", each))
            for each in (second, third)
        ]
        await asyncio.gather(*replaces)
        assert robot._behaviors.members["idle"].action is second
        assert "_host" not in vars(third)


async def test_a_replacement_that_is_given_up_leaves_no_gate() -> None:
    """A setup that ignored its end does not wait for its turn for ever."""
    reached: list[str] = []

    class Stubborn(Idle):
        async def setup(self) -> None:
            for _ in range(3):
                with contextlib.suppress(asyncio.CancelledError):
                    await asyncio.sleep(2.0)

        async def run(self) -> None:
            reached.append("run")

        async def teardown(self) -> None:
            reached.append("teardown")

    async with esair.Robot(behaviors=[Idle()], grace=GRACE) as robot:
        replacing = await soon(robot.behaviors.replace("idle", Stubborn()))
        replacing.cancel()
        with pytest.raises(asyncio.CancelledError):
            await replacing
        assert robot._behaviors.zombie_count == 1
        await asyncio.sleep(10.0)
        assert reached == ["teardown"]
        assert not robot._behaviors.undead


async def test_what_would_not_end_is_kept_until_it_ends() -> None:
    """The loop keeps weak references only: the collector must not destroy it."""
    ended: list[str] = []

    class Late(Idle):
        async def run(self) -> None:
            try:
                await self.forever()
            finally:
                ended.append("closed")

        async def forever(self) -> None:
            for _ in range(3):
                with contextlib.suppress(asyncio.CancelledError):
                    await asyncio.sleep(5.0)
            ended.append("by itself")

    async with esair.Robot(behaviors=[Late()], grace=GRACE) as robot:
        await asyncio.sleep(0)
        await robot.behaviors.remove("late")
        gc.collect()
        await asyncio.sleep(20.0)
        assert ended == ["by itself", "closed"]
        assert [zombie.behavior for zombie in robot.behaviors.zombies] == ["late"]
        assert not robot._behaviors.undead


async def test_a_second_removal_waits_for_the_first() -> None:
    """Then the name is unknown; other commands do not wait meanwhile."""
    wheels = FakeActuator("wheels", safe=0.0)
    async with esair.Robot(
        resources=[wheels], behaviors=[Swallows(), Idle()], grace=GRACE
    ) as robot:
        await asyncio.sleep(0.01)
        first = await soon(robot.behaviors.remove("swallows"))
        second = await soon(robot.behaviors.remove("swallows"))
        with takes(0.0, 0.0):
            await robot.behaviors.remove("idle")
        with takes(GRACE, GRACE + 0.1):
            await first
            with pytest.raises(esair.UnknownNameError):
                await second
        await asyncio.sleep(10.0)  # the zombie ends


class Counts(Idle):
    """Counts its runs, and crashes or ends when it is told to."""

    restart = esair.Restart(max=0)

    def __init__(self) -> None:
        super().__init__()
        self.runs = 0
        self.told: asyncio.Queue[str] = asyncio.Queue()

    async def run(self) -> None:
        self.runs += 1
        if await self.told.get() == "crash":
            raise RuntimeError("told to")


@pytest.mark.promise("SUP-4")
@pytest.mark.parametrize("before", ["running", "failed", "finished"])
async def test_the_user_may_restart_a_behavior(before: str) -> None:
    """Whatever it did before; what lies in its inbox is for the new run."""
    behavior = Counts()
    async with esair.Robot(behaviors=[behavior], grace=GRACE) as robot:
        put = robot.behaviors.put
        await put("kept", sender="user", receiver="counts")
        if before != "running":
            behavior.told.put_nowait("crash" if before == "failed" else "end")
        await asyncio.sleep(0.1)
        assert robot.behaviors.query("counts").state.value == before
        with takes(0.0, 0.01):
            await robot.behaviors.restart("counts")
        await asyncio.sleep(0.1)
        status = robot.behaviors.query("counts")
        assert (status.state, status.error) == (esair.BehaviorState.RUNNING, None)
        assert behavior.runs == 2
        assert await behavior.receive() == "kept"
        with pytest.raises(esair.UnknownNameError):
            await robot.behaviors.restart("nobody")


async def test_a_restart_does_not_wait_for_what_swallows_its_end() -> None:
    """The new run begins after the grace period; the old one speaks for nobody."""
    wheels = FakeActuator("wheels", safe=0.0)
    async with esair.Robot(
        resources=[wheels], behaviors=[Swallows()], grace=GRACE
    ) as robot:
        await asyncio.sleep(0.01)
        with takes(GRACE, GRACE + 0.1):
            await robot.behaviors.restart("swallows")
        await asyncio.sleep(0.01)
        assert wheels.commands[-1] == 1.0
        await robot.behaviors.remove("swallows")
        await asyncio.sleep(10.0)  # the zombies end


class Drives(esair.Behavior):
    """Writes without end."""

    wheels = esair.writes(float)

    async def run(self) -> None:
        async for _ in esair.every(0.05):
            await self.wheels.write(1.0)


async def test_what_is_being_removed_does_not_come_back() -> None:
    """A restart waits for a removal, also while only the actuator is made safe."""
    wheels = FakeActuator("wheels", safe=0.0)
    async with esair.Robot(resources=[wheels], behaviors=[Drives()]) as robot:
        await asyncio.sleep(0.12)
        wheels.slow(0.3)
        removal = asyncio.create_task(robot.behaviors.remove("drives"))
        await asyncio.sleep(0.1)
        with pytest.raises(esair.UnknownNameError):
            await robot.behaviors.restart("drives")
        await removal
        told = len(wheels.commands)
        await asyncio.sleep(1.0)
        assert wheels.commands[told:] in ([], [0.0])


class Slow(esair.Behavior):
    """Takes a second to be set up, and some time to end; notes what it does."""

    def __init__(self) -> None:
        super().__init__()
        self.log: list[str] = []

    async def setup(self) -> None:
        self.log.append("setup")
        await asyncio.sleep(1.0)

    async def run(self) -> None:
        self.log.append("run")
        try:
            await asyncio.sleep(1000.0)
        finally:
            await asyncio.sleep(0.2)


@pytest.mark.parametrize("after", [0.0, 0.1, 0.5])
async def test_who_gives_up_a_restart_has_it_happen_all_the_same(after: float) -> None:
    """It has ended a run: one that is left half done would leave none."""
    behavior = Slow()
    async with esair.Robot(behaviors=[behavior]) as robot:
        await asyncio.sleep(2.0)
        restarting = await soon(robot.behaviors.restart("slow"))
        await asyncio.sleep(after)
        restarting.cancel()
        await asyncio.sleep(2.0)
        assert restarting.cancelled()
        assert behavior.log == ["setup", "run"] * 2
        assert robot.behaviors.query("slow").state is esair.BehaviorState.RUNNING


async def test_who_gives_up_the_restart_of_a_device_has_it_happen() -> None:
    """Also where it waits for a replacement: what has come is restarted then."""

    class Motor(FakeActuator[float]):
        openings = 0

        async def open(self) -> None:
            self.openings += 1
            await super().open()

        async def close(self) -> None:
            await asyncio.sleep(0.1)
            await super().close()

    old, new = Motor("motor", safe=0.0), Motor("motor", safe=0.0)
    async with esair.Robot(resources=[old]) as robot:
        replacing = await soon(robot.resources.replace("motor", new))
        restarting = await soon(robot.resources.restart("motor"))
        restarting.cancel()
        await replacing
        await asyncio.sleep(1.0)
        assert (old.openings, new.openings) == (1, 2)


@pytest.mark.parametrize("verb", ["remove", "replace"])
async def test_a_device_that_is_slow_to_close_keeps_no_command_waiting(
    verb: str,
) -> None:
    """It is fenced in one step; what follows goes its own way."""

    class Motor(FakeActuator[float]):
        async def close(self) -> None:
            await asyncio.sleep(0.2)
            await super().close()

    parts = [Motor("motor", safe=0.0), FakeActuator("other", safe=0.0)]
    async with esair.Robot(resources=parts) as robot:
        terms = ["motor", FakeActuator("motor", safe=0.0)][: 1 + (verb == "replace")]
        going = await soon(getattr(robot.resources, verb)(*terms))
        with takes(0.0, 0.1):
            await robot.resources.restart("other")
        assert not going.done()
        await going


@pytest.mark.promise("SUP-3")
async def test_a_restart_of_what_is_removed_meanwhile_says_so() -> None:
    """It waits for the old run, and there is nobody who could begin another."""
    async with esair.Robot(
        resources=[FakeActuator("wheels", safe=0.0)],
        behaviors=[Swallows()],
        grace=GRACE,
    ) as robot:
        await asyncio.sleep(0.01)
        restart = asyncio.create_task(robot.behaviors.restart("swallows"))
        await asyncio.sleep(GRACE / 2)
        await robot.behaviors.remove("swallows")
        with pytest.raises(esair.BehaviorRemovedError):
            await restart
        await asyncio.sleep(10.0)  # the zombie ends
