"""Fallback: what works first. The first way does not.

wheels  AAAATTTT........
"""

from steps import Drive, Fail

import esair


class Leave(esair.Behavior):
    """Goes ahead, or else turns round, or else backs off."""

    async def run(self) -> None:
        for step in Fail("ahead"), Drive("turn"), Drive("back"):
            try:
                await self.perform(step, timeout=5.0)
            except (RuntimeError, TimeoutError):
                continue
            return


def make_robot(*parts: esair.Resource) -> esair.Robot:
    """Return the robot."""
    return esair.Robot(resources=parts, behaviors=[Leave()])
