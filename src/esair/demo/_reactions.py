"""What the rover does without thinking: it slows, turns away, and backs off."""

import math

from esair.demo._values import Scan, Touch, Twist
from esair.minimal import Reaction, guards, reads, writes


class Brake(Reaction):
    """The nearer something ahead is, the slower the rover may go on, whoever drives.

    Args:
        gain: How many m/s it may go for each metre that is free.
        near: At which distance, in metres, it may not go on at all.
    """

    ranges = reads(Scan, max_age=0.5)
    wheels = guards(Twist)

    def __init__(
        self, *, gain: float = 1.5, near: float = 0.15, name: "str | None" = None
    ) -> None:
        super().__init__(name)
        self.gain = gain
        self.near = near

    def react(self, ranges: Scan, wheels: Twist) -> "Twist | None":
        """Let pass what is slow enough; turning and backing off always is."""
        ahead = math.radians(30.0)
        free = ranges.nearest(-ahead, ahead) - self.near
        most = max(0.0, self.gain * free)
        if wheels.linear <= most:
            return wheels
        return Twist(most, wheels.angular)

    def blind(self, wheels: Twist) -> "Twist | None":
        """Let it back off from what it touches, and nothing else."""
        return wheels if wheels.linear < 0.0 else None


class Avoid(Reaction):
    """Turn away from what is close ahead until the way is free, and go that way a bit.

    Without the bit of way it would turn for ever between itself and whoever wants to
    go where it has just turned away from.

    Args:
        near: What is closer than this is turned away from, in metres.
    """

    ranges = reads(Scan, max_age=0.5)
    wheels = writes(Twist, priority=10)

    CLEAR = 0.38
    """When nothing is closer than this the turn ends, in metres."""

    LEAVE = 14
    """For how many sweeps it goes the way that it has found free."""

    def __init__(self, *, near: float = 0.21, name: "str | None" = None) -> None:
        super().__init__(name)
        self.near = near
        self._turn = 0.0
        self._leaving = 0

    def react(self, ranges: Scan) -> "Twist | None":
        """Turn to the side with more room."""
        ahead = math.radians(38.0)
        nearest = ranges.nearest(-ahead, ahead)
        if self._turn:
            if nearest <= self.CLEAR:
                return Twist(0.0, self._turn)
            self._turn = 0.0
            self._leaving = self.LEAVE
        if nearest < self.near:
            right = ranges.nearest(-2 * ahead, 0.0)
            left = ranges.nearest(0.0, 2 * ahead)
            self._turn = 1.6 if left > right else -1.6
            self._leaving = 0
            return Twist(0.0, self._turn)
        if self._leaving:
            self._leaving -= 1
            return Twist(0.3, 0.0)
        return None


class Bump(Reaction):
    """Back off from what was touched, turning away from it."""

    rate = 20.0
    bumper = reads(Touch, max_age=0.5)
    wheels = writes(Twist, priority=20)

    BACK_OFF = 17
    """For how many steps, at 20 Hz."""

    def __init__(self, *, name: "str | None" = None) -> None:
        super().__init__(name)
        self.bumps: int = 0
        """How often something was touched."""
        self._left = 0
        self._turn = 0.0

    def react(self, bumper: Touch) -> "Twist | None":
        """Drive back for a while after each touch."""
        if (bumper.left or bumper.right) and self._left < self.BACK_OFF - 3:
            if not self._left:
                self.bumps += 1
            self._left = self.BACK_OFF
            self._turn = {(True, False): -0.9, (False, True): 0.9}.get(
                (bumper.left, bumper.right), 0.5
            )
        if not self._left:
            return None
        self._left -= 1
        return Twist(-0.3, self._turn)
