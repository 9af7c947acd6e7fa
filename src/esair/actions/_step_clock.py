"""What a reaction knows of time."""

from __future__ import annotations

from typing import Any

_EARLY = 1e-3  # what is lost to floating point, in milliseconds


class StepClock:
    """Knows the moments of a reaction's steps, and computes them when it asks."""

    __slots__ = ("_began", "before", "now", "reaction")

    def __init__(self, began: float, reaction: Any = None) -> None:
        self._began = began
        self.now: float | None = None
        """When the step began, in seconds of the loop's clock; None before the first,"""
        self.before: float | None = None  # and the one before it
        self.reaction = reaction

    def step(self, now: float) -> None:
        self.before = self.now
        self.now = now
        if self.reaction is not None:
            self.tell()

    def tell(self) -> None:
        """Tell the reaction, which cannot ask."""
        self.reaction.now_ms = self.now_ms
        self.reaction.elapsed_ms = self.elapsed_ms

    @property
    def now_ms(self) -> int:
        """The moment of this step, in whole milliseconds since the robot started."""
        return 0 if self.now is None else self._since_start(self.now)

    @property
    def elapsed_ms(self) -> int:
        """Milliseconds since its previous step; 0 at the first."""
        return (
            0 if self.before is None else self.now_ms - self._since_start(self.before)
        )

    def _since_start(self, moment: float) -> int:
        return int((moment - self._began) * 1000.0 + _EARLY)


class Told:
    """An attribute of a reaction that its clock answers.

    Outside of a robot, in a test of ``react`` say, it is 0 or what it was set to.
    """

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    def __get__(self, reaction: Any, owner: type | None = None) -> int:
        clock = None if reaction is None else vars(reaction).get("_step_clock")
        return 0 if clock is None else getattr(clock, self._name)
