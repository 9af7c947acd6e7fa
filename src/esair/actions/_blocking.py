"""Behaviors whose calls wait. Written by tools/make_blocking.py."""

# What a thread calls waits where its base is awaited: that is the idea of it.
# mypy: disable-error-code="override, no-any-return"

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, TypeVar, cast, overload

from esair import minimal
from esair.actions._behavior import Behavior, portal_of
from esair.actions._blocking_ports import BlockingActuatorPort, BlockingSensorPort
from esair.actions._reaction import Reaction
from esair.actions._request import Request
from esair.actions._supervisor import BlockingBehaviors
from esair.actions._waiting import forever, in_loop
from esair.connections import Stopped
from esair.messages import Access

A = TypeVar("A")
T = TypeVar("T")


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

    @overload
    def get(self, sender: str, interval: float = 1.0) -> Any: ...
    @overload
    def get(self, sender: str, interval: float = 1.0, *, as_type: type[T]) -> T: ...

    def get(
        self, sender: str, interval: float = 1.0, *, as_type: type[Any] | None = None
    ) -> Any:
        """Ask another behavior for data, through the behavior supervisor.

        The other answers with what it has offered, or by its ``provide``.

        Args:
            sender: The name of the other behavior.
            interval: How long to keep asking, in seconds.
            as_type: What is expected; for type checkers, and checked when it comes.

        Raises:
            BadValueError: The other has given something else.
            UnknownNameError: No behavior has the name.
            BehaviorUnavailableError: It could not send for the interval.
            CircularRequestError: It waits for this behavior's answer.
            BehaviorRemovedError: It was removed meanwhile.
            BehaviorFailedError: It crashed meanwhile, or its ``provide`` did.
            BusyError: Too many requests wait.
        """
        return portal_of(self).call(
            Behavior.get, self, sender, interval, as_type=as_type
        )

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

    @overload
    def receive(self, *, timeout: float | None = None) -> Any: ...
    @overload
    def receive(self, *, timeout: float | None = None, as_type: type[T]) -> T: ...

    def receive(
        self, *, timeout: float | None = None, as_type: type[Any] | None = None
    ) -> Any:
        """Wait for data that another behavior has put, and take it.

        Args:
            timeout: How long to wait, in seconds; None for no limit.
            as_type: What is expected; for type checkers, and checked when it comes.

        Raises:
            TimeoutError: There was none in time; what comes later waits.
            BadValueError: It is something else; it is taken all the same.
        """
        return portal_of(self).call(
            Behavior.receive, self, timeout=timeout, as_type=as_type
        )

    @overload
    def receive_from(self, *, timeout: float | None = None) -> tuple[str, Any]: ...
    @overload
    def receive_from(
        self, *, timeout: float | None = None, as_type: type[T]
    ) -> tuple[str, T]: ...

    def receive_from(
        self, *, timeout: float | None = None, as_type: type[Any] | None = None
    ) -> tuple[str, Any]:
        """Wait for data as `receive` does.

        Args:
            timeout: How long to wait, in seconds; None for no limit.
            as_type: What is expected; for type checkers, and checked when it comes.

        Returns:
            Who has put it, and the data.

        Raises:
            TimeoutError: There was none in time; what comes later waits.
            BadValueError: It is something else; it is taken all the same.
        """
        return portal_of(self).call(
            Behavior.receive_from, self, timeout=timeout, as_type=as_type
        )

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

    @overload
    def register(
        self,
        resource: str,
        access: Literal[Access.READ],
        *,
        max_age: float | None = None,
    ) -> BlockingSensorPort[Any]: ...
    @overload
    def register(
        self,
        resource: str,
        access: Literal[Access.READ],
        *,
        as_type: type[T],
        max_age: float | None = None,
    ) -> BlockingSensorPort[T]: ...
    @overload
    def register(
        self,
        resource: str,
        access: Literal[Access.WRITE],
        *,
        priority: int = 0,
        hold: float | None = None,
    ) -> BlockingActuatorPort[Any]: ...
    @overload
    def register(
        self,
        resource: str,
        access: Literal[Access.WRITE],
        *,
        as_type: type[T],
        priority: int = 0,
        hold: float | None = None,
    ) -> BlockingActuatorPort[T]: ...
    @overload
    def register(
        self,
        resource: str,
        access: Access,
        *,
        as_type: type[Any] | None = None,
        priority: int = 0,
        hold: float | None = None,
        max_age: float | None = None,
    ) -> Any: ...

    def register(
        self,
        resource: str,
        access: Access,
        *,
        as_type: type[Any] | None = None,
        priority: int = 0,
        hold: float | None = None,
        max_age: float | None = None,
    ) -> Any:
        """Register for a resource at run time.

        Args:
            resource: Its name.
            access: What this behavior wants to do with it.
            as_type: The type of its readings or commands, as in `esair.reads`.
            priority: With which priority it writes; higher wins.
            hold: For how long a write holds the actuator, in seconds.
            max_age: The greatest age of a reading, in seconds.

        Returns:
            A `SensorPort` or an `ActuatorPort`.

        Raises:
            UnknownNameError: No resource has the name.
            AccessDeniedError: A rule denies it.
            ConfigError: It gives or takes something else.
        """
        return portal_of(self).call(
            Behavior.register,
            self,
            resource,
            access,
            as_type=as_type,
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
