"""How a connection calls a driver, and what the driver's errors mean."""

from __future__ import annotations

import asyncio
import errno
import functools
import inspect
from collections.abc import Callable, Coroutine
from typing import Any, NamedTuple

from esair.exceptions import (
    DeviceFaultError,
    DeviceLostError,
    DriverStuckError,
    EsairError,
    describe,
)
from esair.loop import Executor
from esair.resources import Resource

_GONE = frozenset(
    {errno.ENODEV, errno.ENOENT, errno.ENOTCONN, errno.ESHUTDOWN, errno.EBADF}
)

Guard = Callable[[], bool]


class Method(NamedTuple):
    """A method of a driver, and where it is called.

    Attributes:
        function: What is called; a coroutine function if there is no executor.
        executor: Returns the thread that calls it; None if it is called in the loop.
        name: Its name.
    """

    function: Callable[..., Any]
    executor: Callable[[], Executor] | None
    name: str = ""

    def bound(self, **options: Any) -> Method:
        """Return the same with keyword arguments."""
        return Method(
            functools.partial(self.function, **options), self.executor, self.name
        )


class Driver:
    """The calls of one resource: in the loop, or on the executor of its bus.

    Args:
        resource: Whose methods are called.
    """

    def __init__(self, resource: Resource) -> None:
        self.resource = resource
        self._own_executor: Executor | None = None
        self._stream_executor: Executor | None = None

    @property
    def executor(self) -> Executor:
        """The thread for blocking methods: the bus's, or one of its own."""
        if self.resource.bus is not None:
            executor: Executor = self.resource.bus.executor
            return executor
        if self._own_executor is None:
            self._own_executor = Executor(self.resource.name)
        return self._own_executor

    @property
    def is_stuck(self) -> bool:
        """Whether a blocking call has not returned within its deadline."""
        bus = self.resource.bus
        executor = self._own_executor if bus is None else bus.executor
        return executor is not None and executor.stuck_since is not None

    async def stream_executor(self) -> Executor:
        """Return the one thread that waits for the next value of a blocking stream.

        Raises:
            DriverStuckError: It still waits for a value of the stream before.
        """
        resource = self.resource
        executor = self._stream_executor
        if executor is None:
            executor = self._stream_executor = Executor(f"{resource.name}_stream")
        if executor.stuck_since is not None:  # and one more thread would not help
            raise DriverStuckError(resource.name, "stream", resource.deadline)
        await executor.call(_nothing, timeout=resource.deadline)
        return executor

    async def end_executors(self, timeout: float) -> bool:
        """End the resource's own threads; tells whether they have ended in time."""
        executors = [
            executor
            for executor in (self._own_executor, self._stream_executor)
            if executor
        ]
        ended = await asyncio.gather(
            *(executor.join(timeout) for executor in executors)
        )
        return all(ended)

    def blocks(self, method: str) -> bool:
        """Tell whether a method is a plain function, which may block."""
        return not inspect.iscoroutinefunction(getattr(self.resource, method))

    def method(self, name: str) -> Method:
        """Return a method, to be called where it belongs."""
        function = getattr(self.resource, name)
        executor = self._get_executor if self.blocks(name) else None
        return Method(function, executor, name)

    def _get_executor(self) -> Executor:
        return self.executor

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

        async def on_executor(
            *args: Any, guard: Guard | None = None, **options: Any
        ) -> Any:
            bound = (lambda: function(*args, **options)) if options else function
            result = await self.executor.call(
                bound, *(() if options else args), timeout=limit, guard=guard
            )
            return await result if inspect.isawaitable(result) else result

        return on_executor


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
