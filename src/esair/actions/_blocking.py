"""Behaviors whose calls wait. Written by tools/make_blocking.py."""

# What a thread calls waits where its base is awaited: that is the idea of it.
# mypy: disable-error-code="override, no-any-return"

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, TypeVar, cast, overload

from esair import minimal
from esair.actions._behavior import Behavior, D, portal_of
from esair.actions._blocking_ports import (
    BlockingActuatorPort,
    BlockingSensorPort,
    forever,
    in_loop,
)
from esair.actions._reaction import Reaction
from esair.actions._request import Request
from esair.actions._supervisor import BlockingBehaviors
from esair.connections import Stopped
from esair.messages import Access

A = TypeVar("A")


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
        """Hand data to another behavior, through the behavior supervisor. See `Behavior.put`."""
        portal_of(self).call(Behavior.put, self, receiver, data, interval)

    def get(
        self, sender: str, interval: float = 1.0, *, as_type: type[D] | None = None
    ) -> D:
        """Ask another behavior for data, through the behavior supervisor. See `Behavior.get`."""
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
        """Ask another behavior to do something, and wait for its answer. See `Behavior.ask`."""
        return portal_of(self).call(
            Behavior.ask, self, receiver, request, timeout=timeout, progress=progress
        )

    def receive(
        self, *, timeout: float | None = None, as_type: type[D] | None = None
    ) -> D:
        """Wait for data that another behavior has put, and take it. See `Behavior.receive`."""
        return portal_of(self).call(
            Behavior.receive, self, timeout=timeout, as_type=as_type
        )

    def receive_from(
        self, *, timeout: float | None = None, as_type: type[D] | None = None
    ) -> tuple[str, D]:
        """Wait for data as `receive` does. See `Behavior.receive_from`."""
        return portal_of(self).call(
            Behavior.receive_from, self, timeout=timeout, as_type=as_type
        )

    def offer(self, data: Any, *, latest: bool = False) -> None:
        """Lay data out for a `get` of others; each piece goes to one of them.

        See `Behavior.offer`.
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
        """Run a reaction as a step of this behavior. See `Behavior.perform`."""
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
        as_type: type[D] | None = None,
        max_age: float | None = None,
    ) -> BlockingSensorPort[D]: ...
    @overload
    def register(
        self,
        resource: str,
        access: Literal[Access.WRITE],
        *,
        as_type: type[D] | None = None,
        priority: int = 0,
        hold: float | None = None,
    ) -> BlockingActuatorPort[D]: ...
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
        """Register for a resource at run time. See `Behavior.register`."""
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

        See `Behavior.stop_robot`.
        """
        return portal_of(self).call(Behavior.stop_robot, self, reason)
