"""What runs on the computer: it drives on, and says when it has met something."""

import esair


class Explore(esair.Behavior):
    """Drives straight on, faster than the board lets it."""

    wheels = esair.writes(tuple)
    bumper = esair.reads(object)
    touched = 0
    """How many touches it has heard of."""

    async def run(self) -> None:
        before = False
        async for reading in self.bumper:  # each, so that no touch is missed
            touch = bool(reading)
            self.touched += touch and not before
            before = touch
            await self.wheels.write((1.0, 1.0))
