"""How a connection calls a driver, and what the driver's errors mean."""

from __future__ import annotations

import asyncio
import errno
import inspect
from collections.abc import Callable, Coroutine
from typing import Any

from esair.exceptions import (
    DeviceFaultError,
    DeviceLostError,
    DriverStuckError,
    EsairError,
    describe,
)
from esair.loop import Lane
from esair.resources import Resource

_GONE = frozenset(
    {errno.ENODEV, errno.ENOENT, errno.ENOTCONN, errno.ESHUTDOWN, errno.EBADF}
)

Guard = Callable[[], bool]


class Driver:
    """The calls of one resource: in the loop, or on the lane of its bus.

    Args:
        resource: Whose methods are called.
    """

    def __init__(self, resource: Resource) -> None:
        self.resource = resource
        self._own_lane: Lane | None = None
        self._stream_lane: Lane | None = None

    @property
    def lane(self) -> Lane:
        """The thread for blocking methods: the bus's, or one of its own."""
        if self.resource.bus is not None:
            lane: Lane = self.resource.bus.lane
            return lane
        if self._own_lane is None:
            self._own_lane = Lane(self.resource.name)
        return self._own_lane

    @property
    def is_stuck(self) -> bool:
        """Whether a blocking call has not returned within its deadline."""
        bus = self.resource.bus
        lane = self._own_lane if bus is None else bus.lane
        return lane is not None and lane.stuck_since is not None

    async def stream_lane(self) -> Lane:
        """Return the one thread that waits for the next value of a blocking stream.

        Raises:
            DriverStuckError: It still waits for a value of the stream before.
        """
        resource = self.resource
        lane = self._stream_lane
        if lane is None:
            lane = self._stream_lane = Lane(f"{resource.name}_stream")
        if lane.stuck_since is not None:  # and one more thread would not help
            raise DriverStuckError(resource.name, "stream", resource.deadline)
        await lane.call(_nothing, timeout=resource.deadline)
        return lane

    async def end_lane(self, timeout: float) -> bool:
        """End the resource's own threads; tells whether they have ended in time."""
        lanes = [lane for lane in (self._own_lane, self._stream_lane) if lane]
        ended = await asyncio.gather(*(lane.join(timeout) for lane in lanes))
        return all(ended)

    def blocks(self, method: str) -> bool:
        """Tell whether a method is a plain function, which may block."""
        return not inspect.iscoroutinefunction(getattr(self.resource, method))

    def call(
        self, method: str, *, timeout: float | None = None
    ) -> Callable[..., Coroutine[Any, Any, Any]]:
        """Return a coroutine function that calls a method where it belongs.

        Args:
            method: The name of the method.
            timeout: How long a blocking call may take; the resource's deadline
                unless given. Calls in the loop are bounded by whoever awaits them.
        """
        function = getattr(self.resource, method)
        if not self.blocks(method):
            return function  # type: ignore[no-any-return]
        limit = self.resource.deadline if timeout is None else timeout

        async def on_lane(
            *args: Any, guard: Guard | None = None, **options: Any
        ) -> Any:
            bound = (lambda: function(*args, **options)) if options else function
            result = await self.lane.call(
                bound, *(() if options else args), timeout=limit, guard=guard
            )
            return await result if inspect.isawaitable(result) else result

        return on_lane


def _nothing() -> None:
    """Come after all calls that were made before."""


def is_drivers(error: BaseException) -> bool:
    """Tell whether an error is a driver's own, whatever its class.

    It is not if somebody cancels the task that called the driver, or closes it, which
    happens only when its loop is over.
    """
    if isinstance(error, asyncio.CancelledError):
        task = asyncio.current_task()
        return task is not None and not task.cancelling()
    if isinstance(error, GeneratorExit):
        return asyncio._get_running_loop() is not None  # noqa: SLF001 - it does not raise
    return True


def is_loss(error: BaseException) -> bool:
    """Tell whether an error of a driver means that its device is gone."""
    if isinstance(error, ConnectionError | EOFError | FileNotFoundError):
        return True
    return isinstance(error, OSError) and error.errno in _GONE


def translate(resource: str, error: BaseException) -> EsairError:
    """Turn whatever a driver raised into the error that its caller gets."""
    if isinstance(error, DeviceFaultError | DriverStuckError):
        return error
    if isinstance(error, DeviceLostError) and error.resource == resource:
        return error
    translated: EsairError
    if is_loss(error):
        translated = DeviceLostError(resource, describe(error))
    else:
        translated = DeviceFaultError(resource, describe(error))
    translated.__cause__ = error
    return translated
