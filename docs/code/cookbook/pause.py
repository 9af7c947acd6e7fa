"""Pause and resume: a switch stops the work; it goes on where it was.

pause   ----####----------
wheels  AAAA....AAAATTTT..
"""

import asyncio

import esair


class Work(esair.Behavior):
    """Knows how much of it is done, and does nothing while it is paused."""

    pause = esair.reads(bool)
    wheels = esair.writes(str)

    async def run(self) -> None:
        for command, steps in (("ahead", 20), ("turn", 10)):
            done = 0
            while done < steps:
                if await self.pause.read():
                    self.wheels.release()  # it stops with its time-out
                else:
                    await self.wheels.write(command)
                    done += 1
                await asyncio.sleep(0.1)


def make_robot(*parts: esair.Resource) -> esair.Robot:
    """Return the robot."""
    return esair.Robot(resources=parts, behaviors=[Work()])
