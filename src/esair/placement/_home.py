"""The robot in the hand of a component that lives in a child: host, ports, requests."""

from __future__ import annotations

import asyncio
import contextvars
import inspect
from collections.abc import AsyncGenerator, AsyncIterator, Callable, Generator, Iterator
from typing import Any, Protocol

from esair.actions import NOTHING, PortTerms, each_of, in_loop, taken
from esair.connections import Halting, Stopped
from esair.loop import Budget, Owner, Portal, spawn
from esair.messages import BehaviorStatus
from esair.placement._loop import ChildLoop
from esair.placement._wire import Values

scope: contextvars.ContextVar[int] = contextvars.ContextVar("esair_scope", default=0)
"""For which call of the robot the code that runs now works."""

_AWAITED = {"read", "reading", "write", "configure", "operate"}
_CALLED = {"history", "why", "release"}
_ASKED = {"newest", "settings", "state", "max_age"}


class Line(Protocol):
    """The way of a component to its robot: the process that it is in."""

    loop: ChildLoop
    values: Values
    portal: Portal | None
    orders: dict[int, Callable[[], object]]

    @property
    def name(self) -> str: ...
    @property
    def owner(self) -> Owner | None: ...
    @property
    def newest(self) -> int: ...
    def call(self, verb: str, *args: Any, **options: Any) -> asyncio.Future[Any]: ...
    def ask(self, verb: str, *args: Any, **options: Any) -> Any: ...
    def note(self, verb: str, *args: Any) -> None: ...
    def told_of(self, number: int, hear: Callable[[Any], object]) -> None: ...


class Host:
    """What a behavior asks of its supervisor, and how it reaches others."""

    def __init__(self, child: Line) -> None:
        self._child = child
        self.budget = Budget.of(child.loop)
        self.portal = child.portal
        self._ports = 0

    def hand(self, *_: object) -> bool:
        return False  # not without a wait

    def take(self, *_: object) -> Any:
        return NOTHING

    async def put(self, receiver: str, data: Any, interval: float) -> None:
        await self._child.call("put", receiver, data, interval)

    async def get(self, sender: str, interval: float) -> Any:
        return await self._child.call("get", sender, interval)

    async def receive(self, timeout: float | None) -> tuple[str, Any]:
        sender, data = await self._child.call("receive", timeout)
        return sender, data

    def offer(self, data: Any, latest: bool) -> None:
        self._child.ask("offer", data, latest=latest)

    async def ask(
        self,
        receiver: str,
        request: Any,
        timeout: float | None,
        progress: Callable[[Any], object] | None,
    ) -> Any:
        child = self._child
        outcome = child.call("ask", receiver, request, timeout, progress is not None)
        if progress is not None:
            child.told_of(child.newest, lambda news: self._progress(progress, news))
        return await outcome

    def _progress(self, progress: Callable[[Any], object], news: Any) -> None:
        told = progress(news)
        if inspect.iscoroutine(told):
            spawn(self._child.loop, told, name="progress", owner=self._child.owner)

    async def perform(self, *_: object) -> bool:
        raise NotImplementedError(
            f"{self._child.name} performs a step, but lives in a process of its own: "
            "make the step a component, or leave the behavior in the robot's process"
        )

    perform_behavior = perform

    async def register(self, terms: PortTerms) -> Any:
        resource, access, _, priority, hold, max_age = terms
        asked = resource, access, priority, hold, max_age
        key = await self._child.call("register", *asked)
        return port_for(self._child, key, resource, self.portal)

    def halt_robot(self, reason: str) -> Halting:
        child, halting = self._child, Halting()
        child.ask("halt", reason)

        async def hear() -> None:
            halting.settle(await child.call("halted"))

        def begin() -> None:
            spawn(child.loop, hear(), name="halted", owner=child.owner)

        child.loop.call_soon_threadsafe(begin)
        return halting

    async def stop_robot(self, reason: str) -> Stopped:
        return Stopped(*await self._child.call("stop", reason))

    def query(self, name: str) -> BehaviorStatus:
        return self._child.ask("query", name)  # type: ignore[no-any-return]

    async def manage(self, verb: str, *args: Any) -> Any:
        return await self._child.call("manage", verb, *args)


def port_for(child: Line, key: str, resource: str, portal: Portal | None) -> Any:
    """Return the way to a device: to that of its registration, in the robot."""
    port = RemotePort(child, key, resource)
    return port if portal is None else BlockingPort(port, portal)


class RemotePort:
    """A `SensorPort` or an `ActuatorPort` of the robot, with the same methods."""

    def __init__(self, child: Line, key: str, resource: str) -> None:
        self._child = child
        self._key = key
        self.resource = resource

    def __getattr__(self, name: str) -> Any:
        child, key = self._child, self._key
        if name in _AWAITED:

            async def wait(*args: Any, **options: Any) -> Any:
                return await child.call("port", key, name, *args, **options)

            return wait
        if name == "release":

            def release() -> Done:
                child.ask("peek", key, name)
                return Done()

            return release
        if name in _CALLED:
            return lambda *args: child.ask("peek", key, name, *args)
        if name in _ASKED:
            return child.ask("peek", key, name)
        raise AttributeError(name)

    def __aiter__(self) -> AsyncIterator[Any]:
        return self._values()

    async def _values(self) -> AsyncGenerator[Any, None]:
        child = self._child
        number = await child.call("values", self._key)
        try:
            while True:
                yield await child.call("next", number)
        finally:
            child.note("left", number)


class Done:
    """What is over: awaiting it only counts."""

    def __await__(self) -> Generator[Any, None, None]:
        return Budget.spend().__await__()


class BlockingPort:
    """The same port for the thread of a plain behavior."""

    def __init__(self, port: RemotePort, portal: Portal) -> None:
        self._port = port
        self._portal = portal

    def __getattr__(self, name: str) -> Any:
        if name in _AWAITED | _CALLED:
            return lambda *args, **options: self._portal.call(
                in_loop, _named, self._port, name, *args, **options
            )
        return self._portal.call(in_loop, getattr, self._port, name)

    def __iter__(self) -> Iterator[Any]:
        return each_of(self._port._values(), self._portal)  # noqa: SLF001 - as the port


def _named(port: RemotePort, name: str, *args: Any, **options: Any) -> Any:
    return getattr(port, name)(*args, **options)


class Orders:
    """Where a port gets the requests that wait for its behavior."""

    def __init__(self, child: Line, attribute: str) -> None:
        self._child = child
        self._attribute = attribute

    def loop(self) -> Loop:
        return Loop(self._child, self._attribute)


class Loop(AsyncIterator[Any]):
    """One loop of a behavior over the requests that it takes."""

    def __init__(self, child: Line, attribute: str) -> None:
        self._child = child
        self._attribute = attribute
        self._number: int | None = None

    async def __anext__(self) -> Any:
        """Wait for the next request."""
        child = self._child
        if self._number is None:
            self._number = await child.call("loop", self._attribute)
        number, data, sender = await child.call("next order", self._number)
        order = Order(child, number, data, sender, self._number)
        order.serve()
        return order.handle


class Order:
    """One request on its way from its asker, in the robot, to its one outcome."""

    def __init__(
        self,
        child: Line,
        number: int,
        data: Any,
        sender: str,
        loop: int = 0,
    ) -> None:
        self._child = child
        self._number = number
        self._loop = loop  # the number of the loop in which it was taken
        self.data, self.sender = data, sender
        self.handle = taken(data, self)  # type: ignore[arg-type]  # asked for, not set
        self._before = 0
        self._worker: asyncio.Task[Any] | None = None
        self._cancels = False

    @property
    def cancelled(self) -> bool:
        return bool(self._child.ask("order", self._number, "cancelled"))

    def answer(self, value: Any) -> bool:
        return bool(self._child.ask("order", self._number, "answer", value))

    def refuse(self, reason: str) -> bool:
        return bool(self._child.ask("order", self._number, "refuse", reason))

    def progress(self, value: Any) -> bool:
        return bool(self._child.ask("order", self._number, "progress", value))

    def enter(self) -> None:
        """Somebody begins to work on it, in a block of its own."""
        if asyncio._get_running_loop() is not None:  # noqa: SLF001 - it does not raise
            self._worker = asyncio.current_task()
            assert self._worker is not None
            self._before = self._worker.cancelling()
            self._child.orders[self._number] = self._withdrawn
        self._child.ask("enter", self._number)

    def serve(self) -> None:
        """What is done here from now on is done for it."""
        scope.set(self._loop)

    def leave(self, error: BaseException | None) -> bool:
        """The block is left; tells whether its error ends here."""
        self._child.orders.pop(self._number, None)
        worker, self._worker = self._worker, None
        mine = False
        if self._cancels and worker is not None:
            undone = worker.uncancel() <= self._before
            mine = undone and isinstance(error, asyncio.CancelledError)
        told = None if error is None else self._child.values.pack_error(error)
        self._child.ask("leave", self._number, told)
        return mine

    def _withdrawn(self) -> None:
        if self._worker is not None and not self._cancels:
            self._cancels = True
            self._worker.cancel()
