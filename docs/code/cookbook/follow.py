"""Lead and follow: one decides, the other does the same a second later.

front   AAAATTTT........
rear    ....AAAATTTT....
"""

import asyncio

import esair


class Lead(esair.Behavior):
    """Drives the front, and tells the rear."""

    front = esair.writes(str)

    async def run(self) -> None:
        for command in ("ahead", "turn"):
            await self.put("follow", command)
            for _ in range(10):
                await self.front.write(command)
                await asyncio.sleep(0.1)


class Follow(esair.Behavior):
    """Drives the rear as it was told."""

    rear = esair.writes(str)

    async def run(self) -> None:
        await asyncio.sleep(1.0)
        while True:
            command = await self.receive(as_type=str)
            for _ in range(10):
                await self.rear.write(command)
                await asyncio.sleep(0.1)


def make_robot(*parts: esair.Resource) -> esair.Robot:
    """Return the robot."""
    return esair.Robot(resources=parts, behaviors=[Lead(), Follow()])
