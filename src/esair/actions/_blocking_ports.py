"""Ports whose calls wait. Written by tools/make_blocking.py."""

# What a thread calls waits where its base is awaited: that is the idea of it.
# mypy: disable-error-code="no-any-return"

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Generic, TypeVar

from esair.connections import ActuatorPort, Port, SensorPort
from esair.exceptions import BehaviorRemovedError
from esair.loop import Portal
from esair.messages import Reading, Refused, ResourceState, Why, Written
from esair.resources import Operation

T = TypeVar("T")


async def in_loop(function: Callable[..., T], *args: Any, **options: Any) -> T:
    """Call a plain function where it belongs, while its thread waits."""
    return function(*args, **options)


async def forever() -> None:
    await asyncio.get_running_loop().create_future()


def blocking(port: Any, portal: Portal) -> Any:
    """Return the same port for the thread of a plain behavior."""
    kind = BlockingSensorPort if isinstance(port, SensorPort) else BlockingActuatorPort
    return kind(port, portal)


class BlockingPort(Generic[T]):
    """A `Port` for a behavior with a plain ``run``: the thread waits."""

    __slots__ = ("_port", "_portal")

    def __init__(self, port: Port[T], portal: Portal) -> None:
        self._port = port
        self._portal = portal

    @property
    def resource(self) -> str:
        """The name of the device."""
        return self._port.resource

    def configure(self, **settings: Any) -> None:
        """Change settings of the device: all of them, or none. See `Port.configure`."""
        self._portal.call(self._port.configure, **settings)

    def operate(self, name: str, /, **parameters: Any) -> Any:
        """Call an operation of the device, such as ``home``, and wait for its outcome.

        See `Port.operate`.
        """
        return self._portal.call(self._port.operate, name, **parameters)

    @property
    def operations(self) -> Mapping[str, Operation]:
        """What can be called by `operate`, by name, with its parameters."""
        return self._port.operations

    @property
    def settings(self) -> Mapping[str, Any]:
        """The current settings of the device."""
        return self._port.settings

    @property
    def state(self) -> ResourceState:
        """What the device is doing."""
        return self._port.state


class BlockingSensorPort(BlockingPort[T]):
    """A `SensorPort` for a behavior with a plain ``run``: the thread waits."""

    __slots__ = ()

    _port: SensorPort[T]

    @property
    def max_age(self) -> float:
        """The greatest age of a reading unless a call says otherwise, in seconds."""
        return self._port.max_age

    def read(
        self,
        *,
        fresh: bool = False,
        max_age: float | None = None,
        timeout: float | None = None,
    ) -> T:
        """Return a value: the newest one, or one that is newer than now. See `SensorPort.read`."""
        return self._portal.call(
            self._port.read, fresh=fresh, max_age=max_age, timeout=timeout
        )

    def reading(
        self,
        *,
        fresh: bool = False,
        max_age: float | None = None,
        timeout: float | None = None,
    ) -> Reading[T]:
        """Return what `read` does, with its time and sequence number."""
        return self._portal.call(
            self._port.reading, fresh=fresh, max_age=max_age, timeout=timeout
        )

    @property
    def newest(self) -> Reading[T]:
        """The newest reading, without a wait, as a reaction sees it. See `SensorPort.newest`."""
        return self._port.newest

    def history(self, count: int) -> list[Reading[T]]:
        """Return the last readings, the oldest first; at most `history_size` of them."""
        return self._portal.call(in_loop, self._port.history, count)

    def __iter__(self) -> Iterator[T]:
        """Yield each new value; a slow reader misses some and gets the newest."""
        values = self._port._values()  # noqa: SLF001 - the same port, for a thread
        try:
            while True:
                yield self._portal.call(values.__anext__)
        finally:
            # Its tasks are gone too; or the collector ends it, who may be in the loop.
            with contextlib.suppress(BehaviorRemovedError, RuntimeError):
                self._portal.call(values.aclose)


class BlockingActuatorPort(BlockingPort[T]):
    """A `ActuatorPort` for a behavior with a plain ``run``: the thread waits."""

    __slots__ = ()

    _port: ActuatorPort[T]

    def write(self, command: T, *, hold: float | None = None) -> Written[T] | Refused:
        """Send a command, and hold the actuator for a while. See `ActuatorPort.write`."""
        return self._portal.call(self._port.write, command, hold=hold)

    def release(self) -> None:
        """Give the actuator back at once: lower priorities get through.

        See `ActuatorPort.release`.
        """
        self._portal.call(in_loop, self._port.release)

    def why(self) -> Why:
        """Tell who holds the actuator, by which rule, and what would free it."""
        return self._portal.call(in_loop, self._port.why)
