"""What a member asks of the deployment that it belongs to."""

from __future__ import annotations

import asyncio
import contextvars
from collections.abc import Awaitable, Callable
from typing import Any, Protocol

from esair.connections import Halting, Stopped
from esair.journal import Journal
from esair.messages import BehaviorStatus
from esair.plan import Plan
from esair.supervisors._mediator import Mediator
from esair.supervisors._resource_deployment import ResourceDeployment


class Crew(Protocol):
    """All behaviors and reactions of a robot, as one of them sees them."""

    resources: ResourceDeployment
    journal: Journal
    context: contextvars.Context | None
    may_begin: asyncio.Event
    coming: list[Any]
    mediator: Mediator
    halt_robot: Callable[[str, str], Halting]
    stop_robot: Callable[[str], Awaitable[Stopped]]

    def query(self, name: str) -> BehaviorStatus: ...
    async def managed_by(self, name: str, verb: str, *args: Any) -> Any: ...
    def ended(self) -> None: ...
    def plan(self) -> Plan: ...
