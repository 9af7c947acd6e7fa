"""Ports whose calls wait. Written by tools/make_blocking.py."""

# What a thread calls waits where its base is awaited: that is the idea of it.
# mypy: disable-error-code="no-any-return"

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from typing import Any, Generic, TypeVar

from esair.actions._waiting import in_loop, next_of
from esair.connections import ActuatorPort, Port, SensorPort
from esair.exceptions import BehaviorRemovedError
from esair.loop import Portal
from esair.messages import Reading, Refused, ResourceState, Why, Written
from esair.resources import Operation

T = TypeVar("T")


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
        """Change settings of the device: all of them, or none.

        Raises:
            AccessDeniedError: The port was not declared with ``configure=True``.
            BadValueError: A setting is unknown, or a value is not allowed.
        """
        self._portal.call(self._port.configure, **settings)

    def operate(self, name: str, /, **parameters: Any) -> Any:
        """Call an operation of the device, such as ``home``, and wait for its outcome.

        Args:
            name: The name of the operation.
            **parameters: What it takes, by name; checked before anything is done.

        Returns:
            What the operation returns.

        Raises:
            AccessDeniedError: The port was not declared with ``configure=True``, or
                somebody else holds the actuator.
            UnknownNameError: There is no such operation.
            BadValueError: A parameter is unknown, missing, or not allowed.
            HaltedError: The robot is halted.
            DeviceLostError: The device is not there.
            DeviceFaultError: The device answered wrongly.
            DriverStuckError: It did not end within its deadline.
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
        """Return a value: the newest one, or one that is newer than now.

        The device is asked when its newest reading is older than its period.

        Args:
            fresh: Only a value that was measured after this call.
            max_age: The greatest age, in seconds; the port's unless given.
            timeout: How long to wait for the device; 1 s unless given.

        Raises:
            StaleReadingError: There is no reading that is fresh enough.
            DeviceLostError: The device is not there.
            DeviceFaultError: The device answered wrongly.
            ResourceRemovedError: The user took the sensor away.
            NotRegisteredError: The registration was revoked.
        """
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
        """The newest reading, without a wait, as a reaction sees it.

        Raises:
            StaleReadingError: There is none, or it is older than `max_age`.
            DeviceLostError: The device is not there.
            ResourceRemovedError: The user took the sensor away.
            NotRegisteredError: The registration was revoked.
        """
        return self._port.newest

    def history(self, count: int) -> list[Reading[T]]:
        """Return the last readings, the oldest first; at most `history_size` of them."""
        return self._portal.call(in_loop, self._port.history, count)

    def __iter__(self) -> Iterator[T]:
        """Yield each new value; a slow reader misses some and gets the newest."""
        values = self._port._values()  # noqa: SLF001 - the same port, for a thread
        try:
            while True:
                yield self._portal.call(next_of, values)
        finally:
            with contextlib.suppress(BehaviorRemovedError):  # its tasks are gone too
                self._portal.call(values.aclose)


class BlockingActuatorPort(BlockingPort[T]):
    """A `ActuatorPort` for a behavior with a plain ``run``: the thread waits."""

    __slots__ = ()

    _port: ActuatorPort[T]

    def write(self, command: T, *, hold: float | None = None) -> Written[T] | Refused:
        """Send a command, and hold the actuator for a while.

        Args:
            command: A command of the actuator's type, finite and within limits.
            hold: For how long nobody of the same or a lower priority gets through,
                in seconds; the actuator's command timeout unless given. Each write
                renews it.

        Returns:
            What was really sent; or a refusal, false in a condition, that says who
            holds the actuator.

        Raises:
            BadValueError: The command must not be sent; nothing was.
            DeviceLostError: The device is not there.
            DeviceFaultError: The device did not take it.
            DriverStuckError: The driver did not return in time.
            ResourceRemovedError: The user took the actuator away.
            NotRegisteredError: The registration was revoked.
        """
        return self._portal.call(self._port.write, command, hold=hold)

    def release(self) -> None:
        """Give the actuator back at once: lower priorities get through.

        It is done when this returns; it may be awaited, like the other verbs of a port.
        """
        self._portal.call(in_loop, self._port.release)

    def why(self) -> Why:
        """Tell who holds the actuator, by which rule, and what would free it."""
        return self._portal.call(in_loop, self._port.why)
