"""The rover that follows a vehicle, both simulated."""

import asyncio

import pytest

pytest.importorskip("pymavlink", reason="pip install 'esair[mavlink]'")

import follow_me

from esair.drivers.mavlink import Position


def apart(robot):
    places = [robot.sensors.channel(each).newest.value for each in ("own", "leader")]
    assert all(isinstance(each, Position) for each in places)
    return sum(each**2 for each in follow_me.to_metres(*places)) ** 0.5


@pytest.mark.long
@pytest.mark.virtual_clock
async def test_it_follows_and_stands_without_a_leader(capsys) -> None:
    """It comes near and stays there; it does not drive on to where the leader was."""
    rover, leader = follow_me.simulated()
    async with follow_me.make_robot(rover, leader) as robot:
        await asyncio.sleep(1.5)
        assert apart(robot) > 15.0
        await asyncio.sleep(28.0)
        for _ in range(20):
            await asyncio.sleep(1.0)
            assert 4.0 < apart(robot) < 14.0
        leader.unplug()
        await asyncio.sleep(3.0)
        before = robot.sensors.channel("own").newest.value
        await asyncio.sleep(3.0)
        after = robot.sensors.channel("own").newest.value
        assert follow_me.to_metres(after, before) == (0.0, 0.0)

    assert " m\n" in capsys.readouterr().out
