"""Where a rover is, derived of what the encoders of its two wheels say."""

import math

import attrs

import esair


@attrs.frozen
class Pose:
    """Where the rover is, as its wheels have it."""

    x: float  # m
    y: float  # m
    heading: float  # rad, counter-clockwise from the x axis

    def to(self, x: float, y: float) -> tuple[float, float]:
        """Return the way to a place, in metres, and the turn to it, in rad."""
        turn = math.atan2(y - self.y, x - self.x) - self.heading
        return math.hypot(x - self.x, y - self.y), math.remainder(turn, math.tau)


class Odometry(esair.Derived[Pose]):
    """Adds up what both wheels have turned, in metres.

    What they turn while an encoder is lost is not in it: it goes on where it was.
    """

    left = esair.reads(float)
    right = esair.reads(float)
    track = 0.3  # m, between the wheels
    pose = Pose(0.0, 0.0, 0.0)

    def open(self) -> None:
        self.before: tuple[float, float] | None = None

    def compute(self, left: float, right: float) -> Pose:
        was_left, was_right = self.before or (left, right)
        self.before = left, right
        ahead = (left - was_left + right - was_right) / 2
        turn = (right - was_right - left + was_left) / self.track
        x, y, heading = attrs.astuple(self.pose)
        x += ahead * math.cos(heading + turn / 2)
        y += ahead * math.sin(heading + turn / 2)
        self.pose = Pose(x, y, heading + turn)
        return self.pose
