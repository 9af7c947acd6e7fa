"""The physics: a rover with two driven wheels among things that stand."""

from __future__ import annotations

import math
import random
from collections.abc import Callable

import attrs
import pymunk

WHEEL_RADIUS = 0.05  # In metres
WHEEL_BASE = 0.26  # Between the wheels, in metres
BODY_RADIUS = 0.16  # In metres

MOTOR_LAG = 0.07
"""How long a wheel takes for two thirds of a change of its speed, in seconds."""

_HIGH, _LOW, _ROVER = 1, 2, 4

_IN_SIGHT = pymunk.ShapeFilter(mask=_HIGH)


@attrs.frozen
class Pose:
    """Where the rover is: x and y in metres, heading in radians from the x axis."""

    x: float
    y: float
    heading: float


class World:
    """The arena and the rover in it; it stands still until `step` is called.

    The same seed and the same commands at the same steps give the same world.

    Args:
        arena: What there is.
        seed: Decides all noise.
    """

    def __init__(self, arena: Arena | None = None, *, seed: int = 0) -> None:
        self.arena: Arena = arena or Arena()
        self.time: float = 0.0
        self.distance: float = 0.0
        """How far the rover has really driven, in metres."""
        self.target: list[float] = [0.0, 0.0]
        """What the motors were told: left and right, in rad/s."""
        self.wheel_speed: list[float] = [0.0, 0.0]
        self.wheel_angle: list[float] = [0.0, 0.0]
        """What the encoders of the wheels count: left and right, in rad."""
        self.bumps: tuple[bool, bool] = (False, False)
        """Whether something touches the front: left, right."""
        self.acceleration: tuple[float, float] = (0.0, 0.0)
        self.turn_rate: float = 0.0
        self._noise = random.Random(f"world {seed}")
        self._scale = [1.0 + self._noise.gauss(0.0, 0.002) for _ in range(2)]
        self._space = pymunk.Space()
        self._add_arena()
        self._body = self._add_rover()
        self._speed = 0.0

    @property
    def pose(self) -> Pose:
        """Where the rover really is."""
        return Pose(self._body.position.x, self._body.position.y, self._body.angle)

    def step(self, seconds: float) -> None:
        """Let time pass; a step should be 0.02 s at most."""
        follow = 1.0 - math.exp(-seconds / MOTOR_LAG)
        for side in (0, 1):
            self.wheel_speed[side] += (
                self.target[side] - self.wheel_speed[side]
            ) * follow
        before, angle = self._body.position, self._body.angle
        self._space.step(seconds)
        moved = self._body.position - before
        self._feel(seconds, moved, angle)
        self.distance += moved.length
        self.time += seconds

    def put(self, pillar: Pillar) -> Callable[[], None]:
        """Put one more pillar there; returns how to take it away again."""
        shape = pymunk.Circle(self._space.static_body, pillar.radius, pillar.center)
        self._add(shape, _HIGH)
        return lambda: self._space.remove(shape)

    def distance_ahead(self, angle: float, reach: float) -> float | None:
        """Return how far it is to the next thing in a direction.

        Args:
            angle: From the rover's heading, in radians, counter-clockwise.
            reach: How far to look from the rover's centre, in metres.

        Returns:
            Metres; None if there is nothing within reach.
        """
        x, y = self._body.position
        direction = self._body.angle + angle
        end = x + math.cos(direction) * reach, y + math.sin(direction) * reach
        hit = self._space.segment_query_first((x, y), end, 0.0, _IN_SIGHT)
        return None if hit is None else hit.alpha * reach

    def _drive(
        self, body: pymunk.Body, _gravity: object, _damping: float, _seconds: float
    ) -> None:
        """Let the wheels decide the speed; a collision then takes it away."""
        left, right = (speed * WHEEL_RADIUS for speed in self.wheel_speed)
        body.velocity = _ahead(body.angle) * ((left + right) / 2)
        body.angular_velocity = (right - left) / WHEEL_BASE

    def _feel(self, seconds: float, moved: pymunk.Vec2d, angle: float) -> None:
        turn = (self._body.angle - angle) / seconds
        speed = moved.dot(_ahead(angle)) / seconds
        self.acceleration = ((speed - self._speed) / seconds, speed * turn)
        self.turn_rate = turn
        self._speed = speed
        contacts = self._contacts()
        for side, sign in ((0, -1), (1, 1)):
            ground = (speed + sign * turn * WHEEL_BASE / 2) / WHEEL_RADIUS
            if contacts:  # tyres hold the ground: who is stopped has wheels that stand
                self.wheel_speed[side] = ground
            slip = 1.0 + self._noise.gauss(0.0, 0.01)
            self.wheel_angle[side] += ground * self._scale[side] * slip * seconds
        self.bumps = self._touched(contacts)

    def _touched(self, contacts: list[pymunk.Vec2d]) -> tuple[bool, bool]:
        left = right = False
        for point in contacts:
            offset = point - self._body.position
            side = math.remainder(offset.angle - self._body.angle, math.tau)
            left = left or -0.25 < side < 1.6
            right = right or -1.6 < side < 0.25
        return left, right

    def _contacts(self) -> list[pymunk.Vec2d]:
        found: list[pymunk.Vec2d] = []

        def collect(arbiter: pymunk.Arbiter) -> None:
            found.extend(point.point_a for point in arbiter.contact_point_set.points)

        self._body.each_arbiter(collect)
        return found

    def _add_arena(self) -> None:
        ground = self._space.static_body
        for wall in (*self.arena.outline(), *self.arena.walls):
            self._add(pymunk.Segment(ground, wall.begin, wall.end, 0.03), _HIGH)
        for box in self.arena.boxes:
            self._add(pymunk.Poly(ground, box.corners()), _LOW if box.low else _HIGH)
        for pillar in self.arena.pillars:
            self._add(pymunk.Circle(ground, pillar.radius, pillar.center), _HIGH)

    def _add(self, shape: pymunk.Shape, category: int) -> None:
        shape.filter = pymunk.ShapeFilter(categories=category)
        shape.friction = 0.3
        self._space.add(shape)

    def _add_rover(self) -> pymunk.Body:
        mass = 3.0
        body = pymunk.Body(mass, pymunk.moment_for_circle(mass, 0.0, BODY_RADIUS))
        x, y, heading = self.arena.start
        body.position = (x, y)
        body.angle = heading
        body.velocity_func = self._drive
        shape = pymunk.Circle(body, BODY_RADIUS)
        shape.filter = pymunk.ShapeFilter(categories=_ROVER, mask=_HIGH | _LOW)
        shape.friction = 0.3
        self._space.add(body, shape)
        return body


def _ahead(angle: float) -> pymunk.Vec2d:
    return pymunk.Vec2d(math.cos(angle), math.sin(angle))


Point = tuple[float, float]


@attrs.frozen
class Wall:
    """A thin wall between two points, in metres."""

    begin: Point
    end: Point


@attrs.frozen
class Box:
    """A box; ``angle`` is in radians, counter-clockwise.

    Attributes:
        low: Whether it is so low that a range finder looks over it; a bumper does not.
    """

    center: Point
    size: Point
    angle: float = 0.0
    low: bool = False

    def corners(self) -> list[Point]:
        """Return the four corners, counter-clockwise."""
        half_width, half_height = self.size[0] / 2, self.size[1] / 2
        cos, sin = math.cos(self.angle), math.sin(self.angle)
        return [
            (self.center[0] + x * cos - y * sin, self.center[1] + x * sin + y * cos)
            for x, y in (
                (-half_width, -half_height),
                (half_width, -half_height),
                (half_width, half_height),
                (-half_width, half_height),
            )
        ]


@attrs.frozen
class Pillar:
    """A round pillar."""

    center: Point
    radius: float


@attrs.frozen
class Arena:
    """A rectangle with walls around it, from (0, 0) to ``size``, in metres.

    Attributes:
        start: Where the rover stands at first: x, y in metres, heading in radians.
    """

    size: Point = (6.0, 4.0)
    walls: tuple[Wall, ...] = (
        Wall((2.1, 0.0), (2.1, 1.5)),
        Wall((3.9, 4.0), (3.9, 2.6)),
    )
    boxes: tuple[Box, ...] = (
        Box((1.15, 2.95), (0.55, 0.35), 0.4),
        Box((4.95, 0.75), (0.6, 0.6), 0.2),
        Box((5.25, 3.2), (0.35, 0.7), -0.3),
        Box((2.95, 1.8), (0.12, 0.5), -0.35, low=True),
    )
    pillars: tuple[Pillar, ...] = (
        Pillar((3.2, 0.5), 0.16),
        Pillar((2.35, 3.3), 0.18),
        Pillar((4.75, 2.1), 0.15),
    )
    start: tuple[float, float, float] = (0.7, 0.8, 0.5)

    def outline(self) -> tuple[Wall, ...]:
        """Return the four walls around."""
        width, height = self.size
        corners = [(0.0, 0.0), (width, 0.0), (width, height), (0.0, height)]
        return tuple(
            Wall(corner, corners[(index + 1) % 4])
            for index, corner in enumerate(corners)
        )
