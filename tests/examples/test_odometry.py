"""The pose that is derived of two encoders."""

import asyncio
import math

import pytest
from odometry import Odometry, Pose

import esair


class Steer(esair.Reaction):
    """Drive on as long as it knows where it is."""

    odometry = esair.reads(Pose)
    wheels = esair.writes(float)

    def react(self, odometry: Pose) -> float:
        return 0.5


@pytest.mark.virtual_clock
async def test_equal_wheels_go_straight_and_opposite_ones_turn() -> None:
    """Half a turn on the spot, then back by what was driven."""
    odometry = Odometry()
    odometry.open()
    half = math.pi * odometry.track / 2
    for left, right in ((0.0, 0.0), (1.0, 1.0), (1.0 - half, 1.0 + half)):
        odometry.compute(left, right)
    pose = odometry.compute(2.0 - half, 2.0 + half)

    assert (pose.x, pose.y) == pytest.approx((0.0, 0.0))
    assert pose.heading == pytest.approx(math.pi)


async def test_without_an_encoder_nobody_drives(fake_sensor, fake_actuator) -> None:
    """The pose is lost with the encoder; it is back with it, and has not jumped."""
    left = fake_sensor("left", 1.0, rate=50.0)
    right = fake_sensor("right", 1.0, rate=50.0)
    wheels = fake_actuator("wheels", safe=0.0)
    odometry = Odometry()

    async with esair.Robot(
        resources=[left, right, odometry, wheels], behaviors=[Steer()]
    ):
        await wheels.until(0.5, timeout=0.5)
        left.unplug()
        await wheels.until(0.0, timeout=0.02)
        await asyncio.sleep(1.0)
        assert wheels.commands[-1] == 0.0
        left.feed(9.0)
        left.plug()
        await wheels.until(0.5, timeout=0.5)

    assert odometry.pose == Pose(0.0, 0.0, 0.0)
