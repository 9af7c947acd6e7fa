"""A robot that drives until something makes it safe: ``-m tests.watchdog.unread TTY WAY LOG``."""

import asyncio
import glob
import itertools
import logging
import os
import signal
import sys
from collections.abc import AsyncIterator
from pathlib import Path

from tests.watchdog.robot import Wheels

import esair
from esair.buses import SerialBus

WAY = sys.argv[2]


class Eye(esair.Sensor[float]):
    """Sees the way for half a second; then it is lost, or sees a wall."""

    openings = 0

    async def open(self) -> None:
        self.openings += 1
        if self.openings > 1:
            raise OSError("it is unplugged")

    async def stream(self) -> AsyncIterator[float]:
        yield 9.0
        await asyncio.sleep(0.5)
        if WAY == "lost":
            self.report_lost(OSError("somebody unplugs it"))
        yield 0.1 if WAY == "guard" else 9.0
        await asyncio.sleep(60.0)


class Keep(esair.Reaction):
    """Has no opinion, but who is blind holds still."""

    eye = esair.reads(float)
    wheels = esair.writes(float, priority=10)

    def react(self, eye: float) -> float | None:
        return None


class Wall(esair.Reaction):
    """Lets nothing pass for good once something is near."""

    eye = esair.reads(float)
    wheels = esair.guards(float, latch=True)

    def react(self, eye: float, wheels: float) -> float | None:
        return wheels if eye > 1.0 else None


class Wander(esair.Behavior):
    """Drives on, whatever it is told."""

    restart = esair.Restart(max=0)
    wheels = esair.writes(float)

    async def run(self) -> None:
        for number in itertools.count():
            await self.wheels.write(1.0)
            if number == 40:
                self.end()
            await asyncio.sleep(0.01)

    def end(self) -> None:
        if WAY == "dog":
            for children in glob.glob("/proc/self/task/*/children"):
                for child in Path(children).read_text("ascii").split():
                    os.kill(int(child), signal.SIGKILL)
        elif WAY == "halt":
            self.halt_robot("enough")
        elif WAY == "stop":
            self.stopping = asyncio.ensure_future(self.stop_robot("enough"))
        elif WAY == "crash":
            raise RuntimeError("no more")


if __name__ == "__main__":
    if sys.argv[3] == "all":
        logging.basicConfig(format="%(message)s", level=logging.INFO)
    robot = esair.Robot(
        resources=[Wheels(bus=SerialBus(name="front", port=sys.argv[1])), Eye()],
        behaviors=[Wander(), Wall(), Keep()],
        watchdog=WAY == "dog",
    )
    try:
        esair.run(robot)
    except esair.BehaviorFailedError:  # Python would print it
        sys.exit(1)
