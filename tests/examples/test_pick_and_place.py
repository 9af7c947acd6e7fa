"""The arm whose eyes are slow and crash."""

import asyncio

import pick_and_place
import pytest
from pick_and_place import Pose

import esair


@pytest.mark.virtual_clock
async def test_the_work_goes_on_when_the_eyes_crash(capsys) -> None:
    """A crash costs one look; the eyes are started again, the arm is not moved blindly."""
    bench = pick_and_place.Bench()

    async with pick_and_place.make_robot(bench) as robot:
        await asyncio.sleep(6.0)
        assert robot.behaviors.query("eyes").restarts >= 1
        assert robot.behaviors.query("work").restarts == 0
        arm = robot.resources.get("arm")
        assert isinstance(arm, pick_and_place.Arm)

    said = capsys.readouterr().out
    assert "no eyes: behavior 'eyes' failed" in said
    assert bench.placed >= 2
    picks = [Pose(0.2, 0.3, grips=False), Pose(0.2, 0.3, grips=True)]
    assert [pose for pose in arm.told if pose.x == 0.2][:2] == picks


async def test_the_arm_stands_while_somebody_is_near(
    fake_sensor, fake_actuator
) -> None:
    """Nothing leaves until they have gone; the work has waited, and goes on."""
    bench = pick_and_place.Bench()
    scanner = fake_sensor("scanner", 0.5, rate=20.0)
    arm = fake_actuator("arm", safe=esair.HOLD, command_timeout=1.0)
    robot = esair.Robot(
        resources=[scanner, arm],
        behaviors=[
            pick_and_place.Fence(),
            pick_and_place.Eyes(bench),
            pick_and_place.Work(bench),
        ],
    )

    async with robot:
        await asyncio.sleep(2.0)
        assert not any(isinstance(command, Pose) for command in arm.commands)
        scanner.feed(3.0)
        await arm.until(Pose(0.2, 0.3, grips=False), timeout=1.0)
