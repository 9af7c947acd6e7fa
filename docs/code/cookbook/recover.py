"""Recover and go on: after an error back off, then go on where it was.

wheels  AABBBBTTTTAAAA..
"""

from steps import Drive, Fail

import esair


class Tour(esair.Behavior):
    """Goes on with the leg that failed, once the way is free again."""

    async def run(self) -> None:
        legs = [Fail("ahead", 0.5), Drive("turn"), Drive("ahead")]
        while legs:
            try:
                await self.perform(legs[0])
            except RuntimeError:
                await self.perform(Drive("back"))
            legs.pop(0)


def make_robot(*parts: esair.Resource) -> esair.Robot:
    """Return the robot."""
    return esair.Robot(resources=parts, behaviors=[Tour()])
