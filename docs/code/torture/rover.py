"""A rover with a mistake that no test of its author has met."""

import attrs

import esair


@attrs.frozen
class Twist:
    """How the rover moves."""

    linear: float  # m/s
    angular: float  # rad/s


class Sonar(esair.Sensor[float]):
    """The way ahead, in metres."""

    rate = 20.0

    async def read(self) -> float:
        raise ConnectionError("there is no sonar at this desk")


class Wheels(esair.Actuator[Twist]):
    """Two wheels."""

    safe = Twist(0.0, 0.0)
    command_timeout = 0.2

    async def write(self, command: Twist) -> None:
        raise ConnectionError("there are no wheels at this desk")


class Avoid(esair.Reaction):
    """Turn away from anything closer than 0.4 m."""

    sonar = esair.reads(float, max_age=0.5)
    wheels = esair.writes(Twist, priority=10, blind="release")

    def react(self, sonar: float) -> Twist | None:
        return Twist(0.0, 1.2) if sonar < 0.4 else None


class Wander(esair.Behavior):
    """Drive on, whatever happens."""

    wheels = esair.writes(Twist)

    async def run(self) -> None:
        async for _ in esair.every(0.05):
            await self.wheels.write(Twist(0.3, 0.0))


class KeepClear(esair.Reaction):
    """Guard the wheels: nothing drives on towards what is closer than 0.3 m."""

    sonar = esair.reads(float)
    wheels = esair.guards(Twist)

    def react(self, sonar: float, wheels: Twist) -> Twist | None:
        return None if sonar < 0.3 and wheels.linear > 0.0 else wheels


robot = esair.Robot(resources=[Sonar(), Wheels()], behaviors=[Avoid(), Wander()])
guarded = esair.Robot(
    resources=[Sonar(), Wheels()], behaviors=[KeepClear(), Avoid(), Wander()]
)
