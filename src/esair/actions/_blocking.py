"""Ports and behaviors whose calls wait. Written by tools/make_blocking.py."""

# What a thread calls waits where its base is awaited: that is the idea of it.
# mypy: disable-error-code="override, no-any-return"

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Generic, TypeVar, cast

from esair import minimal
from esair.actions._behavior import Behavior, forever, in_loop, next_of, portal_of
from esair.actions._ports import ActuatorPort, SensorPort
from esair.actions._reaction import Reaction
from esair.actions._request import Request
from esair.actions._supervisor import BlockingBehaviors
from esair.connections import Stopped
from esair.exceptions import BehaviorRemovedError
from esair.loop import Portal
from esair.messages import Access, Reading, Refused, ResourceState, Why, Written
from esair.resources import Operation

A = TypeVar("A")
T = TypeVar("T")


def blocking(port: Any, portal: Portal) -> Any:
    """Return the same port for the thread of a plain behavior."""
    kind = BlockingSensorPort if isinstance(port, SensorPort) else BlockingActuatorPort
    return kind(port, portal)


class BlockingSensorPort(Generic[T]):
    """A `SensorPort` for a behavior with a plain ``run``: the thread waits."""

    __slots__ = ("_port", "_portal")

    def __init__(self, port: SensorPort[T], portal: Portal) -> None:
        self._port = port
        self._portal = portal

    @property
    def max_age(self) -> float:
        """The greatest age of a reading unless a call says otherwise, in seconds."""
        return self._port.max_age

    @property
    def resource(self) -> str:
        """The name of the sensor."""
        return self._port.resource

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

    def configure(self, **settings: Any) -> None:
        """Change settings of the sensor: all of them, or none.

        Raises:
            AccessDeniedError: The port was not declared with ``configure=True``.
            BadValueError: A setting is unknown, or a value is not allowed.
        """
        self._portal.call(self._port.configure, **settings)

    def operate(self, name: str, /, **parameters: Any) -> Any:
        """Call an operation of the sensor, such as ``home``, and wait for its outcome.

        Args:
            name: The name of the operation.
            **parameters: What it takes, by name; checked before anything is done.

        Returns:
            What the operation returns.

        Raises:
            AccessDeniedError: The port was not declared with ``configure=True``.
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
        """The current settings of the sensor."""
        return self._port.settings

    @property
    def state(self) -> ResourceState:
        """What the sensor is doing."""
        return self._port.state

    def __iter__(self) -> Iterator[T]:
        """Yield each new value; a slow reader misses some and gets the newest."""
        values = self._port._values()  # noqa: SLF001 - the same port, for a thread
        try:
            while True:
                yield self._portal.call(next_of, values)
        finally:
            with contextlib.suppress(BehaviorRemovedError):  # its tasks are gone too
                self._portal.call(values.aclose)


class BlockingActuatorPort(Generic[T]):
    """A `ActuatorPort` for a behavior with a plain ``run``: the thread waits."""

    __slots__ = ("_port", "_portal")

    def __init__(self, port: ActuatorPort[T], portal: Portal) -> None:
        self._port = port
        self._portal = portal

    @property
    def resource(self) -> str:
        """The name of the actuator."""
        return self._port.resource

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

    def configure(self, **settings: Any) -> None:
        """Change settings of the actuator: all of them, or none.

        Raises:
            AccessDeniedError: The port was not declared with ``configure=True``.
            BadValueError: A setting is unknown, or a value is not allowed.
        """
        self._portal.call(self._port.configure, **settings)

    def operate(self, name: str, /, **parameters: Any) -> Any:
        """Call an operation of the actuator, such as ``home``, and wait for its outcome.

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
        """The current settings of the actuator."""
        return self._port.settings

    @property
    def state(self) -> ResourceState:
        """What the actuator is doing."""
        return self._port.state


class ThreadBehavior(Behavior):
    """A behavior with a thread of its own: its ports and methods wait.

    Write a plain ``def run``. Everything else is as in `Behavior`.

    Example:
        >>> class Inspect(esair.ThreadBehavior):
        ...     arm = esair.writes(float)
        ...
        ...     def run(self) -> None:
        ...         for _ in esair.every(0.1):
        ...             self.arm.write(0.5)
    """

    def run(self) -> None:
        """Do the work, in the thread. Unless overridden it waits."""
        portal_of(self).call(forever)

    @property
    def supervisor(self) -> BlockingBehaviors:
        """The behaviors of the robot: what they do, and, with a right, to manage them."""
        return cast("BlockingBehaviors", super().supervisor)

    def put(self, receiver: str, data: Any, interval: float = 1.0) -> None:
        """Hand data to another behavior, through the behavior supervisor.

        Returns when it lies in the receiver's inbox. A receiver that cannot take
        it is asked again until it can, or until the interval has passed.

        Args:
            receiver: The name of the other behavior.
            data: What it gets, untouched.
            interval: How long to keep asking, in seconds.

        Raises:
            UnknownNameError: No behavior has the name.
            BehaviorUnavailableError: It could not receive for the interval; it
                will never see the data.
            BehaviorRemovedError: It was removed meanwhile.
            BehaviorFailedError: It crashed meanwhile.
            BusyError: Too many requests wait.
        """
        portal_of(self).call(Behavior.put, self, receiver, data, interval)

    def get(self, sender: str, interval: float = 1.0) -> Any:
        """Ask another behavior for data, through the behavior supervisor.

        The other answers with what it has offered, or by its ``provide``.

        Args:
            sender: The name of the other behavior.
            interval: How long to keep asking, in seconds.

        Raises:
            UnknownNameError: No behavior has the name.
            BehaviorUnavailableError: It could not send for the interval.
            CircularRequestError: It waits for this behavior's answer.
            BehaviorRemovedError: It was removed meanwhile.
            BehaviorFailedError: It crashed meanwhile, or its ``provide`` did.
            BusyError: Too many requests wait.
        """
        return portal_of(self).call(Behavior.get, self, sender, interval)

    def ask(
        self,
        receiver: str,
        request: Request[A],
        *,
        timeout: float | None = 10.0,
        progress: Callable[[Any], object] | None = None,
    ) -> A:
        """Ask another behavior to do something, and wait for its answer.

        The request has one outcome, whatever becomes of the other. If this task is
        cancelled, or this behavior ends, the other never sees the request, or its work
        on it is cancelled.

        Args:
            receiver: The name of the other behavior.
            request: What it is asked; its class says what it is answered with.
            timeout: How long it may wait and work, in seconds; None for no limit.
            progress: Called with what the other tells of its progress; of several
                that wait the newest wins. It may be a coroutine function.

        Returns:
            The answer.

        Raises:
            UnknownNameError: No behavior has the name, or a reaction has.
            RefusedError: The other refused, or does not take such requests.
            BehaviorFailedError: It failed, or ended its work without an answer.
            BehaviorRemovedError: It was removed, or replaced while it worked.
            BehaviorUnavailableError: There was no answer in time.
            CircularRequestError: It waits, itself or through others, for this one.
            BusyError: Too many requests wait.
            StoppingError: The robot is stopping.
        """
        return portal_of(self).call(
            Behavior.ask, self, receiver, request, timeout=timeout, progress=progress
        )

    def receive(self, *, timeout: float | None = None) -> Any:
        """Wait for data that another behavior has put, and take it.

        Args:
            timeout: How long to wait, in seconds; None for no limit.

        Raises:
            TimeoutError: There was none in time; what comes later waits.
        """
        return portal_of(self).call(Behavior.receive, self, timeout=timeout)

    def receive_from(self, *, timeout: float | None = None) -> tuple[str, Any]:
        """Wait for data as `receive` does.

        Args:
            timeout: How long to wait, in seconds; None for no limit.

        Returns:
            Who has put it, and the data.

        Raises:
            TimeoutError: There was none in time; what comes later waits.
        """
        return portal_of(self).call(Behavior.receive_from, self, timeout=timeout)

    def offer(self, data: Any, *, latest: bool = False) -> None:
        """Lay data out for a `get` of others; each piece goes to one of them.

        Args:
            data: What one of them gets, untouched.
            latest: Everybody may get it, again and again, until the next offer.

        Raises:
            BusyError: The outbox is full, and its policy is ``"reject"``.
        """
        portal_of(self).call(in_loop, Behavior.offer, self, data, latest=latest)

    def perform(
        self,
        reaction: Reaction | minimal.Reaction,
        *,
        until: Callable[..., bool] | None = None,
        timeout: float | None = None,
        blind_timeout: float | None = None,
    ) -> bool:
        """Run a reaction as a step of this behavior.

        Args:
            reaction: What to run. It is registered in this behavior's name.
            until: Asked after each of its steps; it ends the reaction. Its
                parameters, if any, are named like readings and get them.
            timeout: How long it may run, in seconds.
            blind_timeout: How long it may be blind at a time, in seconds; no limit
                unless given. Meanwhile it keeps its actuators safe, as it does
                without a behavior, and ``query`` tells why.

        Returns:
            True if the condition came true, False if the time was over.

        Raises:
            AccessDeniedError: This behavior may not do what the reaction does.
            DeviceLostError: It was blind for too long: a device is not there.
            StaleReadingError: It was blind for too long: a sensor is silent.
            Exception: What the reaction raised.
        """
        return portal_of(self).call(
            Behavior.perform,
            self,
            reaction,
            until=until,
            timeout=timeout,
            blind_timeout=blind_timeout,
        )

    def register(
        self,
        resource: str,
        access: Access,
        *,
        priority: int = 0,
        hold: float | None = None,
        max_age: float | None = None,
    ) -> Any:
        """Register for a resource at run time.

        Args:
            resource: Its name.
            access: What this behavior wants to do with it.
            priority: With which priority it writes; higher wins.
            hold: For how long a write holds the actuator, in seconds.
            max_age: The greatest age of a reading, in seconds.

        Returns:
            A `SensorPort` or an `ActuatorPort`.

        Raises:
            UnknownNameError: No resource has the name.
            AccessDeniedError: A rule denies it.
        """
        return portal_of(self).call(
            Behavior.register,
            self,
            resource,
            access,
            priority=priority,
            hold=hold,
            max_age=max_age,
        )

    def stop_robot(self, reason: str) -> Stopped:
        """Stop the robot in order, this behavior too; see `Robot.stop`.

        Args:
            reason: Why, for `Robot.stopped` and the log.
        """
        return portal_of(self).call(Behavior.stop_robot, self, reason)
