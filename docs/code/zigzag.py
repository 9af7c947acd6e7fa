"""Another way to wander."""

from scout.commands import Twist

import esair


class ZigZag(esair.Behavior):
    """Drive on in curves, so that the sonar sees more of the room."""

    wheels = esair.writes(Twist)

    async def run(self) -> None:
        async for seconds in esair.every(0.05):
            turn = 0.6 if int(seconds) % 2 == 0 else -0.6
            await self.wheels.write(Twist(0.3, turn))
