"""Race: whoever is first ends the other. The beacon comes into sight after 1.5 s.

beacon  ------##########
wheels  TTTTTTAAAA......
"""

import asyncio

from steps import Drive

import esair


class Sight(esair.Behavior):
    """Ends when the beacon is in sight."""

    beacon = esair.reads(bool)

    async def run(self) -> str:
        async for seen in self.beacon:
            if seen:
                break
        return "seen"


class Search(esair.Behavior):
    """Turns until it sees the beacon, or has turned for a minute."""

    async def run(self) -> None:
        if await self.first(Sight(), Drive("turn", 60.0)) == "seen":
            await self.perform(Drive("ahead"))

    async def first(self, *steps: esair.Behavior) -> object:
        """Return the outcome of the first that ends; the others are ended."""
        async with asyncio.TaskGroup() as group:
            tasks = [group.create_task(self.perform(step)) for step in steps]
            done, _ = await asyncio.wait(tasks, return_when="FIRST_COMPLETED")
            for task in tasks:
                task.cancel()
        return done.pop().result()


def make_robot(*parts: esair.Resource) -> esair.Robot:
    """Return the robot."""
    return esair.Robot(resources=parts, behaviors=[Search()])
