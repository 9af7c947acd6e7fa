import asyncio

from wander_and_avoid import Avoid, Twist, Wander

import esair


async def test_who_cannot_see_holds_still(fake_sensor, fake_actuator):
    """The sonar is pulled out: the wheels stop at once, whatever wander wants."""
    sonar = fake_sensor("sonar", 2.0)
    wheels = fake_actuator("wheels", safe=Twist(0, 0))

    async with esair.Robot(resources=[sonar, wheels], behaviors=[Avoid(), Wander()]):
        await wheels.until(Twist(0.3, 0.0), timeout=1.0)
        sonar.unplug()
        await wheels.until(Twist(0, 0), timeout=0.01)
        told = len(wheels.commands)
        await asyncio.sleep(5.0)
        assert wheels.commands[told:] == []


async def test_avoid_turns_away(fake_sensor, fake_actuator):
    """Something close makes the rover turn, whatever wander wants."""
    sonar = fake_sensor("sonar", 0.2)
    wheels = fake_actuator("wheels", safe=Twist(0, 0))

    async with esair.Robot(resources=[sonar, wheels], behaviors=[Avoid(), Wander()]):
        await wheels.until(Twist(0.0, 1.2), timeout=1.0)

    assert wheels.commands[-1] == Twist(0, 0)
