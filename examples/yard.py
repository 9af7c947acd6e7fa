"""A yard that pretends to be the world of `docking.py`, and the parts of its rover."""

import asyncio
import math

import attrs

import esair


@attrs.frozen
class Twist:
    """How the rover moves."""

    linear: float  # m/s
    angular: float  # rad/s


@attrs.frozen
class Sight:
    """Where the dock is, seen from the rover."""

    bearing: float  # rad, counter-clockwise
    distance: float  # m


class Yard:
    """Pretends to be the world: a dock, and a stone in the way of the first try."""

    def __init__(self) -> None:
        self.bearing = 0.8  # rad
        self.distance = 1.5  # m
        self.stone = True
        self.twist = Twist(0.0, 0.0)
        self._now: float | None = None

    def look(self) -> Sight:
        """Move on to now, and look at the dock."""
        now = asyncio.get_running_loop().time()
        seconds = now - (self._now if self._now is not None else now)
        self._now = now
        way = self.twist.linear * seconds * math.cos(self.bearing)
        if self.stone and way > 0.0:
            way = max(0.0, min(way, self.distance - 0.4))
        self.stone = (
            self.stone and self.twist.linear >= 0.0
        )  # backing off kicks it away
        self.bearing -= self.twist.angular * seconds
        self.distance = max(0.0, self.distance - way)
        return Sight(self.bearing, self.distance)


class Beacon(esair.Sensor[Sight]):
    """Sees the dock."""

    rate = 20.0

    def __init__(self, yard: Yard) -> None:
        super().__init__()
        self.yard = yard

    async def read(self) -> Sight:
        return self.yard.look()


class Battery(esair.Sensor[float]):
    """The voltage of the battery, in volts."""

    volts = 11.2

    async def read(self) -> float:
        self.volts -= 0.05
        return self.volts


class Wheels(esair.Actuator[Twist]):
    """Two driven wheels."""

    safe = Twist(0.0, 0.0)
    command_timeout = 0.2

    def __init__(self, yard: Yard) -> None:
        super().__init__()
        self.yard = yard

    async def write(self, command: Twist) -> None:
        self.yard.look()
        self.yard.twist = command
