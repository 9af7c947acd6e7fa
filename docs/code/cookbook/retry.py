"""Retry: three times, with a pause; then the error is the robot's.

wheels  AA..AA..AA......
"""

import asyncio

from steps import Fail

import esair


class Insist(esair.Behavior):
    """Tries three times."""

    restart = esair.Restart(max=0)

    async def run(self) -> None:
        for left in (2, 1, 0):
            try:
                await self.perform(Fail("ahead", 0.5))
            except RuntimeError:
                if not left:
                    raise
            else:
                break
            await asyncio.sleep(0.5)


def make_robot(*parts: esair.Resource) -> esair.Robot:
    """Return the robot."""
    return esair.Robot(resources=parts, behaviors=[Insist()])
