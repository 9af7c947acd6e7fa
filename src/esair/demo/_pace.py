"""How regularly something happens: counted, and how late it was."""

from __future__ import annotations

import asyncio
import collections
from collections.abc import AsyncIterator

from esair.loop import every

KEPT = 4096
"""Of how many events the lateness is kept; then the newest count."""


class Pace:
    """Counts events and how late each was.

    Attributes:
        count: How many there were.
        skipped: How many were left out because they came too late.
    """

    def __init__(self) -> None:
        self.count = 0
        self.skipped = 0
        self.first: float | None = None
        self.last: float | None = None
        self._lateness: collections.deque[float] = collections.deque(maxlen=KEPT)

    def note(self, now: float, due: float | None = None) -> None:
        """Take note of an event at a time, and of when it should have been."""
        if self.first is None:
            self.first = now
        self.last = now
        self.count += 1
        if due is not None:
            self._lateness.append(max(0.0, now - due))

    @property
    def rate(self) -> float:
        """Events a second, between the first and the last."""
        if self.first is None or self.last is None or self.last <= self.first:
            return 0.0
        return (self.count - 1) / (self.last - self.first)

    def lateness(self, part: float) -> float | None:
        """Return what a part (0 to 1) of the events was not later than, in seconds."""
        if not self._lateness:
            return None
        return sorted(self._lateness)[round(part * (len(self._lateness) - 1))]

    async def every(self, period: float) -> AsyncIterator[float]:
        """Tick as `esair.every` does, and take note of each tick."""
        ticks = every(period)
        loop = asyncio.get_running_loop()
        begin = loop.time()
        skipped = self.skipped
        async for tick in ticks:
            self.note(loop.time(), begin + tick)
            self.skipped = skipped + ticks.late
            yield tick
