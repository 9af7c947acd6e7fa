"""Where a rover drives: walls, boxes, pillars, and where it starts."""

from __future__ import annotations

import math

import attrs

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
