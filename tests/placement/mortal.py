"""Components that die or hang at a moment that they note; a file in memory outlives them."""

from __future__ import annotations

import os
import time
from typing import Any

from tests.placement.parts import Twist, misbehave

import esair


def do(how: str, path: str) -> None:
    """Note the moment and misbehave, in the first life alone."""
    if os.path.exists(path):
        return
    with open(path, "w", encoding="ascii") as file:
        file.write(repr(time.monotonic()))  # it is the clock of all processes
    if how == "hang":
        time.sleep(60.0)
    misbehave(how)


class Dies(esair.Behavior):
    """Drives a little, and dies in its first life."""

    placement = "process"
    restart = esair.Restart(max=1, within=60.0, delay=0.05)
    wheels = esair.writes(Twist)

    def __init__(self, how: str, path: str, name: str, wheels: str) -> None:
        super().__init__(name=name, writes={"wheels": esair.writes(Twist, name=wheels)})
        self.how = how
        self.path = path

    async def run(self) -> None:
        steps = 0
        async for _ in esair.every(0.01):
            await self.wheels.write(Twist(0.3, 0.0))
            steps += 1
            if steps == 8:
                do(self.how, self.path)


class HungSonar(esair.Sensor[float]):
    """A driver that hangs in its fifth reading, in its first life."""

    placement = "process"
    deadline = 2.0
    rate = 50.0

    def __init__(self, path: str, **settings: Any) -> None:
        super().__init__(**settings)
        self.path = path
        self.reads = 0

    def read(self) -> float:
        self.reads += 1
        if self.reads == 5:
            do("hang", self.path)
        return 1.0
