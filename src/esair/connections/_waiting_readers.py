"""The readers that wait for a sensor's next reading."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

from esair.exceptions import BusyError, EsairError
from esair.loop import REACHED, Deadlines, arrive, clock_of
from esair.messages import Reading

WAITING_LIMIT = 1024  # how many readers may wait for one sensor at a time

Waiter = tuple[float, asyncio.Future[Reading[Any]], float, float]
"""Of which transaction the answer must be at least, what gets it, until when, and for
how many seconds that was."""


class WaitingReaders:
    """Keeps readers until the answer to a question that came after theirs."""

    __slots__ = (
        "_deadline",
        "_loop",
        "_name",
        "_silent",
        "_time",
        "readers",
        "turned_away",
    )

    def __init__(
        self,
        name: str,
        loop: asyncio.AbstractEventLoop,
        silent: Callable[[float], EsairError],
    ) -> None:
        self._name = name
        self._loop = loop
        self._silent = silent
        self._time = clock_of(loop)
        self._deadline = Deadlines.of(loop).idle(self._expire)
        """That of the reader whose time is over first."""
        self.readers: list[Waiter] = []  # who waits
        self.turned_away = 0

    async def reading(self, need: float, timeout: float) -> Reading[Any]:
        """Wait for what transaction `need` gives, or a later one."""
        if len(self.readers) >= WAITING_LIMIT:
            self.turned_away += 1
            raise BusyError(self._name, "number of waiting readers", WAITING_LIMIT)
        future: asyncio.Future[Reading[Any]] = self._loop.create_future()
        until = self._time() + timeout
        waiter = (need, future, until, timeout)
        self.readers.append(waiter)
        self._deadline.start_by(until)
        try:
            return await future
        finally:
            if waiter in self.readers:
                self.readers.remove(waiter)
                self._rest()

    def answer(self, number: float, answer: Reading[Any] | EsairError) -> None:
        """Tell what transaction `number` has given to those who wait for it."""
        waiters, self.readers = self.readers, []
        for waiter in waiters:
            need, future, *_ = waiter
            if future.done():
                continue
            if need > number:
                self.readers.append(waiter)
            elif isinstance(answer, Reading):
                arrive(future, answer, read=True)
            else:
                future.set_exception(answer)
        self._rest()

    def _rest(self) -> None:
        if not self.readers:
            self._deadline.cancel()

    def _expire(self) -> None:
        now = self._time() + REACHED
        for _, future, until, timeout in self.readers:
            if future.done():
                continue
            if until > now:
                self._deadline.start_by(until)
            else:
                future.set_exception(self._silent(timeout))
