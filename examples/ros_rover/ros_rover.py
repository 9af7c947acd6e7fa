"""The parts of a rover that ROS drives and sees; nothing in here knows of ROS's topics.

The floor is simulated: put drivers of your own in place of `Where`, `Laser` and `Wheels`.
"""

import asyncio
import math

import attrs

import esair
from esair.buses.ros import Odometry, Scan, Twist

BEAMS = 36
HOME = 0.15  # m from the middle of the room


@attrs.frozen
class GoHome(esair.Request[None]):
    """Drive to the middle of the room."""


class Floor:
    """A room of 4 m by 3 m with the rover in its middle."""

    def __init__(self) -> None:
        self.x = self.y = self.heading = 0.0
        self.twist = Twist(0.0, 0.0)
        self._now: float | None = None

    def move(self) -> Odometry:
        """Move on to now; return where the rover is."""
        now = asyncio.get_running_loop().time()
        step = now - (now if self._now is None else self._now)
        self._now = now
        ahead = step * self.twist.linear
        self.heading += step * self.twist.angular
        self.x = max(-1.9, min(1.9, self.x + ahead * math.cos(self.heading)))
        self.y = max(-1.4, min(1.4, self.y + ahead * math.sin(self.heading)))
        speed, turn = self.twist.linear, self.twist.angular
        return Odometry(self.x, self.y, self.heading, speed, turn)

    def look(self, angle: float) -> float:
        """Return how far a wall is, in metres."""
        at = self.move()
        ahead, left = math.cos(at.heading + angle), math.sin(at.heading + angle)
        wide = (math.copysign(2.0, ahead) - at.x) / ahead if ahead else math.inf
        high = (math.copysign(1.5, left) - at.y) / left if left else math.inf
        return min(wide, high)


floor = Floor()


class Where(esair.Sensor[Odometry]):
    """Where the rover is, as its wheels count."""

    rate = 20.0

    async def read(self) -> Odometry:
        return floor.move()


class Laser(esair.Sensor[Scan]):
    """All around, from ahead counter-clockwise."""

    rate = 10.0

    async def read(self) -> Scan:
        step = 2.0 * math.pi / BEAMS
        ranges = tuple(floor.look(step * beam) for beam in range(BEAMS))
        return Scan(0.0, step, ranges)


class Wheels(esair.Actuator[Twist]):
    """Two driven wheels; they stand 0.3 s after the last command."""

    safe = Twist(0.0, 0.0)
    command_timeout = 0.3

    async def write(self, command: Twist) -> None:
        floor.move()
        floor.twist = command


class KeepClear(esair.Reaction):
    """As fast ahead as the rover can still stop 0.3 m before what is there, whoever drives."""

    scan = esair.reads(Scan, max_age=0.5)
    wheels = esair.guards(Twist)

    def react(self, scan: Scan, wheels: Twist) -> Twist:
        near = min(scan.ranges[-2], scan.ranges[-1], *scan.ranges[:3])
        return attrs.evolve(wheels, linear=min(wheels.linear, max(0.0, near - 0.3)))

    def blind(self, wheels: Twist) -> Twist:
        return attrs.evolve(wheels, linear=min(wheels.linear, 0.0))


class Home(esair.Behavior):
    """Drives to the middle of the room when it is asked to."""

    where = esair.reads(Odometry, max_age=0.5)
    wheels = esair.writes(Twist, priority=10, blind="release")

    @esair.answers
    async def go_home(self, request: GoHome) -> None:
        async for at in self.where:
            away = math.hypot(at.x, at.y)
            if away < HOME:
                break
            turn = math.atan2(-at.y, -at.x) - at.heading
            turn = math.atan2(math.sin(turn), math.cos(turn))
            ahead = min(0.4, away) if abs(turn) < 0.3 else 0.0
            await self.wheels.write(Twist(ahead, max(-1.5, min(1.5, 2.0 * turn))))
        await self.wheels.write(Twist(0.0, 0.0))
