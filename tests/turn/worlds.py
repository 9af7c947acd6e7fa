"""Random robots with threads, plain, coroutine and pushing drivers, and random timing.

``python -m tests.turn.worlds 5 6 7`` runs those of three seeds on the virtual clock and
prints what each actuator was told, and when it landed.
"""

from __future__ import annotations

import asyncio
import json
import random
import sys
import time
import zlib
from collections.abc import AsyncIterator, Iterator
from typing import Any

import esair
from esair.testing import VirtualLoop

Told = dict[str, list[tuple[float, float]]]

SECONDS = 2.0

CHANGED = ""
"""Which behavior decides by another table."""


def jitter() -> None:
    """Let a thread take a time that nobody can foresee."""
    time.sleep(random.choice([0.0, 0.0, 0.0002, 0.001]))


class Values:
    """What a sensor gives: the nth value is the same in each run."""

    def __init__(self, seed: int, name: str) -> None:
        self.rng = random.Random(f"{seed} {name}")

    def __next__(self) -> float:
        return self.rng.randrange(12) / 2


class Instant(esair.Sensor[float]):
    """Answers at once."""

    def __init__(self, name: str, values: Values, rate: float) -> None:
        super().__init__(name=name)
        self.values = values
        self.rate = rate

    async def read(self) -> float:
        return next(self.values)


class Slow(Instant):
    """Answers later, in the loop."""

    latency = 0.0

    async def read(self) -> float:
        await asyncio.sleep(self.latency)
        return next(self.values)


class Threaded(Instant):
    """Blocks a thread."""

    def read(self) -> float:  # type: ignore[override]
        jitter()
        return next(self.values)


class Pushing(esair.Sensor[float]):
    """Gives values when it likes to."""

    def __init__(self, name: str, values: Values) -> None:
        super().__init__(name=name)
        self.values = values

    async def stream(self) -> AsyncIterator[float]:
        while True:
            yield next(self.values)
            await asyncio.sleep(self.values.rng.choice([0.0, 0.01, 0.03, 0.1]))


class Motor(esair.Actuator[float]):
    """Writes down what it is told, when it lands."""

    safe = 0.0
    command_timeout = 0.3
    latency = 0.0

    def __init__(self, name: str, told: Told) -> None:
        super().__init__(name=name)
        self.told = told.setdefault(name, [])

    def land(self, command: float) -> None:
        self.told.append((round(self.clock(), 9), command))

    def start(self, loop: asyncio.AbstractEventLoop) -> None:
        self.clock = loop.time

    async def write(self, command: float) -> None:
        if self.latency:
            await asyncio.sleep(self.latency)
        self.land(command)


class ThreadedMotor(Motor):
    """Blocks a thread."""

    def write(self, command: float) -> None:  # type: ignore[override]
        jitter()
        self.land(command)


def decision(name: str, *readings: float) -> float | None:
    """Decide by a table that nobody knows."""
    number = zlib.crc32(repr((name, readings, name == CHANGED)).encode())
    return None if number % 5 == 0 else number % 1000 / 100


class Decides:
    """The step of every reaction of these worlds."""

    name: str

    def react(self, **readings: float) -> float | None:
        return decision(self.name, *(readings[key] for key in sorted(readings)))


class Loops(esair.Behavior):
    """Reads, decides and writes, each time after a wait of its own."""

    sensor = esair.reads(float)
    motor = esair.writes(float)

    async def run(self) -> None:
        async for _ in esair.every(self.period):
            reading = await self.sensor.read()
            command = decision(self.name, reading)
            if command is not None:
                await self.motor.write(command)


class PlainLoops(esair.Behavior):
    """The same in a thread, which computes as long as it likes."""

    sensor: Any = esair.reads(float)
    motor: Any = esair.writes(float)

    def run(self) -> None:  # type: ignore[override]
        for _ in esair.every(self.period):
            jitter()
            reading = self.sensor.read()
            jitter()
            command = decision(self.name, reading)
            if command is not None:
                self.motor.write(command)


def make_sensor(rng: random.Random, seed: int, name: str) -> Any:
    values = Values(seed, name)
    kind = rng.choice(["instant", "slow", "threaded", "threaded", "pushing"])
    if kind == "pushing":
        return Pushing(name, values)
    rate = rng.choice([10.0, 20.0, 50.0, 100.0])
    if kind == "slow":
        slow = Slow(name, values, rate)
        slow.latency = rng.choice([0.001, 0.004, 0.03])
        return slow
    return (Instant if kind == "instant" else Threaded)(name, values, rate)


class Sum(esair.Derived[float]):
    """The sum of two readings, each of a sensor or of another sum."""

    def __init__(self, name: str, one: str, other: str) -> None:
        super().__init__(
            name=name,
            reads={
                "one": esair.reads(float, name=one),
                "other": esair.reads(float, name=other, optional=True),
            },
        )

    def compute(self, one: float, other: float | None) -> float:
        return one + (other or 0.0)


def make_sums(rng: random.Random, sensors: list[str]) -> list[Sum]:
    sums: list[Sum] = []
    for i in range(rng.randint(0, 2)):
        one, other = rng.sample([*sensors, *(each.name for each in sums)], 2)
        sums.append(Sum(f"a{i}" if rng.random() < 0.5 else f"z{i}", one, other))
    return sums


def make_motor(rng: random.Random, name: str, told: Told) -> Motor:
    kind = rng.choice(["instant", "slow", "threaded"])
    if kind == "threaded":
        return ThreadedMotor(name, told)
    motor = Motor(name, told)
    motor.latency = rng.choice([0.002, 0.015]) if kind == "slow" else 0.0
    return motor


def make_behavior(
    rng: random.Random, name: str, sensors: list[str], motors: list[str]
) -> Any:
    priority = rng.randint(0, 2)
    writes = esair.writes(float, name=rng.choice(motors), priority=priority)
    kind = rng.choice([*["reaction"] * 4, "loops", "plain"])
    if kind == "reaction":
        chosen = rng.sample(sensors, rng.randint(1, min(3, len(sensors))))
        keys = "abc"[: len(chosen)]
        ports: dict[str, Any] = {
            key: esair.reads(float, name=sensor)
            for key, sensor in zip(keys, chosen, strict=True)
        }
        rate = rng.choice([None, 10.0, 20.0, 20.0, 50.0])
        body = {**ports, "motor": writes, "rate": rate}
        return type("Some", (Decides, esair.Reaction), body)(name=name)
    reads = esair.reads(float, name=rng.choice(sensors))
    base = Loops if kind == "loops" else PlainLoops
    period = rng.choice([0.02, 0.05, 0.1])
    body = {"sensor": reads, "motor": writes, "period": period}
    return type("Some", (base,), body)(name=name)


def make(
    seed: int, told: Told, shuffled: random.Random | None = None
) -> tuple[esair.Robot, list[Motor]]:
    """Make the robot of a seed, with its components in any order."""
    rng = random.Random(seed)
    sensors = [make_sensor(rng, seed, f"s{i}") for i in range(rng.randint(2, 5))]
    motors = [make_motor(rng, f"m{i}", told) for i in range(rng.randint(1, 3))]
    sums = make_sums(rng, [each.name for each in sensors])
    readable = [each.name for each in (*sensors, *sums)]
    names = readable, [each.name for each in motors]
    behaviors = [make_behavior(rng, f"b{i}", *names) for i in range(rng.randint(2, 6))]
    resources = [*sensors, *sums, *motors]
    if shuffled is not None:
        shuffled.shuffle(resources)
        shuffled.shuffle(behaviors)
    return esair.Robot(resources=resources, behaviors=behaviors), motors


def play(seed: int, shuffled: random.Random | None = None) -> Told:
    """Run the robot of a seed on the virtual clock; return what its actuators heard."""
    told: Told = {}

    async def main() -> None:
        robot, motors = make(seed, told, shuffled)
        for motor in motors:
            motor.start(asyncio.get_running_loop())
        async with robot:
            await asyncio.sleep(SECONDS)

    with asyncio.Runner(loop_factory=VirtualLoop) as runner:
        runner.run(main())
    return {name: told[name] for name in sorted(told)}


def lines(seeds: Iterator[int]) -> Iterator[str]:
    for seed in seeds:
        yield json.dumps([seed, play(seed)])


if __name__ == "__main__":
    for line in lines(map(int, sys.argv[1:])):
        print(line, flush=True)  # noqa: T201 - that is its purpose
