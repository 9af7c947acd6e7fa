"""The user lets what is protected pass for a while."""

from __future__ import annotations

import pytest

import esair
from esair.testing import FakeActuator, FakeSensor


@pytest.mark.virtual_clock
@pytest.mark.promise("PRO-10", "ROB-5")
async def test_a_mute_ends_with_its_robot() -> None:
    """Nothing waits for its end any more: the leak check of this test sees to it."""

    class Shut(esair.Reaction):
        door = esair.reads(bool)
        belt = esair.guards(float)

        def react(self, door: bool, belt: float) -> None:
            """Let nothing pass."""

    class Turn(esair.Behavior):
        belt = esair.writes(float)

    turn = Turn()
    door: FakeSensor[bool] = FakeSensor("door", True, type=bool)
    belt: FakeActuator[float] = FakeActuator("belt", safe=0.0)
    robot = esair.Robot(resources=[door, belt], behaviors=[Shut(), turn])
    async with robot:
        assert not await turn.belt.write(0.8)
        robot.behaviors.mute("shut", 20.0, "a trial")
        assert await turn.belt.write(0.8)
    assert belt.commands[-1] == 0.0


@pytest.mark.virtual_clock
@pytest.mark.promise("PRO-10")
async def test_a_behavior_cannot_be_muted() -> None:
    """Its blind hold is its own: it has no limit up to which somebody may."""

    class Turn(esair.Behavior):
        belt = esair.writes(float, blind="safe")

    belt: FakeActuator[float] = FakeActuator("belt", safe=0.0)
    async with esair.Robot(resources=[belt], behaviors=[Turn()]) as robot:
        with pytest.raises(esair.BadValueError, match="seconds"):
            robot.behaviors.mute("turn", 0.5, "a trial")


@pytest.mark.virtual_clock
@pytest.mark.promise("PRO-9", "PRO-10")
async def test_no_behavior_mutes_or_resets() -> None:
    """Not even one that has the robot in its hands, in a task or in a thread."""

    class Shut(esair.Reaction):
        rate = 10.0
        belt = esair.guards(float, latch=True)

        def react(self, belt: float) -> None:
            """Let nothing pass."""

    def tries() -> None:
        with pytest.raises(esair.AccessDeniedError, match="only the user"):
            robot.behaviors.mute("shut", 20.0, "a trial")
        with pytest.raises(esair.AccessDeniedError, match="only the user"):
            robot.behaviors.reset("shut")

    class Turn(esair.Behavior):
        belt = esair.writes(float)

        async def run(self) -> None:
            tries()
            assert not await self.belt.write(0.8)

    class Think(esair.ThreadBehavior):
        def run(self) -> None:
            tries()

    belt: FakeActuator[float] = FakeActuator("belt", safe=0.0)
    robot = esair.Robot(resources=[belt], behaviors=[Shut(), Turn(), Think()])
    async with robot:
        await robot.ended()
