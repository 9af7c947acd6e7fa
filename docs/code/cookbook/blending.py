"""Blending of wishes: two want something, a third one drives with the mean of both.

near    --------########
speed   8888888844444444
"""

import esair


class Goal(esair.Behavior):
    """Wants to be fast."""

    async def run(self) -> None:
        self.offer(0.8, latest=True)
        await super().run()


class Care(esair.Behavior):
    """Wants to be as fast as there is room."""

    near = esair.reads(bool)

    async def run(self) -> None:
        async for is_near in self.near:
            self.offer(0.0 if is_near else 0.8, latest=True)


class Blend(esair.Behavior):
    """Asks both, and is the only one that drives."""

    speed = esair.writes(float)

    async def run(self) -> None:
        async for _ in esair.every(0.1):
            wishes = [await self.get(name, as_type=float) for name in ("goal", "care")]
            await self.speed.write(sum(wishes) / len(wishes))


def make_robot(*parts: esair.Resource) -> esair.Robot:
    """Return the robot."""
    return esair.Robot(resources=parts, behaviors=[Goal(), Care(), Blend()])
