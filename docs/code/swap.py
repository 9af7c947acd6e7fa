"""Swap what the robot does while it drives, in simulation."""

import asyncio

from scout.zigzag import Avoid, ZigZag

import esair


async def main() -> None:
    """Drive for two seconds."""
    async with esair.Robot.from_config("robot.toml", simulated=True) as robot:
        await asyncio.sleep(1.0)
        print(robot.resources.why("wheels"))
        await robot.behaviors.add(Avoid())
        await robot.behaviors.replace("wander", ZigZag())
        await asyncio.sleep(1.0)
        print(await robot.behaviors.command("list"))


asyncio.run(main())
