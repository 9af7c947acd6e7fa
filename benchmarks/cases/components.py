"""The robots that are measured: as small, and as plain, as a user's."""

from __future__ import annotations

from typing import Any

import esair


class Meter(esair.Sensor[float]):
    """A sensor that has its value at hand."""

    async def read(self) -> float:
        return 1.0


class Motor(esair.Actuator[float]):
    """An actuator whose driver does nothing."""

    safe = 0.0

    async def write(self, command: float) -> None:
        return None


class PlainMeter(Meter):
    """The same, as a plain method that does not block."""

    blocking = False

    def read(self) -> float:  # type: ignore[override]
        return 1.0


class PlainMotor(Motor):
    """The same, as a plain method that does not block."""

    blocking = False

    def write(self, command: float) -> None:  # type: ignore[override]
        return None


class Idle(esair.Behavior):
    """A behavior that waits."""


class User(esair.Behavior):
    """A behavior that is used from outside."""

    meter = esair.reads(float)
    motor = esair.writes(float)


class Decide(esair.Reaction):
    """A reaction that decides on one reading, a hundred times a second."""

    rate = 100.0
    acts = False

    def react(self, meter: float) -> float | None:
        return 0.5 if self.acts else None


def reacting_robot(
    count: int, *, acting: int, plain: bool = False, realtime: bool = False
) -> esair.Robot:
    """Make a robot of reactions, each with a sensor and an actuator of its own.

    Args:
        count: How many reactions.
        acting: One in so many writes at every step; 0 for none.
        plain: Whether the drivers are plain methods that do not block.
        realtime: Whether its loop goes before what else the computer does.
    """
    meter, motor = (PlainMeter, PlainMotor) if plain else (Meter, Motor)
    resources: list[Any] = []
    reactions: list[esair.Reaction] = []
    for number in range(count):
        resources += [meter(name=f"meter_{number}"), motor(name=f"motor_{number}")]
        reaction = Decide(
            name=f"decide_{number}",
            reads={"meter": esair.reads(float, name=f"meter_{number}")},
            writes={"motor": esair.writes(float, name=f"motor_{number}")},
        )
        reaction.acts = bool(acting) and number % acting == 0
        reactions.append(reaction)
    return esair.Robot(resources=resources, behaviors=reactions, realtime=realtime)
