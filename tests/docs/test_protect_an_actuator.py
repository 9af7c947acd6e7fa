"""The code of the how-to "protect an actuator" does what the page says."""

import asyncio

import pytest
from guarded import Door, Drive, Slow

import esair


async def test_the_belt_stops_when_the_door_opens(fake_sensor, fake_actuator):
    """Without another write; and it starts again when the user says so."""
    door = fake_sensor("door", False, rate=20.0)
    belt = fake_actuator("belt", safe=0.0, command_timeout=60.0)
    work = esair.Behavior(name="work", writes={"belt": esair.writes(float)})

    async with esair.Robot(resources=[door, belt], behaviors=[Door(), work]) as robot:
        assert await work.belt.write(1.0)
        door.feed(True)
        await belt.until(0.0, timeout=0.01)
        with pytest.raises(esair.AccessDeniedError):
            robot.behaviors.reset("door")
        door.feed(False)
        await asyncio.sleep(0.1)
        assert not await work.belt.write(1.0)
        robot.behaviors.reset("door")
        assert await work.belt.write(1.0)


async def test_the_cart_slows_down_and_says_so(fake_sensor, fake_actuator):
    """And without its sensor it only backs off."""
    ahead = fake_sensor("ahead", 0.7, rate=20.0)
    wheels = fake_actuator("wheels", safe=Drive(0.0, 0.0))
    work = esair.Behavior(name="work", writes={"wheels": esair.writes(Drive)})

    async with esair.Robot(resources=[ahead, wheels], behaviors=[Slow(), work]):
        written = await work.wheels.write(Drive(0.5, 0.1))
        assert written.command.speed == pytest.approx(0.2)
        assert (written.asked, written.by) == (Drive(0.5, 0.1), "slow")
        ahead.unplug()
        await asyncio.sleep(0)  # a loss takes effect with the next turn
        written = await work.wheels.write(Drive(0.5, 0.1))
        assert written.command == Drive(0.0, 0.1)
        assert (await work.wheels.write(Drive(-0.1, 0.0))).by is None
