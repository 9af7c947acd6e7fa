"""What a test waits for, of what a robot sends."""

from __future__ import annotations

import asyncio
import collections
from collections.abc import Callable, Iterable
from typing import Any, Generic, SupportsIndex, TypeVar, overload

from esair.buses._inbox import within

T = TypeVar("T")


class Sent(collections.deque[T]):
    """The newest that a robot has sent, in order; a slice of it is a list."""

    @overload
    def __getitem__(self, at: SupportsIndex) -> T: ...
    @overload
    def __getitem__(self, at: slice) -> list[T]: ...
    def __getitem__(self, at: Any) -> Any:
        return list(self)[at] if isinstance(at, slice) else super().__getitem__(at)


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
