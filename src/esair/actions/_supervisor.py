"""The behavior supervisor in a behavior's hand."""

from __future__ import annotations

from typing import Any, Protocol

from esair.abc import Action
from esair.actions._blocking_ports import Waits, calls, waits
from esair.messages import BehaviorStatus


class Managed(Protocol):
    """What a running behavior asks of its supervisor about others."""

    def query(self, name: str) -> BehaviorStatus: ...
    async def manage(self, verb: str, *args: Any) -> Any: ...


class Behaviors:
    """The behaviors of the robot, for one of them.

    It may always `query`. The rest takes a right from the developer:
    ``Policy.behaviors(allow={"captain": "manage"})``; each raises `AccessDeniedError`
    without it, and else does and raises what the `BehaviorSupervisor` does.
    """

    def __init__(self, host: Managed) -> None:
        self._host = host

    def query(self, name: str) -> BehaviorStatus:
        """Tell what a behavior is doing. Answers at any time, without a wait.

        Raises:
            UnknownNameError: No behavior has the name.
        """
        return self._host.query(name)

    async def add(self, behavior: Action) -> None:
        """Deploy a behavior or reaction; see `BehaviorSupervisor.add`."""
        await self._host.manage("add", behavior)

    async def remove(self, name: str) -> list[Any]:
        """Take a behavior away; see `BehaviorSupervisor.remove`."""
        return await self._host.manage("remove", name)  # type: ignore[no-any-return]

    async def replace(self, name: str, behavior: Action) -> list[Any]:
        """Put another in the place of one; see `BehaviorSupervisor.replace`."""
        return await self._host.manage("replace", name, behavior)  # type: ignore[no-any-return]

    async def restart(self, name: str) -> None:
        """End the run of a behavior and begin another; see `BehaviorSupervisor.restart`."""
        await self._host.manage("restart", name)

    async def switch(self, mode: str, reason: str = "") -> None:
        """Go to another mode; see `BehaviorSupervisor.switch`."""
        await self._host.manage("switch", mode, reason)


class BlockingBehaviors(Waits):
    """`Behaviors` for a behavior with a plain ``run``: the thread waits."""

    __slots__ = ()

    query = calls(Behaviors.query)
    add = waits(Behaviors.add)
    remove = waits(Behaviors.remove)
    replace = waits(Behaviors.replace)
    restart = waits(Behaviors.restart)
    switch = waits(Behaviors.switch)


class HasThread(Protocol):
    """A behavior whose calls wait, in a thread of its own: a `ThreadBehavior`."""

    @property
    def supervisor(self) -> BlockingBehaviors: ...
