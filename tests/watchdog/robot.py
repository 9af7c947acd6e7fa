"""A robot that drives, until it dies or hangs: ``robot.py TTY WAY [POLICY]``.

``DOG`` in the environment is what starts its watchdog, in the place of Python.
"""

import asyncio
import glob
import itertools
import logging
import os
import signal
import sys
import time
from pathlib import Path
from typing import Any

import esair
from esair.buses import SerialBus
from esair.watchdog import SafeFrames


class Wheels(esair.Actuator[float]):
    """Says each command as a line."""

    safe = 0.0
    command_timeout = 0.5
    tuned = esair.setting(0)
    bus: SerialBus

    async def write(self, command: float) -> None:
        await self.bus.send(b"GO" if command else b"STOP")

    async def apply(self, **_settings: object) -> None: ...

    def safe_frames(self) -> SafeFrames | None:
        if self.tuned % 3 == 2:
            raise ValueError("not with this setting")
        if self.tuned % 3 == 1:
            return None
        return SafeFrames([b"STOP\n"], resync=b"\n")


class Dumb(esair.Actuator[float]):
    """Nobody knows how to stop it from outside."""

    safe = 0.0

    async def write(self, command: float) -> None:
        return None


class Wander(esair.Behavior):
    """Drives on, then dies in the given way."""

    wheels = esair.writes(float, configure=True)

    async def run(self) -> None:
        way = sys.argv[2]
        endless = way in {"drive", "tune"}
        for number in itertools.count() if endless else range(80):
            await self.wheels.write(1.0)
            if way == "tune" and number % 5 == 4:
                await self.wheels.configure(tuned=number // 5)
            if number == 40:
                self.die(way)
            await asyncio.sleep(0.01)

    def die(self, way: str) -> None:
        if way == "kill":
            os.kill(os.getpid(), signal.SIGKILL)
        elif way == "sleep":
            time.sleep(60)
        elif way == "spin":
            while True:
                pass
        elif way == "loop.stop":
            asyncio.get_running_loop().stop()
        elif way == "dog":
            for children in glob.glob("/proc/self/task/*/children"):
                for child in Path(children).read_text("ascii").split():
                    os.kill(int(child), signal.SIGKILL)


if __name__ == "__main__":
    logging.basicConfig(format="%(message)s", level=logging.INFO)
    bus = SerialBus(name="front", port=sys.argv[1])
    sys.executable = os.environ.get("DOG", sys.executable)
    policy: Any = (sys.argv[3:] or ["stop"])[0]
    robot = esair.Robot(
        resources=[Wheels(bus=bus), Dumb()],
        behaviors=[Wander()],
        watchdog=True,
        watchdog_death=policy,
        watchdog_limit=float(os.environ.get("LIMIT", "0.25")),
    )
    esair.run(robot)
