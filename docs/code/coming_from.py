"""Small robots for people who know ROS 2, WPILib or gpiozero."""

import attrs

import esair


@attrs.frozen
class Twist:
    """How the rover moves."""

    linear: float  # m/s
    angular: float  # rad/s


# ROS 2: a node that subscribes to a scan, publishes cmd_vel, and offers a service.


@attrs.frozen
class SetSpeed(esair.Request[float]):
    """The service: its answer is the speed that is driven from now on."""

    speed: float  # m/s


class Cruise(esair.Behavior):
    """The node: two callbacks are two tasks of one behavior."""

    scan = esair.reads(float, max_age=0.5)
    cmd_vel = esair.writes(Twist)
    speed = 0.2

    async def run(self) -> None:
        async for nearest in self.scan:
            if nearest > 0.5:
                await self.cmd_vel.write(Twist(self.speed, 0.0))

    @esair.answers
    async def set_speed(self, request: SetSpeed) -> float:
        """Not above 0.5 m/s."""
        self.speed = min(request.speed, 0.5)
        return self.speed


# WPILib: a subsystem, and an autonomous routine of commands in sequence.


class Ahead(esair.Reaction):
    """A command whose end depends on a sensor reads it; it runs on each reading."""

    sonar = esair.reads(float, max_age=0.3)
    wheels = esair.writes(Twist)

    def react(self, sonar: float) -> Twist:
        return Twist(0.4, 0.0)


class Back(esair.Reaction):
    """A command that needs no sensor has a rate: that of ``periodic``."""

    rate = 50.0
    wheels = esair.writes(Twist)

    def react(self) -> Twist:
        return Twist(-0.2, 0.0)


class Autonomous(esair.Behavior):
    """A SequentialCommandGroup: until something is near, then back for a second."""

    sonar = esair.reads(float)

    async def run(self) -> None:
        await self.perform(Ahead(), until=lambda sonar: sonar < 0.5, timeout=5.0)
        await self.perform(Back(), timeout=1.0)


# gpiozero: an LED whose source is a button


class LedFollowsButton(esair.Reaction):
    """While the button is pressed the LED is on; else anybody may have it."""

    button = esair.reads(bool)
    led = esair.writes(bool)

    def react(self, button: bool) -> bool | None:
        return True if button else None


class Blink(esair.Behavior):
    """led.blink(): it gives way to whoever has a higher priority."""

    led = esair.writes(bool, priority=-1)

    async def run(self) -> None:
        on = False
        async for _ in esair.every(0.5):
            on = not on
            await self.led.write(on, hold=0.6)
