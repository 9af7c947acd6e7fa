"""What the rover's reflexes read and command: plain tuples, as MIN knows no others."""

from collections import namedtuple


class Twist(namedtuple("Twist", ("linear", "angular"))):
    """How the rover moves.

    Attributes:
        linear: Forward, in m/s.
        angular: Counter-clockwise, in rad/s.
    """


class Scan(namedtuple("Scan", ("first", "step", "ranges"))):
    """Distances to what is around, in a fan.

    Attributes:
        first: Direction of the first beam from straight ahead, in rad.
        step: From one beam to the next, in rad, counter-clockwise.
        ranges: In metres from the rover's centre; infinite if nothing is in reach.
    """

    def nearest(self, begin: float, end: float) -> float:
        """Return the least distance between two directions, in metres."""
        least = float("inf")
        for index, distance in enumerate(self.ranges):
            if distance < least:
                direction = self.first + index * self.step
                if begin <= direction <= end:
                    least = distance
        return least


class Touch(namedtuple("Touch", ("left", "right"))):
    """What the bumper feels: whether something touches a side."""
