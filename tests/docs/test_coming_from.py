"""The code of the pages for people who come from elsewhere does what they say."""

import asyncio

from coming_from import Autonomous, Blink, Cruise, LedFollowsButton, SetSpeed, Twist

import esair


async def test_ros_2_the_node_stops_when_its_topic_is_silent(
    fake_sensor, fake_actuator
) -> None:
    """It drives while it hears the scan; the service changes how fast."""
    scan = fake_sensor("scan", 2.0, rate=20.0)
    wheels = fake_actuator("cmd_vel", safe=Twist(0.0, 0.0))

    async with esair.Robot(resources=[scan, wheels], behaviors=[Cruise()]) as robot:
        await wheels.until(Twist(0.2, 0.0), timeout=1.0)
        speed = await robot.behaviors.ask(
            SetSpeed(3.0), sender="user", receiver="cruise"
        )
        assert speed == 0.5
        await wheels.until(Twist(0.5, 0.0), timeout=1.0)
        scan.stall()
        await wheels.until(Twist(0.0, 0.0), timeout=0.5)


async def test_wpilib_the_routine_goes_ahead_then_back(
    fake_sensor, fake_actuator
) -> None:
    """Ahead until something is near, back for a second, and it ends."""
    sonar = fake_sensor("sonar", 2.0, rate=20.0)
    wheels = fake_actuator("wheels", safe=Twist(0.0, 0.0))

    async with esair.Robot(
        resources=[sonar, wheels], behaviors=[Autonomous()]
    ) as robot:
        await wheels.until(Twist(0.4, 0.0), timeout=1.0)
        sonar.feed(0.4)
        await wheels.until(Twist(-0.2, 0.0), timeout=0.2)
        await robot.ended()

    assert wheels.commands[-1] == Twist(0.0, 0.0)


async def test_gpiozero_the_button_has_the_led_while_it_is_pressed(
    fake_sensor, fake_actuator
) -> None:
    """It blinks; pressed it is on without a break."""
    button = fake_sensor("button", False, rate=50.0)
    led = fake_actuator("led", safe=False, command_timeout=0.2)

    async with esair.Robot(
        resources=[button, led], behaviors=[LedFollowsButton(), Blink()]
    ):
        await asyncio.sleep(2.1)
        assert led.commands.count(True) >= 2
        button.feed(True)
        await led.until(True, timeout=0.1)
        told = len(led.commands)
        await asyncio.sleep(2.0)
        assert set(led.commands[told:]) <= {True}
