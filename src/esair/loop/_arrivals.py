"""What comes from outside, and calls of drivers that go on as soon as it is there."""

from __future__ import annotations

import asyncio
from types import TracebackType
from typing import Any, TypeVar

from esair.loop._light_task import LightTask
from esair.loop._of_loop import OfLoop
from esair.loop._rate_group import contained

T = TypeVar("T")


class Arrivals(OfLoop):
    """All that one callback of the loop brings from outside.

    A call of a driver that waits for some of it goes on in that very callback, and needs
    no turn of the loop for that; but only when all of it is there, so that nothing that
    came before the driver went on is taken for what came after it.

    Example:
        >>> with Arrivals.of(loop):
        ...     for message in framing.feed(data):
        ...         deliver(message)  # calls `arrive`
    """

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self.so_far: list[tuple[asyncio.Future[Any], Any]] | None = None
        """What has arrived; None where a task runs, as no other can go on in it."""

    def __enter__(self) -> None:
        if asyncio.current_task(self._loop) is None:
            self.so_far = []

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        so_far, self.so_far = self.so_far, None
        for future, value in so_far or ():
            if not future.done():
                contained(self._loop, _go_on, future, value)


def arrive(future: asyncio.Future[T], value: T) -> None:
    """Bring what a future waits for; fine if nobody wants it any more."""
    if future.done():
        return
    callbacks: Any = future._callbacks  # noqa: SLF001 - the protocol of futures
    if callbacks and type(getattr(callbacks[0][0], "__self__", None)) is LightTask:
        so_far = Arrivals.of(future.get_loop()).so_far
        if so_far is not None:
            so_far.append((future, value))
            return
    future.set_result(value)  # a task of asyncio goes on in the next turn


def _go_on(future: asyncio.Future[T], value: T) -> None:
    callbacks: Any = future._callbacks  # noqa: SLF001 - the protocol of futures
    go_on, context = callbacks[0]
    future.remove_done_callback(go_on)
    future.set_result(value)
    context.run(go_on, future)
