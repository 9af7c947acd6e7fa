"""What one listener on a bus has not taken yet: bounded, and the newest wins."""

from __future__ import annotations

import asyncio
import collections
from collections.abc import AsyncIterator, Callable, Sequence
from typing import Generic, Self, TypeVar

from esair.exceptions import BadValueError
from esair.loop import Deadlines, arrive

T = TypeVar("T")


class Inbox(Generic[T]):
    """The items that arrived for one listener, oldest first.

    When it is full the oldest item gives way to the newest and is counted. When the
    bus is lost whoever waits gets the error at once, and so does everybody later:
    listen again once the bus is open again. As a context manager it is closed at the end.

    Attributes:
        dropped: How many items gave way because nobody took them in time.
    """

    def __init__(
        self, limit: int, forget: Callable[[Inbox[T]], object] = lambda _inbox: None
    ) -> None:
        if type(limit) is not int or limit < 1:
            raise BadValueError(
                "inbox", "limit", f"expected 1 or more, not {limit!r:.80}"
            )
        self.dropped: int = 0
        self._items: collections.deque[T] = collections.deque(maxlen=limit)
        self._forget = forget
        self._waiter: asyncio.Future[None] | None = None
        self._error: BaseException | None = None
        self._closed = False

    def __len__(self) -> int:
        return len(self._items)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()

    def offer(self, item: T) -> None:
        """Add the newest item; never waits and never fails."""
        items = self._items
        if len(items) == items.maxlen:
            self.dropped += 1
        items.append(item)
        self._wake()

    def extend(self, items: Sequence[T]) -> None:
        """Add items, the newest last; never waits and never fails."""
        kept = self._items
        self.dropped += max(0, len(kept) + len(items) - (kept.maxlen or 0))
        kept.extend(items)
        waiter = self._waiter
        if items and waiter is not None:
            self._waiter = None
            arrive(waiter, None)

    def fail(self, error: BaseException) -> None:
        """Let every further wait raise an error."""
        self._error = error
        self._items.clear()
        self._wake()

    def close(self) -> None:
        """Listen no more; whoever waits comes to the end of the iteration."""
        self._closed = True
        self._forget(self)
        self._wake()

    async def take(self, *, timeout: float | None = None) -> T:
        """Wait for the next item and take it.

        Args:
            timeout: How long to wait, in seconds; for ever if None.

        Raises:
            TimeoutError: Nothing came in time.
            StopAsyncIteration: The inbox was closed.
            DeviceLostError: The bus is lost.
        """
        while not self._items:
            if self._error is not None:
                # Anew: else each who asks would leave its frames in the traceback.
                raise self._error.with_traceback(None)
            if self._closed:
                raise StopAsyncIteration
            if self._waiter is not None:
                raise RuntimeError(
                    "an inbox has one listener; open another for another"
                )
            self._waiter = asyncio.get_running_loop().create_future()
            try:
                if timeout is None:
                    await self._waiter
                else:
                    await within(self._waiter, timeout)
            finally:
                self._waiter = None
        return self._items.popleft()

    def __aiter__(self) -> AsyncIterator[T]:
        return self

    __anext__ = take

    def _wake(self) -> None:
        waiter, self._waiter = self._waiter, None
        if waiter is not None:
            arrive(waiter, None)


async def within(future: asyncio.Future[T], seconds: float | None) -> T:
    """Wait for a future, without a task or a timer of its own."""
    if seconds is None or future.done():
        return await future
    deadlines = Deadlines.beside(asyncio.get_running_loop())
    deadline = deadlines.after(seconds, _expire, future)
    try:
        return await future
    finally:
        deadline.cancel()


def _expire(future: asyncio.Future[T]) -> None:
    if not future.done():
        future.set_exception(TimeoutError())
