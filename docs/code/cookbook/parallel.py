"""Parallel: two steps at a time; the next begins when both have ended.

arm     LLLLLLLL........
wheels  AAAA....BBBB....
"""

import asyncio

from steps import Drive, Reach

import esair


class Carry(esair.Behavior):
    """Lifts while it drives; an error of either ends both."""

    async def run(self) -> None:
        async with asyncio.TaskGroup() as both:
            both.create_task(self.perform(Reach("lift", 2.0)))
            both.create_task(self.perform(Drive("ahead", 1.0)))
        await self.perform(Drive("back"))


def make_robot(*parts: esair.Resource) -> esair.Robot:
    """Return the robot."""
    return esair.Robot(resources=parts, behaviors=[Carry()])
