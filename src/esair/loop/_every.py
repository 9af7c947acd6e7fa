"""``every``: a loop that runs at a fixed rate and never drifts."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Iterator

from esair.exceptions import ConfigError
from esair.loop._budget import Budget
from esair.loop._light_task import wake
from esair.loop._of_loop import clock_of
from esair.loop._ownership import is_outside
from esair.loop._scheduler import Scheduler
from esair.loop._threads import portal
from esair.values import check_duration


class Every:
    """Ticks at a fixed rate; see `every`.

    Attributes:
        late: How many ticks were left out because the loop's body took too long.
    """

    def __init__(self, period: float) -> None:
        self.period: float = float(check_duration("every", "period", period))
        self.late: int = 0
        self._begin: float | None = None
        self._count = 0

    def __aiter__(self) -> AsyncIterator[float]:
        return self

    async def __anext__(self) -> float:
        loop = asyncio.get_running_loop()
        now = clock_of(loop)
        first = self._begin is None
        due = self._next(now())
        if due <= now():
            if first:
                await Budget.spend()
            else:  # a tick that is late lets everybody else go on
                await asyncio.sleep(0)
        else:
            woken = loop.create_future()

            scheduler = Scheduler.beside(loop) if is_outside() else Scheduler.of(loop)
            one_shot = scheduler.at(due, lambda _now: wake(woken))
            try:
                await woken
            except BaseException:
                scheduler.cancel(one_shot)
                raise
            self._skip(now())
        return self._count * self.period

    def __iter__(self) -> Iterator[float]:
        """Tick in a plain behavior, whose thread waits meanwhile.

        Raises:
            ConfigError: In the event loop, where everybody would wait.
        """
        own = portal.get(None)
        if own is None and asyncio._get_running_loop() is not None:  # noqa: SLF001
            told = "an event loop is running: write 'async for' in it"
            raise ConfigError("every", "", told)
        while True:
            if own is not None:
                yield own.call(self.__anext__)
            else:
                due = self._next(time.monotonic())
                time.sleep(max(0.0, due - time.monotonic()))
                self._skip(time.monotonic())
                yield self._count * self.period

    def _next(self, now: float) -> float:
        if self._begin is None:
            self._begin = now
            return now
        self._count += 1
        return self._skip(now)

    def _skip(self, now: float) -> float:
        """Leave out the ticks that have passed, but the last; return when that was due."""
        assert self._begin is not None
        due = self._begin + self._count * self.period
        missed = int((now - due) / self.period)
        if missed > 0:
            self.late += missed
            self._count += missed
            due = self._begin + self._count * self.period
        return due


def every(period: float) -> Every:
    """Tick every ``period`` seconds: at once, then on a grid that never drifts.

    A tick that has passed when the loop comes back is left out and counted in
    ``late``; ticks are never made up for in a burst. The value of a tick is the
    time since the first one, in seconds.

    Raises:
        BadValueError: The period is not a number of seconds above 0.
        ConfigError: A plain ``for`` would hold up the event loop.

    Example:
        >>> async def run(self):
        ...     async for _ in esair.every(0.05):
        ...         await self.wheels.write(Twist(0.3, 0.0))
    """
    return Every(period)
