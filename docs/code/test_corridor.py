"""The run in which the rover went for the wall is a test from now on."""

import asyncio

import corridor

import esair
from esair.testing import recording


async def test_a_missed_echo_moves_nothing(fake_actuator):
    """The sonar gives what it gave in the run; near the wall the wheel stands."""
    run = recording("run.mcap")
    wheel = fake_actuator("wheel", safe=0.0, command_timeout=0.5)

    async with esair.Robot(resources=[*run, wheel], behaviors=[corridor.Keep()]):
        await asyncio.sleep(run.duration)

    near = wheel.commands.index(0.0, 1)
    assert set(wheel.commands[near:]) == {0.0}


async def test_no_echo_at_all_moves_nothing(fake_actuator):
    """The same run, and somebody pulls the sonar out amid it."""
    run = recording("run.mcap")
    run.at(0.1, run["sonar"].unplug)
    wheel = fake_actuator("wheel", safe=0.0, command_timeout=0.5)

    async with esair.Robot(resources=[*run, wheel], behaviors=[corridor.Keep()]):
        await asyncio.sleep(0.3)
        assert wheel.commands[-1] == 0.0
