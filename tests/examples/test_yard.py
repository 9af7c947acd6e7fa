"""The world of the docking rover."""

import asyncio

import pytest
import yard


@pytest.mark.virtual_clock
async def test_the_stone_stops_the_rover_until_it_backs_off() -> None:
    """It stands at 0.4 m; backing off kicks the stone away."""
    world = yard.Yard()
    world.bearing = 0.0
    world.look()
    for speed, distance in ((0.4, 0.4), (-0.1, 0.5), (0.1, 0.4), (0.4, 0.0)):
        world.twist = yard.Twist(speed, 0.0)
        for _ in range(50 if speed == 0.4 else 10):
            await asyncio.sleep(0.1)
            world.look()
        assert world.distance == pytest.approx(distance, abs=0.03)
