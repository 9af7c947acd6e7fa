"""What a test waits for, of what a robot sends."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable
from typing import Generic, TypeVar

from esair.buses._inbox import within

T = TypeVar("T")


class Awaited(Generic[T]):
    """Tests that wait until something has come."""

    def __init__(self) -> None:
        self._waiting: list[tuple[Callable[[T], bool], asyncio.Future[T]]] = []

    def came(self, item: T) -> None:
        """Tell who waits for it."""
        for matches, future in self._waiting:
            if not future.done() and matches(item):
                future.set_result(item)

    async def until(
        self,
        matches: Callable[[T], bool],
        there: Iterable[T],
        timeout: float,
        complain: Callable[[], str],
    ) -> T:
        """Return the first that matches, of what is there or of what comes in time."""
        for item in there:
            if matches(item):
                return item
        future: asyncio.Future[T] = asyncio.get_running_loop().create_future()
        waiter = (matches, future)
        self._waiting.append(waiter)
        try:
            return await within(future, timeout)
        except TimeoutError:
            raise TimeoutError(complain()) from None
        finally:
            self._waiting.remove(waiter)
