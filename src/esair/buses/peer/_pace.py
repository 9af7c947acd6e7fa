"""How many readings are on the way to a peer, so that beats and commands do not wait behind."""

from __future__ import annotations

import collections
import math

BEAT = 0.05
"""How often each side beats, in seconds."""

_LEAST, _MOST = 1000.0, 1e7  # bytes of readings that may be on the way at once
_FALL = 0.03  # by which share of it a shorter echo shortens what the way itself takes


class Pace:
    """How long the way to a peer is, and how many bytes of readings may be on it.

    The echo of a beat says that what was told before it is heard. One is late that takes
    half as long again, and a beat, as those of beats that were said with no reading on the
    way. Each time that begins half as much may be on the way as before. With each echo in
    time a little more may, where that was too little; before the first late one twice as
    much. Readings wait while more is on the way, or an echo is late; where the peer says all
    on several ways, while there is any.
    """

    def __init__(self, kept: int) -> None:
        self._at_beats: collections.deque[tuple[int, bool]]
        self._at_beats = collections.deque(maxlen=kept)  # what was told, and all heard
        self._told = self._heard = 0
        self._room, self._growth = 2.0 * _LEAST, 2.0
        self._way, self._copied_at = math.inf, -math.inf
        self._is_late = self._is_full = False

    def beat(self) -> None:
        """Take down that a beat is said."""
        self._at_beats.append((self._told, self._told == self._heard))

    def told(self, size: int) -> None:
        """Take down that a reading was said, of so many bytes."""
        self._told += size
        self._is_full |= self._told - self._heard >= self._room

    def copied(self, now: float) -> None:
        """Take down that something came twice."""
        self._copied_at = now

    def echoed(self, back: int, trip: float) -> None:
        """Take down how long the echo of a beat took: of the newest one, or so far back."""
        told, is_free = self._at_beats[-1 - back]
        if self._way == math.inf or (is_free and trip > self._way):
            self._way = trip
        elif trip < self._way:
            self._way += _FALL * (trip - self._way)
        was_late, self._is_late = self._is_late, self._is_long(trip)
        if self._is_late and not was_late:
            self._room, self._growth = max(_LEAST, 0.5 * self._room), 1.05
        elif self._is_full and not self._is_late:
            self._room = min(_MOST, self._growth * self._room)
            self._is_full = False
        self._heard = max(self._heard, told)

    def is_slow(self, now: float, heard_at: float) -> bool:
        """Tell whether readings wait, where the newest echo is of a beat of a moment."""
        room = 1.0 if now - self._copied_at < 2.0 * BEAT else self._room
        is_late = self._is_late or self._is_long(now - heard_at - 2.0 * BEAT)
        return is_late or self._told - self._heard >= room

    def _is_long(self, trip: float) -> bool:
        return trip > 1.5 * self._way + BEAT
