"""Sequence: one step after the other.

arm     ....GGGG........
wheels  AAAA....BBBB....
"""

from steps import Drive, Reach

import esair


class Fetch(esair.Behavior):
    """Drives there, grips, drives back."""

    async def run(self) -> None:
        await self.perform(Drive("ahead"))
        await self.perform(Reach("grip"))
        await self.perform(Drive("back"))


def make_robot(*parts: esair.Resource) -> esair.Robot:
    """Return the robot."""
    return esair.Robot(resources=parts, behaviors=[Fetch()])
