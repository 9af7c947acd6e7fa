"""What comes from outside, and who goes on as soon as it is there."""

from __future__ import annotations

import asyncio
import contextvars
from typing import Any, TypeVar

from esair.loop._light_task import LightTask
from esair.loop._of_loop import OfLoop
from esair.loop._rate_group import contained

T = TypeVar("T")


_Arrived = list[tuple[asyncio.Future[Any], Any, tuple[Any, contextvars.Context]]]
"""What somebody waits for, the value, and how who waits goes on."""


class Arrivals(OfLoop):
    """All that one callback of the loop brings from outside.

    A call of a driver that waits for some of it goes on in that very callback, and needs no
    turn of the loop for that; but only when all of it is there, so that nothing that came
    before it went on is taken for what came after it.

    Example:
        >>> with Arrivals.of(loop):
        ...     for message in framing.feed(data):
        ...         deliver(message)  # calls `arrive`
    """

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._depth = 0
        self.so_far: _Arrived | None = None
        """What has arrived; None where a task runs, as no other can go on in it."""

    def __enter__(self) -> None:
        self._depth += 1
        if self._depth == 1 and asyncio.current_task(self._loop) is None:
            self.so_far = []

    def __exit__(self, _: object, error: BaseException | None, *__: object) -> None:
        so_far = self.so_far
        try:
            if self._depth == 1 and so_far is not None:
                self.so_far = made_of_it = _Arrived()
                self._go_on(so_far)
                self.so_far = None  # else who is answered at once would never give way
                self._go_on(made_of_it)
        finally:
            self._depth -= 1
            if not self._depth:
                self.so_far = None

    def _go_on(self, arrived: _Arrived) -> None:
        for future, value, (step, context) in arrived:
            if not future.done():
                future.remove_done_callback(step)
                future.set_result(value)
                contained(self._loop, context.run, step, future)


def arrive(future: asyncio.Future[T], value: T) -> None:
    """Bring what a future waits for; fine if nobody wants it any more."""
    if future.done():
        return
    arrivals = Arrivals.of(future.get_loop())
    callbacks: Any = future._callbacks  # noqa: SLF001 - the protocol of futures
    if (
        callbacks
        and arrivals.so_far is not None
        and isinstance(getattr(callbacks[0][0], "__self__", None), LightTask)
    ):
        arrivals.so_far.append((future, value, callbacks[0]))
        return
    future.set_result(value)  # who waits goes on in the next turn
