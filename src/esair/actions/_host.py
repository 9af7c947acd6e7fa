"""What a running behavior asks of its supervisor, and how it reaches others."""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from typing import Any, NamedTuple, Protocol

from esair.actions._reaction import Reaction
from esair.connections import ActuatorPort, Halting, SensorPort, Stopped
from esair.loop import Budget, Portal
from esair.messages import Access, BehaviorStatus


class Terms(NamedTuple):
    """For what a behavior registers at run time; see `Behavior.register`."""

    resource: str
    access: Access
    as_type: type[Any] | None
    priority: int
    hold: float | None
    max_age: float | None


class Mail(Protocol):
    """How a running behavior exchanges data with others."""

    budget: Budget

    def hand(self, receiver: str, data: Any, interval: float) -> bool: ...
    def put(
        self, receiver: str, data: Any, interval: float
    ) -> Coroutine[Any, Any, None]: ...
    def take(self, sender: str, interval: float) -> Any: ...
    def get(self, sender: str, interval: float) -> Coroutine[Any, Any, Any]: ...
    async def receive(self, timeout: float | None) -> tuple[str, Any]: ...
    def ask(
        self,
        receiver: str,
        request: Any,
        timeout: float | None,
        progress: Callable[[Any], object] | None,
    ) -> Coroutine[Any, Any, Any]: ...
    def offer(self, data: Any, latest: bool) -> None: ...


class Host(Protocol):
    """What a running behavior asks of its supervisor."""

    @property
    def portal(self) -> Portal | None: ...
    async def perform(
        self,
        reaction: Reaction,
        until: Callable[..., bool] | None,
        timeout: float | None,
        blind_timeout: float | None,
    ) -> bool: ...
    async def perform_behavior(self, behavior: Any, timeout: float | None) -> Any: ...
    async def register(self, terms: Terms) -> SensorPort[Any] | ActuatorPort[Any]: ...
    def halt_robot(self, reason: str) -> Halting: ...
    def query(self, name: str) -> BehaviorStatus: ...
    async def manage(self, verb: str, *args: Any) -> Any: ...
    async def stop_robot(self, reason: str) -> Stopped: ...
