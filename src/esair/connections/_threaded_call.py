"""A driver call on the worker thread of its bus."""

from __future__ import annotations

import asyncio
from typing import Any

from esair.connections._call import Call, End, Ends
from esair.connections._driver import Guard, Method
from esair.loop import WAITS, LightTask


class ThreadedCall:
    """A call on a worker thread; what the function returns may have to be awaited."""

    def __init__(
        self, ends: Ends, call: Call, method: Method, guard: Guard | None
    ) -> None:
        assert method.executor is not None
        self.executor = method.executor()
        self._ends = ends
        self._call = call
        self._function = method.function
        self._guard = guard
        self._wanted = True
        self._rest: LightTask | None = None

    def submit(self, loop: asyncio.AbstractEventLoop) -> None:
        guard = None if self._guard is None else self._may_begin
        self.executor.submit(loop, self, self._function, *self._call.args, guard=guard)

    def _may_begin(self) -> bool:
        return self._wanted and (self._guard is None or self._guard())

    def cancel(self) -> None:
        self._wanted = False
        if self._rest is not None:
            self._rest.cancel()

    def expired(self) -> None:
        if self._rest is None:
            self.executor.expired()

    # The outcome of the executor.

    def done(self) -> bool:
        return False  # its end is wanted, however late

    def set_result(self, result: Any, /) -> None:
        if not hasattr(result, "__await__"):
            self._ends.ended(self._call, End(result, None))
            return
        rest = self._rest = LightTask(asyncio.get_running_loop(), str(self._call))
        try:
            value = rest.begin(awaited(result))
        except BaseException as error:  # contained: it is the driver's
            self.set_exception(error)
            return
        if value is WAITS:
            rest.then(
                lambda value, error: self._ends.over(self._call, End(value, error))
            )
        else:
            self._ends.ended(self._call, End(value, None))

    def set_exception(self, error: BaseException, /) -> None:
        self._ends.ended(self._call, End(None, error))


async def awaited(awaitable: Any) -> Any:
    """Wait for what a plain method has returned."""
    return await awaitable
