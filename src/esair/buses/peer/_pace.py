"""How often readings are said to a peer, so that beats and commands do not wait behind."""

from __future__ import annotations

import math

BEAT = 0.05
"""How often each side beats, in seconds."""

_FALL = 0.01  # by which share of it a shorter echo shortens what the way itself takes


class Pace:
    """How long the way to a peer is, and whether readings wait on it.

    An echo is late that takes half as long again, and a beat, as those of beats before which
    no reading was on the way. Each time that begins, half of how late it is is added to the pause
    between two readings, which shrinks with each beat. While the peer says all on several
    ways they are said seldom.
    """

    def __init__(self) -> None:
        self._way = math.inf
        self._told_at = self._copied_at = -math.inf
        self._free_at = math.inf  # since when none of what was told is on the way
        self._is_late, self._pause = False, 0.0

    def told(self, now: float) -> None:
        """Take down that a reading was said."""
        self._told_at, self._free_at = now, math.inf

    def beat(self) -> None:
        """Take down that a beat was said."""
        self._pause *= 0.97

    def copied(self, now: float) -> None:
        """Take down that something came twice."""
        self._copied_at = now

    def echoed(self, now: float, since: float, trip: float) -> None:
        """Take down how long the echo of a beat took that was sent at a moment."""
        if since > self._told_at:
            self._free_at = min(self._free_at, now)
        if self._way == math.inf or (since >= self._free_at and trip > self._way):
            self._way = trip
        elif trip < self._way:
            self._way += _FALL * (trip - self._way)
        was_late, self._is_late = self._is_late, self._is_long(trip)
        if self._is_late and not was_late:
            self._pause = min(0.5, self._pause + 0.5 * (trip - self._way))

    def is_slow(self, now: float, heard_at: float) -> bool:
        """Tell whether readings wait, where the newest echo is of a beat of a moment."""
        is_late = self._is_late or self._is_long(now - heard_at - 2.0 * BEAT)
        pause = max(self._pause, 4.0 * BEAT * (now - self._copied_at < 2.0 * BEAT))
        return is_late or now - self._told_at < pause

    def _is_long(self, trip: float) -> bool:
        return trip > 1.5 * self._way + BEAT
