"""Behaviors whose calls wait."""

# mypy: disable-error-code="override, no-any-return"

from __future__ import annotations

import asyncio
import functools
from collections.abc import Awaitable, Callable
from typing import Any, Concatenate, Literal, ParamSpec, TypeVar, cast, overload

from esair import minimal
from esair.actions._behavior import Behavior, BlockingBehaviors, D, portal_of
from esair.actions._blocking_ports import (
    BlockingActuatorPort,
    BlockingSensorPort,
    in_loop,
)
from esair.actions._reaction import Reaction
from esair.messages import Access

R = TypeVar("R")
P = ParamSpec("P")


def waits(
    method: Callable[Concatenate[Behavior, P], Awaitable[R]],
) -> Callable[[Any], Callable[Concatenate[Any, P], R]]:
    """Return a method with the same parameters that waits, in the behavior's thread."""

    @functools.wraps(method)
    def call(self: Behavior, /, *args: P.args, **options: P.kwargs) -> R:
        return portal_of(self).call(in_loop, method, self, *args, **options)

    return lambda _declared: call


class BlockingCalls:
    """What the thread of a behavior calls; parameters and results are those of `Behavior`."""

    @waits(Behavior.put)
    def put(self) -> None: ...

    @waits(Behavior.get)
    def get(self) -> None: ...

    @waits(Behavior.ask)
    def ask(self) -> None: ...

    @waits(Behavior.receive)
    def receive(self) -> None: ...

    @waits(Behavior.receive_from)
    def receive_from(self) -> None: ...

    @overload
    def perform(
        self,
        reaction: Reaction | minimal.Reaction,
        *,
        until: Callable[..., bool] | None = None,
        timeout: float | None = None,
        blind_timeout: float | None = None,
    ) -> bool: ...
    @overload
    def perform(self, reaction: Behavior, *, timeout: float | None = None) -> Any: ...

    def perform(self: Any, reaction: Any, **terms: Any) -> Any:
        """Run a reaction or another behavior as a step; see `Behavior.perform`."""
        return portal_of(self).call(in_loop, Behavior.perform, self, reaction, **terms)

    @waits(Behavior.stop_robot)
    def stop_robot(self) -> None: ...

    def offer(self: Any, data: Any, *, latest: bool = False) -> None:
        """Lay data out for a `get` of others; see `Behavior.offer`."""
        portal_of(self).call(in_loop, Behavior.offer, self, data, latest=latest)

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

    def register(self: Any, resource: str, access: Access, **terms: Any) -> Any:
        """Register for a resource at run time; see `Behavior.register`."""
        return portal_of(self).call(Behavior.register, self, resource, access, **terms)


class ThreadBehavior(BlockingCalls, Behavior):  # type: ignore[misc]  # as it says
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

    def run(self) -> Any:
        """Do the work, in the thread. Unless overridden it waits."""
        portal_of(self).call(asyncio.Event().wait)

    @property
    def supervisor(self) -> BlockingBehaviors:
        """The behaviors of the robot: what they do, and, with a right, to manage them."""
        return cast("BlockingBehaviors", super().supervisor)
