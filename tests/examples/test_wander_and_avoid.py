from wander_and_avoid import Avoid, Twist, Wander

import esair


async def test_avoid_turns_away(fake_sensor, fake_actuator):
    """Something close makes the rover turn, whatever wander wants."""
    sonar = fake_sensor("sonar", 0.2)
    wheels = fake_actuator("wheels", safe=Twist(0, 0))

    async with esair.Robot(resources=[sonar, wheels], behaviors=[Avoid(), Wander()]):
        await wheels.until(Twist(0.0, 1.2), timeout=1.0)

    assert wheels.commands[-1] == Twist(0, 0)
