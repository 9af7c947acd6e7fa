"""What a reaction knows of time."""

from __future__ import annotations

from typing import Any

_EARLY = 1e-3
"""What is lost to floating point, in milliseconds."""


class StepClock:
    """Tells a reaction the moment of each of its steps.

    Args:
        reaction: Who is told, by ``now_ms`` and ``elapsed_ms``.
        began: When its robot has started, in seconds.
    """

    __slots__ = ("_began", "_first", "_reaction")

    def __init__(self, reaction: Any, began: float) -> None:
        self._reaction = reaction
        self._began = began
        self._first = True

    def step(self, now: float) -> None:
        """Begin a step."""
        reaction = self._reaction
        at = int((now - self._began) * 1000.0 + _EARLY)
        if self._first:
            self._first = False
            reaction.elapsed_ms = 0
        else:
            reaction.elapsed_ms = at - reaction.now_ms
        reaction.now_ms = at
