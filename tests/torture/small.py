"""Small robots, whose stories are told quickly: what is rare with many parts is met."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from typing import Final

import esair


class Polled(esair.Sensor[float]):
    rate = 13.0

    async def read(self) -> float:
        return 0.83


class Blocking(esair.Sensor[float]):
    rate = 11.0

    def read(self) -> float:
        return 0.9


class Pushing(esair.Sensor[float]):
    period = 0.6

    async def stream(self) -> AsyncIterator[float]:
        while True:
            yield 0.7
            await asyncio.sleep(0.19)


class Twice(esair.Derived[float]):
    sonar = esair.reads(float)

    def compute(self, sonar: float) -> float:
        return 2 * sonar


class Wheels(esair.Actuator[float]):
    safe = 0.0
    command_timeout = 0.3

    async def write(self, command: float) -> None: ...


class Slow(Wheels):
    async def write(self, command: float) -> None:
        await asyncio.sleep(0.021)


class Plain(esair.Actuator[float]):
    safe = 0.0

    def write(self, command: float) -> None: ...


class Copy(esair.Reaction):
    sonar = esair.reads(float)
    wheels = esair.writes(float)

    def react(self, sonar: float) -> float:
        return sonar * 0.5


class OnTwice(esair.Reaction):
    twice = esair.reads(float)
    wheels = esair.writes(float)

    def react(self, twice: float) -> float:
        return twice * 0.2


class Timed(esair.Reaction):
    rate = 21.0
    sonar = esair.reads(float)
    wheels = esair.writes(float, priority=4)

    def react(self, sonar: float) -> float:
        return 0.1


class Guard(esair.Reaction):
    sonar = esair.reads(float)
    wheels = esair.guards(float)

    def react(self, sonar: float, wheels: float) -> float | None:
        return wheels if sonar > 0.3 else None


class Latch(Guard):
    wheels = esair.guards(float, latch=True)


class Drive(esair.Behavior):
    wheels = esair.writes(float)

    async def run(self) -> None:
        async for _ in esair.every(0.07):
            await self.wheels.write(0.4)


class Rest(esair.Behavior):
    wheels = esair.writes(float, priority=1)

    async def run(self) -> None:
        async for _ in esair.every(0.09):
            await self.wheels.write(0.2)


class Thread(esair.ThreadBehavior):
    wheels = esair.writes(float)

    def run(self) -> None:
        for _ in esair.every(0.07):
            self.wheels.write(0.4)


class Perform(esair.Behavior):
    sonar = esair.reads(float)
    wheels = esair.writes(float, priority=4)

    async def run(self) -> None:
        while True:
            await self.perform(Timed(), timeout=0.7)


class Reader(esair.Behavior):
    sonar = esair.reads(float)
    wheels = esair.writes(float)

    async def run(self) -> None:
        async for distance in self.sonar:
            await self.wheels.write(distance * 0.3)


Maker = Callable[[], esair.Robot]


def of(
    sensor: type[esair.Sensor[float]],
    wheels: type[esair.Actuator[float]],
    *actions: type[esair.Behavior | esair.Reaction],
    modes: dict[str, list[str]] | None = None,
) -> Maker:
    """Return what makes a robot of these parts."""

    def make() -> esair.Robot:
        parts = [sensor(name="sonar"), wheels(name="wheels")]
        twice = [Twice()] if OnTwice in actions else []
        return esair.Robot(
            resources=[*parts, *twice],
            behaviors=[each() for each in actions],
            modes=modes or {},
            mode=next(iter(modes), None) if modes else None,
        )

    return make


ROBOTS: Final[dict[str, Maker]] = {
    "a reaction": of(Polled, Wheels, Copy),
    "a reaction, pushed": of(Pushing, Wheels, Copy),
    "a guard": of(Polled, Wheels, Guard, Drive),
    "a guard, slow wheels": of(Polled, Slow, Guard, Drive),
    "a latch": of(Polled, Wheels, Latch, Drive),
    "a latch, blocking": of(Blocking, Plain, Latch, Thread, Rest),
    "a thread": of(Polled, Plain, Guard, Thread),
    "two reactions": of(Polled, Slow, Copy, Timed),
    "computed": of(Polled, Wheels, OnTwice),
    "computed, pushed": of(Pushing, Plain, OnTwice, Timed),
    "a step": of(Polled, Wheels, Perform),
    "a reader": of(Pushing, Wheels, Reader),
    "a reader, polled": of(Polled, Wheels, Reader),
    "modes": of(
        Polled, Wheels, Copy, Rest, Guard, modes={"a": ["copy"], "b": ["rest"]}
    ),
    "modes with a step": of(
        *(Polled, Slow, Timed, Drive, Perform),
        modes={"a": ["drive"], "b": ["timed"], "c": ["perform"]},
    ),
}
