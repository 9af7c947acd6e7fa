"""A rover on a straight road: what it was told, and how far that has taken it."""

from __future__ import annotations

import asyncio
from typing import Any

import esair
from esair.testing import FakeActuator

SPEED = 0.5  # m/s
RATE = 20.0  # Hz, of the range finder
MAX_AGE = 0.25  # s
PERIOD = 0.05  # s, of the writes


class Wheels(FakeActuator[float]):
    """Wheels that know how far they have gone."""

    def __init__(self, **options: Any) -> None:
        super().__init__("wheels", safe=0.0, command_timeout=0.2, **options)
        self.speed = 0.0
        self._x = 0.0
        self._at = 0.0

    @property
    def x(self) -> float:
        """How far they have gone, in metres."""
        return self._x + self.speed * (asyncio.get_running_loop().time() - self._at)

    async def write(self, command: float) -> None:
        await super().write(command)
        self._x, self._at = self.x, asyncio.get_running_loop().time()
        self.speed = command


class Drive(esair.Behavior):
    """Drive on, whatever happens; it remembers how its writes were answered."""

    wheels = esair.writes(float)

    def __init__(self, *, name: str | None = None, speed: float = SPEED) -> None:
        super().__init__(name=name)
        self.speed = speed
        self.answers: list[Any] = []

    async def run(self) -> None:
        async for _ in esair.every(PERIOD):
            try:
                self.answers.append(await self.wheels.write(self.speed))
            except esair.DeviceLostError:
                continue


class ObstacleStop(esair.Reaction):
    """Stop before anything that is closer than 0.4 m."""

    sonar = esair.reads(float, max_age=MAX_AGE)
    wheels = esair.writes(float, priority=100)
    bug = False

    def react(self, sonar: float) -> float | None:
        if type(self).bug or self.bug:
            raise RuntimeError("a bug")
        return 0.0 if sonar < 0.4 else None


class ObstacleGuard(esair.Reaction):
    """Let nothing pass before anything that is closer than 0.4 m."""

    sonar = esair.reads(float, max_age=MAX_AGE)
    wheels = esair.guards(float)
    bug = False

    def react(self, sonar: float, wheels: float) -> float | None:
        if self.bug:
            raise RuntimeError("a bug")
        return None if sonar < 0.4 else wheels
