"""Commands of the user that come twice at a time: each has its own outcome."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

import esair
from esair.testing import FakeActuator


async def test_two_restarts_of_a_device_both_end(
    fake_actuator: type[FakeActuator[float]],
) -> None:
    """Who restarts a device that is being restarted does not take the first one's end."""
    arm = fake_actuator("arm", safe=0.0)
    async with esair.Robot(resources=[arm]) as robot:
        arm.stall()
        async with asyncio.timeout(10.0), asyncio.TaskGroup() as group:
            group.create_task(robot.resources.restart("arm"))
            await asyncio.sleep(0)
            group.create_task(robot.resources.restart("arm"))
            await asyncio.sleep(0.1)
            arm.resume()


@pytest.mark.virtual_clock
async def test_two_restarts_of_a_behavior_have_one_outcome_each() -> None:
    """The second one learns that the first has begun it; nobody says it was removed."""

    class Slow(esair.Behavior):
        async def teardown(self) -> None:
            await asyncio.sleep(0.1)

    async with esair.Robot(behaviors=[Slow()]) as robot:
        restarts = [robot.behaviors.restart("slow") for _ in range(2)]
        told = await asyncio.gather(*restarts, return_exceptions=True)

    assert [type(each) for each in told] == [type(None), esair.RefusedError]


async def test_two_removals_of_a_behavior_have_one_outcome_each(
    fake_actuator: type[FakeActuator[float]],
) -> None:
    """The second one learns that there is no such behavior any more."""

    class Push(esair.Reaction):
        rate = 10.0
        arm = esair.writes(float)

        def react(self) -> float:
            return 1.0

    arm = fake_actuator("arm", safe=0.0)
    async with esair.Robot(resources=[arm], behaviors=[Push()]) as robot:
        await arm.until(1.0)
        told = await asyncio.gather(
            robot.behaviors.remove("push"),
            robot.behaviors.remove("push"),
            return_exceptions=True,
        )

    assert [type(each) for each in told] == [list, esair.UnknownNameError]


@pytest.mark.virtual_clock
@pytest.mark.promise("SUP-1")
@pytest.mark.parametrize("verb", ["add", "remove", "replace", "restart"])
@pytest.mark.parametrize("supervisor", ["behaviors", "resources"])
async def test_a_robot_that_is_not_entered_takes_no_command(
    supervisor: str, verb: str
) -> None:
    """Nobody waits for ever for a start that nobody has asked for."""

    def made(name: str) -> Any:
        if supervisor == "behaviors":
            return esair.Behavior(name=name)
        return FakeActuator(name, safe=0.0)

    terms = {"add": [made("b")], "replace": ["a", made("b")]}.get(verb, ["a"])
    options: Any = {supervisor: [made("a")]}
    robot = esair.Robot(**options)
    with pytest.raises(esair.StoppingError, match="enter the robot first"):
        await asyncio.wait_for(getattr(getattr(robot, supervisor), verb)(*terms), 1.0)


@pytest.mark.promise("SUP-3", "MODE-2")
@pytest.mark.parametrize("verb", ["add", "replace"])
async def test_a_failed_command_is_undone_though_its_caller_gives_up(
    verb: str, fake_actuator: type[FakeActuator[float]]
) -> None:
    """Else its name, and every switch, would wait for ever for one that is half gone."""

    class Bad(esair.Behavior):
        arm = esair.writes(float)

        async def setup(self) -> None:
            arm.slow(0.15)
            await self.arm.write(1.0)
            raise ValueError("a bug")

    arm = fake_actuator("arm", safe=0.0)
    rests = esair.Behavior(name="rests")
    modes = {"one": esair.Mode([]), "two": esair.Mode(["rests"])}
    robot = esair.Robot(resources=[arm], behaviors=[rests], modes=modes, mode="one")
    async with robot:
        behaviors = robot.behaviors
        if verb == "replace":
            await behaviors.add(esair.Behavior(name="bad"))
        bad = Bad()
        work = behaviors.add(bad) if verb == "add" else behaviors.replace("bad", bad)
        with pytest.raises(TimeoutError):
            await asyncio.wait_for(work, 0.2)
        async with asyncio.timeout(1.0):
            await behaviors.switch("two")
            if verb == "replace":
                await behaviors.remove("bad")
            await behaviors.add(esair.Behavior(name="bad"))
