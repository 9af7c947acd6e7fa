"""A rover that drives on and turns away from whatever comes too close."""

import math

import attrs

import esair


@attrs.frozen
class Twist:
    """How the rover moves."""

    linear: float  # m/s
    angular: float  # rad/s


class Sonar(esair.Sensor[float]):
    """The way ahead in metres; pretends that a wall comes and goes."""

    asked = 0

    async def read(self) -> float:
        self.asked += 1
        return 0.6 + 0.5 * math.cos(self.asked / 8)


class Wheels(esair.Actuator[Twist]):
    """Prints what real wheels would do."""

    safe = Twist(0.0, 0.0)
    command_timeout = 0.2
    last = None

    async def write(self, command: Twist) -> None:
        if command != self.last:
            print(command, flush=True)
        self.last = command


class Avoid(esair.Reaction):
    """Turn away from anything closer than 0.4 m; who cannot see holds still."""

    sonar = esair.reads(float)
    wheels = esair.writes(Twist, priority=10)

    def react(self, sonar: float) -> Twist | None:
        return Twist(0.0, 1.2) if sonar < 0.4 else None


class Wander(esair.Behavior):
    """Drive on, whatever happens."""

    wheels = esair.writes(Twist)

    async def run(self) -> None:
        async for _ in esair.every(0.05):
            await self.wheels.write(Twist(0.3, 0.0))


robot = esair.Robot(resources=[Sonar(), Wheels()], behaviors=[Avoid(), Wander()])

if __name__ == "__main__":
    esair.run(robot)
