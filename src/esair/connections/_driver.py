"""How a connection calls a driver, one call of it, and what its errors mean."""

from __future__ import annotations

import asyncio
import errno
import functools
import inspect
import math
from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import attrs

from esair.exceptions import (
    DeviceFaultError,
    DeviceLostError,
    DriverStuckError,
    EsairError,
    describe,
)
from esair.loop import Executor, wake
from esair.resources import Resource

OPERATE = "operate"
"""How the calls of operations are named; the operation's name comes after it."""

_GONE = frozenset(
    {errno.ENODEV, errno.ENOENT, errno.ENOTCONN, errno.ESHUTDOWN, errno.EBADF}
)

Guard = Callable[[], bool]


@attrs.frozen
class Method:
    """A method of a driver, and where it is called.

    Attributes:
        function: What is called: a coroutine function, unless there is an executor or
            it is plain.
        executor: Returns the thread that calls it; None if it is called in the loop.
        name: Its name.
        is_plain: It is a plain function that is called in the loop.
        is_usual: It is a coroutine function, as most are.
    """

    function: Callable[..., Any]
    executor: Callable[[], Executor] | None
    name: str = ""
    is_plain: bool = False
    is_usual: bool = attrs.field(init=False)

    @is_usual.default
    def _find_usual(self) -> bool:
        return self.executor is None and not self.is_plain

    def bound(self, **options: Any) -> Method:
        """Return the same with keyword arguments."""
        return attrs.evolve(self, function=functools.partial(self.function, **options))


class Driver:
    """The calls of one resource: in the loop, or on the executor of its bus."""

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
        """Return the one thread that waits for the next value of a blocking stream."""
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
        """Tell whether a method is a plain function that may block."""
        return self.resource.blocking and self._is_plain(method)

    def _is_plain(self, method: str) -> bool:
        return not inspect.iscoroutinefunction(getattr(self.resource, method))

    def method(self, name: str) -> Method:
        """Return a method, to be called where it belongs."""
        function = getattr(self.resource, name)
        if self.blocks(name):
            return Method(function, self._get_executor, name)
        return Method(function, None, name, self._is_plain(name))

    def _get_executor(self) -> Executor:
        return self.executor

    async def call(self, name: str, *args: Any, **options: Any) -> Any:
        """Call a method where it belongs, and wait for what it returns."""
        method = self.method(name)
        function = functools.partial(method.function, *args, **options)
        if method.executor is None:
            result = function()
        else:
            executor, limit = method.executor(), self.resource.deadline
            result = await executor.call(function, timeout=limit)
        return await result if inspect.isawaitable(result) else result


def _nothing() -> None:
    """Come after all calls that were made before."""


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


def translate_call(
    resource: str, kind: str, limit: float, error: BaseException
) -> EsairError:
    """Turn what came of a call into the error that its caller gets."""
    if isinstance(error, TimeoutError) and not isinstance(error, EsairError):
        stuck = DriverStuckError(resource, kind, limit)
        stuck.__cause__ = error
        return stuck
    return translate(resource, error)


class End(NamedTuple):
    """What came of a call: a value, or an error."""

    value: Any
    error: BaseException | None


Apply = Callable[["Call", End], None]


class Engine(Protocol):
    """What drives a call that waits."""

    def cancel(self) -> object:
        """Ask the driver's code to end."""


@attrs.define(eq=False, repr=False)
class Call:
    """One call of a driver that waits; one that ends in its first step is over at once."""

    resource: str
    kind: str  # what was called: read, write, safe, open, close, apply, identify
    opening: int  # the opening of the device that it belongs to
    number: int  # higher than that of all calls of this driver before
    args: tuple[Any, ...]
    begun: float  # when, on the loop's clock
    apply: Apply | None = None
    ended: float | None = None
    """When the driver's code has ended; None while it is alive."""
    outcome: End | None = None
    """What its caller was told; None while nobody was told anything."""
    cancelled: bool = False  # its caller has gone; what it still does is nobody's fault
    owner: object = None  # the right by which it was begun, if it needs one
    engine: Engine | None = None
    until: float = math.inf  # when its time is over, on the loop's clock
    limit: float = math.inf  # for how many seconds that was
    waiters: list[asyncio.Future[None]] = attrs.field(factory=list)
    taped: Callable[[End], None] | None = None  # keeps its end, where a run is recorded

    @property
    def is_abandoned(self) -> bool:
        """Whether its caller was told an outcome while it is still alive."""
        return self.ended is None and self.outcome is not None

    @property
    def may_move(self) -> bool:
        """Whether it may move an actuator: a command, or an operation."""
        return self.kind == "write" or self.kind.startswith(OPERATE)

    def cancel(self) -> None:
        """Ask the driver to end it; a thread cannot be asked."""
        self.cancelled = True
        if self.engine is not None:
            self.engine.cancel()

    def wake(self) -> None:
        """Let those go on who wait for its outcome, or its end."""
        waiters, self.waiters = self.waiters, []
        wake(*waiters)

    def __str__(self) -> str:
        what = ", ".join(f"{each!r:.40}" for each in self.args)
        return f"{self.kind} {self.number} ({what})" if what else self._short

    @property
    def _short(self) -> str:
        return f"{self.kind} {self.number}"


class GivenUpError(DeviceLostError):
    """The robot closes a device that is there: it may move still, and obey."""


def given_up(call: Call) -> GivenUpError:
    """Make the error for a device whose driver does not end a call."""
    return GivenUpError(call.resource, f"{call} was given up and does not end")
