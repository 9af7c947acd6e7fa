"""Ports whose calls wait, and how such a call is made of one that is awaited."""

# mypy: disable-error-code="no-any-return"

from __future__ import annotations

import contextlib
import functools
import inspect
from collections.abc import AsyncGenerator, Awaitable, Callable, Iterator, Mapping
from typing import Any, Concatenate, Final, Generic, ParamSpec, TypeVar, cast

from esair.connections import ActuatorPort, Port, SensorPort
from esair.exceptions import BehaviorRemovedError
from esair.loop import Portal
from esair.messages import Reading, ResourceState
from esair.resources import Operation

T = TypeVar("T")
R = TypeVar("R")
S = TypeVar("S")
P = ParamSpec("P")


class Waits:
    """What a thread has in its hand of something that lives in the event loop."""

    __slots__ = ("_base", "_portal")

    def __init__(self, base: Any, portal: Portal) -> None:
        self._base = base
        self._portal = portal


def _held(held: Waits) -> tuple[Portal, Any]:
    return held._portal, held._base  # noqa: SLF001 - in its own module


def waits(
    method: Callable[Concatenate[S, P], Awaitable[R]],
    way: Callable[[Any], tuple[Portal, Any]] = _held,
) -> Callable[Concatenate[Any, P], R]:
    """Return a method with the same parameters that waits, in the thread that calls it.

    Args:
        method: What is called in the loop.
        way: Says through which portal, and on which object.
    """

    @functools.wraps(method)
    def call(self: Any, /, *args: P.args, **options: P.kwargs) -> R:
        portal, base = way(self)
        return portal.call(in_loop, method, base, *args, **options)

    return call


def each_of(values: AsyncGenerator[T, None], portal: Portal) -> Iterator[T]:
    """Yield in a thread what is awaited in the loop, and end it there."""
    try:
        while True:
            yield portal.call(values.__anext__)
    finally:
        # Its tasks are gone too; or the collector ends it, who may be in the loop.
        with contextlib.suppress(BehaviorRemovedError, RuntimeError):
            portal.call(values.aclose)


def calls(
    method: Callable[Concatenate[S, P], R],
    way: Callable[[Any], tuple[Portal, Any]] = _held,
) -> Callable[Concatenate[Any, P], R]:
    """Return the same of a plain method: it is called in the loop."""
    return waits(cast("Callable[Concatenate[S, P], Awaitable[R]]", method), way)


async def in_loop(method: Callable[..., Any], /, *args: Any, **options: Any) -> Any:
    """Call a method where it belongs, while its thread waits for what it gives."""
    found = method(*args, **options)
    return await found if inspect.isawaitable(found) else found


def blocking(port: Any, portal: Portal) -> Any:
    """Return the same port for the thread of a plain behavior."""
    kind = BlockingSensorPort if isinstance(port, SensorPort) else BlockingActuatorPort
    return kind(port, portal)


class BlockingPort(Waits, Generic[T]):
    """A `Port` for a behavior with a plain ``run``: the thread waits."""

    __slots__ = ()

    configure: Final = waits(Port.configure)
    operate: Final = waits(Port.operate)

    @property
    def resource(self) -> str:
        """The name of the device."""
        return self._base.resource

    @property
    def operations(self) -> Mapping[str, Operation]:
        """What can be called by `operate`, by name, with its parameters."""
        return self._base.operations

    @property
    def settings(self) -> Mapping[str, Any]:
        """The current settings of the device."""
        return self._base.settings

    @property
    def state(self) -> ResourceState:
        """What the device is doing."""
        return self._base.state


class BlockingSensorPort(BlockingPort[T]):
    """A `SensorPort` for a behavior with a plain ``run``: the thread waits."""

    __slots__ = ()

    read: Final = waits(SensorPort[T].read)
    reading: Final = waits(SensorPort[T].reading)
    history: Final = calls(SensorPort[T].history)

    @property
    def max_age(self) -> float:
        """The greatest age of a reading unless a call says otherwise, in seconds."""
        return self._base.max_age

    @property
    def newest(self) -> Reading[T]:
        """The newest reading, without a wait; see `SensorPort.newest`."""
        return self._base.newest

    def __iter__(self) -> Iterator[T]:
        """Yield each new value; a slow reader misses some and gets the newest."""
        return each_of(self._base._values(), self._portal)  # noqa: SLF001 - as the port


class BlockingActuatorPort(BlockingPort[T]):
    """An `ActuatorPort` for a behavior with a plain ``run``: the thread waits."""

    __slots__ = ()

    write: Final = waits(ActuatorPort[T].write)
    release: Final = waits(ActuatorPort[T].release)
    why: Final = calls(ActuatorPort[T].why)
