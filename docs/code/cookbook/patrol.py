"""Patrol with interruption: an alarm interrupts it; then it goes on with the same leg.

alarm   ----------##----------
wheels  AAAAAATTTTIIIITTTTTT..
"""

import asyncio

from steps import Drive

import esair


class Patrol(esair.Behavior):
    """Walks its legs; looks at each alarm at once."""

    alarm = esair.reads(bool)

    async def run(self) -> None:
        legs = [Drive("ahead", 1.5), Drive("turn", 1.5)]
        while legs:
            leg = asyncio.create_task(self.perform(legs[0]))
            alarm = asyncio.create_task(self.alarmed())
            await asyncio.wait({leg, alarm}, return_when="FIRST_COMPLETED")
            if leg.done():
                alarm.cancel()
                leg.result()  # its error is ours
                legs.pop(0)
            else:
                leg.cancel()
                await asyncio.wait({leg})  # the wheels are safe now
                await self.perform(Drive("investigate"))

    async def alarmed(self) -> None:
        was = await self.alarm.read()
        async for rings in self.alarm:
            if rings and not was:
                return
            was = rings


def make_robot(*parts: esair.Resource) -> esair.Robot:
    """Return the robot."""
    return esair.Robot(resources=parts, behaviors=[Patrol()])
