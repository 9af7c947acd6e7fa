"""The rover that drives to one place after the other."""

import asyncio
import math

import go_to_goal
import pytest
from go_to_goal import Twist
from odometry import Odometry, Pose

import esair


@pytest.mark.virtual_clock
async def test_it_goes_around_the_square(capsys) -> None:
    """It comes to each corner, in order, and its last command is a stop."""
    wheels = go_to_goal.Wheels()
    robot = esair.Robot(
        resources=[
            wheels,
            go_to_goal.Encoder(wheels, 0, name="left"),
            go_to_goal.Encoder(wheels, 1, name="right"),
            Odometry(),
            go_to_goal.Bumper(),
        ],
        behaviors=[go_to_goal.Bumped(), go_to_goal.Tour()],
    )

    async with robot:
        await robot.ended()

    assert capsys.readouterr().out.splitlines() == [
        f"at {corner}" for corner in go_to_goal.Tour.goals
    ]
    assert wheels.twist == Twist(0.0, 0.0)


def test_the_way_to_a_place() -> None:
    """Distance, and the turn by the shorter side."""
    assert Pose(0.0, 0.0, 0.0).to(0.0, 2.0) == pytest.approx((2.0, math.pi / 2))
    assert Pose(0.0, 0.0, math.pi).to(-1.0, -0.1)[1] == pytest.approx(0.0997, abs=1e-3)


async def test_what_touches_the_bumper_is_not_pushed(
    fake_sensor, fake_actuator
) -> None:
    """Turning and backing off pass, driving ahead does not; a silent bumper stops all."""
    bumper = fake_sensor("bumper", True, rate=20.0)
    odometry = fake_sensor("odometry", Pose(0.0, 0.0, 0.0), rate=50.0)
    wheels = fake_actuator("wheels", safe=Twist(0.0, 0.0))
    robot = esair.Robot(
        resources=[bumper, odometry, wheels],
        behaviors=[go_to_goal.Bumped(), go_to_goal.Tour()],
    )

    async with robot:
        await asyncio.sleep(1.0)
        assert not any(command.linear > 0.0 for command in wheels.commands)
        bumper.feed(False)
        await wheels.until(lambda twist: twist.linear > 0.3, timeout=0.2)
        bumper.unplug()
        await wheels.until(Twist(0.0, 0.0), timeout=0.1)
