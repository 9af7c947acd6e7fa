"""A rover that is driven by hand: a dead man's button, and a guard against obstacles.

`Teleop` drives while the button is held and the stick is heard. `KeepClear` slows down
whoever drives, the nearer something is, and lets only backing off pass while it cannot see.
"""

import asyncio
import math
from collections.abc import AsyncIterator

import attrs

import esair


@attrs.frozen
class Twist:
    """How the rover moves."""

    linear: float  # m/s
    angular: float  # rad/s


@attrs.frozen
class Stick:
    """What the hand does."""

    held: bool  # the dead man's button
    ahead: float  # -1 to 1
    left: float  # -1 to 1


class Teleop(esair.Reaction):
    """Drive as the stick says while the button is held, else stand."""

    pad = esair.reads(Stick, max_age=0.3)
    wheels = esair.writes(Twist, priority=50, blind="release")

    def react(self, pad: Stick) -> Twist:
        held = 1.0 if pad.held else 0.0
        return Twist(0.6 * held * pad.ahead, 1.5 * held * pad.left)


class KeepClear(esair.Reaction):
    """As fast ahead as the rover can still stop 0.2 m before what is there."""

    ahead = esair.reads(float, max_age=0.3)
    wheels = esair.guards(Twist)

    def react(self, ahead: float, wheels: Twist) -> Twist:
        most = max(0.0, 0.8 * (ahead - 0.2))
        return attrs.evolve(wheels, linear=min(wheels.linear, most))

    def blind(self, wheels: Twist) -> Twist:
        return attrs.evolve(wheels, linear=min(wheels.linear, 0.0))


class Pad(esair.Sensor[Stick]):
    """Pretends to be a gamepad: it speaks 20 times a second until its battery is empty."""

    period = 0.1
    battery = 6.0  # s

    async def stream(self) -> AsyncIterator[Stick]:
        async for seconds in esair.every(0.05):
            if seconds > self.battery:
                break
            yield Stick(held=seconds > 0.5, ahead=1.0, left=0.2 * math.sin(seconds))
        await asyncio.sleep(math.inf)  # no word more


class Corridor:
    """Pretends to be the world: a wall, three metres ahead."""

    def __init__(self) -> None:
        self.distance = 3.0  # m
        self.twist = Twist(0.0, 0.0)
        self._now: float | None = None

    def move(self) -> float:
        """Move on to now; return how far the wall is, in metres."""
        now = asyncio.get_running_loop().time()
        seconds = now - (self._now if self._now is not None else now)
        self._now = now
        self.distance = max(0.0, self.distance - seconds * self.twist.linear)
        return self.distance


class Ahead(esair.Sensor[float]):
    """How far the way ahead is free, in metres."""

    rate = 20.0
    limits = (0.0, 10.0)

    def __init__(self, corridor: Corridor) -> None:
        super().__init__()
        self.corridor = corridor

    async def read(self) -> float:
        return self.corridor.move()


class Wheels(esair.Actuator[Twist]):
    """Two driven wheels."""

    safe = Twist(0.0, 0.0)
    command_timeout = 0.2
    limits = {"linear": (-0.6, 0.6), "angular": (-1.5, 1.5)}  # noqa: RUF012 - as the base

    def __init__(self, corridor: Corridor) -> None:
        super().__init__()
        self.corridor = corridor

    async def write(self, command: Twist) -> None:
        self.corridor.move()
        if command.linear != self.corridor.twist.linear:
            distance = self.corridor.distance
            print(f"{command.linear:.2f} m/s, {distance:.2f} m to go", flush=True)
        self.corridor.twist = command


def make_robot(corridor: Corridor) -> esair.Robot:
    """Return the rover in its corridor."""
    return esair.Robot(
        name="teleop",
        resources=[Pad(), Ahead(corridor), Wheels(corridor)],
        behaviors=[Teleop(), KeepClear()],
    )


robot = make_robot(Corridor())

if __name__ == "__main__":
    esair.run(robot, duration=8.0)
