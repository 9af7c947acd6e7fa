"""Another way to wander: in curves, and away from what is close."""

from scout.commands import Twist

import esair


class ZigZag(esair.Behavior):
    """Drive on in curves, so that the sonar sees more of the room."""

    wheels = esair.writes(Twist)

    async def run(self) -> None:
        async for seconds in esair.every(0.05):
            turn = 0.6 if int(seconds) % 2 == 0 else -0.6
            await self.wheels.write(Twist(0.3, turn))


class Avoid(esair.Reaction):
    """Turn away from what is close; else the others may drive."""

    sonar = esair.reads(float)
    wheels = esair.writes(Twist, priority=10)

    def react(self, sonar: float) -> Twist | None:
        return Twist(0.0, 1.2) if sonar < 0.5 else None
