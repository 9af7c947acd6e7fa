"""What zigzag does, with fake devices and without waiting."""

from scout.actions import Wander
from scout.commands import Twist
from scout.zigzag import Avoid, ZigZag

import esair


async def test_turns_left_and_then_right(fake_actuator):
    """One second each way."""
    wheels = fake_actuator("wheels", safe=Twist(0.0, 0.0))

    async with esair.Robot(resources=[wheels], behaviors=[ZigZag()]):
        await wheels.until(Twist(0.3, 0.6), timeout=0.5)
        await wheels.until(Twist(0.3, -0.6), timeout=1.5)

    assert wheels.commands[-1] == Twist(0.0, 0.0)


async def test_takes_the_place_of_wander(fake_sensor, fake_actuator):
    """While the robot runs; and avoid has the last word."""
    sonar = fake_sensor("sonar", 2.0)
    wheels = fake_actuator("wheels", safe=Twist(0.0, 0.0))

    async with esair.Robot(resources=[sonar, wheels], behaviors=[Wander()]) as robot:
        await wheels.until(Twist(0.3, 0.0), timeout=0.5)

        await robot.behaviors.add(Avoid())
        await robot.behaviors.replace("wander", ZigZag())

        await wheels.until(Twist(0.3, 0.6), timeout=0.5)
        sonar.feed(0.2)
        await wheels.until(Twist(0.0, 1.2), timeout=0.5)
