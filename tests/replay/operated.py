"""A robot that people operate: settings, an operation, requests, a guard, a file."""

from __future__ import annotations

import asyncio
import contextlib
import random
from typing import Any

import attrs

import esair

FILE = """
[robot]
name = "beacon"
[sensor.light]
driver = "operated:Light"
[actuator.lamp]
driver = "operated:Lamp"
[actuator.horn]
driver = "operated:Lamp"
[behavior.dim]
driver = "operated:Dim"
[behavior.shine]
driver = "operated:Shine"
level = 0.5
[behavior.spare]
driver = "operated:Spare"
"""


@attrs.frozen
class Blink(esair.Request[int]):
    """A request: blink so many times."""

    times: int


class Lamp(esair.Actuator[float]):
    """Takes its time."""

    safe = 0.0
    command_timeout = 0.5
    power = esair.setting(0.5, unit="W", min=0.0, max=2.0)
    code = esair.setting("none", secret=True)

    async def apply(self, **changes: Any) -> None:
        await asyncio.sleep(random.choice([0.0, 0.003]))

    async def write(self, command: float) -> None:
        await asyncio.sleep(random.choice([0.0, 0.002]))

    @esair.operation
    async def measure(self, times: int) -> float:
        """Measure what it takes."""
        await asyncio.sleep(0.01)
        return times * random.random()


class Light(esair.Sensor[float]):
    """How bright it is."""

    rate = 20.0

    async def read(self) -> float:
        await asyncio.sleep(random.choice([0.0, 0.002]))
        return random.random()


class Dim(esair.Reaction):
    """Keeps back what is too much where it is bright."""

    light = esair.reads(float)
    lamp = esair.guards(float)

    def react(self, light: float, lamp: float) -> float | None:
        return None if light > 0.9 and lamp > 0.3 else lamp


class Shine(esair.Behavior):
    """Shines as bright as it is told, and blinks when it is asked to."""

    lamp = esair.writes(float)
    light = esair.reads(float)

    def __init__(self, level: float = 0.5, *, name: str | None = None) -> None:
        super().__init__(name=name)
        self.level = level

    @esair.answers
    async def blink(self, request: Blink) -> int:
        for _ in range(request.times):
            await self.lamp.write(0.1 * self.level)
            await asyncio.sleep(0.02)
        return request.times

    async def run(self) -> None:
        while True:
            await self.lamp.write(self.level * await self.light.read())
            with contextlib.suppress(TimeoutError):
                self.level = await self.receive(timeout=0.03, as_type=float)


class Spare(esair.Behavior):
    """Blows the horn now and then."""

    horn = esair.writes(float)

    async def run(self) -> None:
        async for _ in esair.every(0.1):
            await self.horn.write(esair.random.random())
