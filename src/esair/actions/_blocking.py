"""Behaviors whose calls wait."""

# mypy: disable-error-code="override, no-any-return"

from __future__ import annotations

import asyncio
import functools
import inspect
import types
from collections.abc import Awaitable, Callable
from typing import Any, Concatenate, Literal, ParamSpec, TypeVar, cast, overload

from esair import minimal
from esair.actions._behavior import (
    Behavior,
    BlockingBehaviors,
    D,
    Host,
    Mail,
    portal_of,
)
from esair.actions._blocking_ports import (
    BlockingActuatorPort,
    BlockingSensorPort,
    in_loop,
)
from esair.actions._needs import Need, ProfiledAction
from esair.actions._reaction import Reaction
from esair.actions._requests import BlockingRequestPort, RequestPort, Takes
from esair.exceptions import BehaviorUnavailableError
from esair.loop import Owner, Portal
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


_CALLS = {
    name: method
    for name, method in vars(BlockingCalls).items()
    if isinstance(method, types.FunctionType)
}
"""What a plain behavior calls in its thread, and others await."""


def give(
    behavior: Behavior,
    host: Host,
    mail: Mail,
    portal: Portal | None,
    port_of: Callable[[str, Need], Any],
    loop_of: Callable[[str, Takes[Any]], Callable[[], Any]] | None,
) -> None:
    """Give a behavior what it declares; with a portal all of it waits, in its thread.

    Args:
        behavior: Who gets it.
        host: What it asks of its supervisor.
        mail: How it exchanges data with others.
        portal: The way of its thread, if it has one.
        port_of: Makes the port of a need, by its attribute.
        loop_of: Where requests come from, by its attribute; None if it takes none.
    """
    fields = vars(behavior)
    fields["_host"], fields["_mail"] = host, mail
    if portal is not None and not isinstance(behavior, ThreadBehavior):
        for name, method in _CALLS.items():
            fields[name] = types.MethodType(method, behavior)
    for attribute, need in behavior.needs.items():
        fields[attribute] = port_of(attribute, need)
    for attribute, each in (behavior.takes if loop_of else {}).items():
        if loop_of and isinstance(each, Takes) and each.method is None:
            loop = loop_of(attribute, each)
            fields[attribute] = (
                BlockingRequestPort(loop, portal) if portal else RequestPort(loop)
            )


def take_back(action: ProfiledAction, host: Host, portal: Portal | None) -> None:
    """Take a behavior its supervisor, if it has not another one by now."""
    fields = vars(action)
    if fields.get("_host") is not host:
        return
    del fields["_host"], fields["_mail"]
    for name in _CALLS if portal is not None else ():
        fields.pop(name, None)


async def run_as_step(
    behavior: Behavior,
    performer: str,
    portal: Portal | None,
    owner: Owner,
    timeout: float | None,
    is_ready: Callable[[], object],
) -> Any:
    """Set up a behavior that another performs, run it and clean up, in this task.

    Returns:
        What its ``run`` returns.

    Raises:
        BehaviorUnavailableError: It did not end within the time.
        Exception: What it raised.
    """

    async def call(method: Callable[[], Any]) -> Any:
        if inspect.iscoroutinefunction(method):
            return await method()
        found: list[Any] = [None]
        way = portal
        if way is None or way.closed:
            way = Portal(performer, owner)
        await way.run(lambda: found.append(method()))
        return found[-1]

    try:
        async with asyncio.timeout(timeout) as limit:
            await call(behavior.setup)
            is_ready()
            return await call(behavior.run)
    except TimeoutError:
        if timeout is None or not limit.expired():
            raise
        told, state = "come to its end", f"a step of {performer}"
        raise BehaviorUnavailableError(behavior.name, told, timeout, state) from None
    finally:
        await call(behavior.teardown)
