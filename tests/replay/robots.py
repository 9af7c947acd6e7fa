"""A robot with a thread, a slow, a blocking and a pushing device, and random numbers."""

from __future__ import annotations

import asyncio
import itertools
import os
import random
import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import esair

GAIN = 0.5
"""What a test changes to have the robot decide otherwise."""


def stamps() -> list[str]:
    """What the robot of another module reads behind its back."""
    return os.listdir()


class Sonar(esair.Sensor[float]):
    """Takes its time in the loop."""

    rate = 50.0

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.values = itertools.cycle([1.0, 2.0, 3.0, 2.5])

    async def read(self) -> float:
        await asyncio.sleep(random.choice([0.0, 0.002, 0.005]))
        return next(self.values)


class Compass(esair.Sensor[float]):
    """Blocks a thread, and tells how old what it gives is."""

    rate = 25.0

    def read(self) -> Any:
        time.sleep(random.choice([0.0, 0.001, 0.004]))
        return esair.Stamped(random.random(), age=0.002)


class Bumper(esair.Sensor[bool]):
    """Speaks when it likes to."""

    async def stream(self) -> AsyncIterator[bool]:
        while True:
            yield random.random() < 0.3
            await asyncio.sleep(random.choice([0.005, 0.02, 0.05]))


class Wheel(esair.Actuator[float]):
    """Takes a command now and then late."""

    safe = 0.0
    command_timeout = 0.3

    async def write(self, command: float) -> None:
        if command > 1.0:
            await asyncio.sleep(0.003)


class Arm(esair.Actuator[float]):
    """Blocks a thread."""

    safe = 0.0
    command_timeout = 0.3

    def write(self, command: float) -> None:  # type: ignore[override]
        time.sleep(random.choice([0.0, 0.002]))


class Follow(esair.Reaction):
    """Drives as fast as there is room."""

    rate = 20.0
    sonar = esair.reads(float)
    bumper = esair.reads(bool)
    wheel = esair.writes(float, priority=1)

    def react(self, sonar: float, bumper: bool) -> float:
        return 0.0 if bumper else sonar * GAIN


class Wander(esair.Behavior):
    """Drives anywhere, after all others."""

    compass = esair.reads(float)
    wheel = esair.writes(float)

    async def run(self) -> None:
        async for _ in esair.every(0.03):
            heading = await self.compass.read()
            await self.wheel.write(heading + esair.random.random())


class Wave(esair.Behavior):
    """Moves the arm, from a thread that computes for a while."""

    compass: Any = esair.reads(float)
    arm: Any = esair.writes(float)

    def run(self) -> None:  # type: ignore[override]
        for _ in esair.every(0.04):
            heading = self.compass.read()
            time.sleep(random.choice([0.0, 0.003]))
            self.arm.write(heading)


def make(record: Path | None = None) -> esair.Robot:
    """Return the robot, not started."""
    return esair.Robot(
        resources=[Sonar(), Compass(), Bumper(), Wheel(), Arm()],
        behaviors=[Follow(), Wander(), Wave()],
        record=None if record is None else esair.Recording(record, min_free=0),
    )


def recorded(path: Path, seconds: float) -> Path:
    """Record a run in real time."""
    esair.run(make(path), duration=seconds)
    return path
