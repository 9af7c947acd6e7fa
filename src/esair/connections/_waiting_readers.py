"""The readers that wait for a sensor's next reading."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

from esair.exceptions import BusyError, EsairError
from esair.loop import Deadlines, arrive
from esair.messages import Reading

WAITING_LIMIT = 1024  # how many readers may wait for one sensor at a time

Waiter = tuple[float, asyncio.Future[Reading[Any]]]
"""Of which transaction the answer must be at least, and what gets it."""


class WaitingReaders:
    """Keeps readers until the answer to a question that came after theirs."""

    __slots__ = ("_deadlines", "_loop", "_name", "_silent", "readers")

    def __init__(
        self,
        name: str,
        loop: asyncio.AbstractEventLoop,
        silent: Callable[[float], EsairError],
    ) -> None:
        self._name = name
        self._loop = loop
        self._silent = silent
        self._deadlines = Deadlines.of(loop)
        self.readers: list[Waiter] = []  # who waits

    async def reading(self, need: float, timeout: float) -> Reading[Any]:
        """Wait for what transaction `need` gives, or a later one."""
        if len(self.readers) >= WAITING_LIMIT:
            raise BusyError(self._name, "number of waiting readers", WAITING_LIMIT)
        future: asyncio.Future[Reading[Any]] = self._loop.create_future()
        waiter = (need, future)
        self.readers.append(waiter)
        deadline = self._deadlines.after(timeout, self._expire, future, timeout)
        try:
            return await future
        finally:
            deadline.cancel()
            if waiter in self.readers:
                self.readers.remove(waiter)

    def answer(self, number: float, answer: Reading[Any] | EsairError) -> None:
        """Tell what transaction `number` has given to those who wait for it."""
        waiters, self.readers = self.readers, []
        for waiter in waiters:
            need, future = waiter
            if future.done():
                continue
            if need > number:
                self.readers.append(waiter)
            elif isinstance(answer, Reading):
                arrive(future, answer, read=True)
            else:
                future.set_exception(answer)

    def _expire(self, future: asyncio.Future[Reading[Any]], timeout: float) -> None:
        if not future.done():
            future.set_exception(self._silent(timeout))
