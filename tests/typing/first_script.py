"""The script of the contract, and what type checkers know of its ports."""

from collections.abc import AsyncIterator
from typing import assert_type

import attrs

import esair


@attrs.frozen
class Twist:
    linear: float  # m/s
    angular: float  # rad/s


class Avoid(esair.Reaction):
    sonar = esair.reads(float, max_age=0.5)
    wheels = esair.writes(Twist, priority=10)

    def react(self, sonar: float) -> Twist | None:
        return Twist(0.0, 1.2) if sonar < 0.4 else None


class Wander(esair.Behavior):
    wheels = esair.writes(Twist)

    async def run(self) -> None:
        async for _ in esair.every(0.05):
            await self.wheels.write(Twist(0.3, 0.0))


class Look(esair.Behavior):
    sonar = esair.reads(float)
    wheels = esair.writes(Twist)

    async def run(self) -> None:
        assert_type(await self.sonar.read(), float)
        assert_type(await self.sonar.read(fresh=True, max_age=0.1, timeout=0.5), float)
        assert_type(await self.sonar.reading(), esair.Reading[float])
        assert_type(self.sonar.history(3), list[esair.Reading[float]])
        async for value in self.sonar:
            assert_type(value, float)
        written = await self.wheels.write(Twist(0.0, 0.0), hold=0.5)
        assert_type(written, esair.Written[Twist] | esair.Refused)
        if isinstance(written, esair.Written):
            assert_type(written.command, Twist)
        await self.wheels.write(1.0)  # type: ignore[arg-type]


class Sonar(esair.Sensor[float]):
    rate = esair.setting(20.0, unit="Hz")
    gain = esair.setting(3, min=0)

    async def open(self) -> None: ...

    async def read(self) -> float:
        assert_type(self.gain, int)
        return 1.0


class Blocking(esair.Sensor[float]):
    def open(self) -> None: ...

    def read(self) -> float:
        return 1.0


class Radar(esair.Sensor[float]):
    async def stream(self) -> AsyncIterator[float]:
        yield 1.0


class Wheels(esair.Actuator[Twist]):
    safe = Twist(0.0, 0.0)
    command_timeout = 0.2

    async def write(self, command: Twist) -> Twist | None:
        return None


robot = esair.Robot(
    resources=[Sonar(rate=10.0), Blocking(name="b"), Radar(), Wheels()],
    behaviors=[Avoid(), Wander(), Look()],
    policies=[
        esair.Policy(
            "wheels",
            allow={"wander": esair.Access.WRITE, "*": esair.Access.WRITE},
            exclusive=False,
        )
    ],
)
