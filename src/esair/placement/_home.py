"""The robot in the hand of a component that lives in a child: host, ports, requests."""

from __future__ import annotations

import asyncio
import contextlib
import contextvars
import inspect
from collections.abc import AsyncGenerator, AsyncIterator, Callable, Iterator
from typing import TYPE_CHECKING, Any

from esair import minimal
from esair.abc import Action
from esair.actions import (
    NOTHING,
    Behavior,
    Need,
    PortTerms,
    Reaction,
    by_name,
    each_of,
    give,
    in_loop,
    ordered,
    run_as_step,
    take_back,
    taken,
)
from esair.connections import DONE, Halting, Stopped
from esair.exceptions import BadValueError
from esair.loop import Budget, Owner, Portal, Stepping, raisable, spawn
from esair.messages import BehaviorStatus
from esair.placement._wire import ASKED, AWAITED, CALLED
from esair.plan import in_use, refuse, used_already

if TYPE_CHECKING:
    from esair.placement._child import Child

scope: contextvars.ContextVar[int] = contextvars.ContextVar("esair_scope", default=0)
"""For which call of the robot the code that runs now works."""

_ACTIONS = (Action, minimal.Reaction)


class Host:
    """What a behavior asks of its supervisor, and how it reaches others."""

    def __init__(self, child: Child, portal: Portal | None, step: str = "") -> None:
        self._child = child
        self._step = step
        self.budget = Budget.of(child.loop)
        self.portal = portal

    def hand(self, *_: object) -> bool:
        return False  # not without a wait

    def take(self, *_: object) -> Any:
        return NOTHING

    async def put(self, receiver: str, data: Any, interval: float) -> None:
        await self._child.call("put", receiver, data, interval)

    async def get(self, sender: str, interval: float) -> Any:
        return await self._child.fetch("get", sender, interval)

    async def receive(self, timeout: float | None) -> tuple[str, Any]:
        return await self._child.fetch("receive", timeout)  # type: ignore[no-any-return]

    def offer(self, data: Any, latest: bool) -> None:
        self._child.wait("offer", data, latest=latest)

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

    async def perform(
        self,
        reaction: Reaction,
        until: Callable[..., bool] | None,
        timeout: float | None,
        blind_timeout: float | None,
    ) -> bool:
        child = self._child
        ends = None if until is None else by_name(until, reaction)
        asked = child.recipe(reaction), ends is not None, timeout, blind_timeout
        outcome = child.call("perform", *asked, step=self._step)
        step = Reacting(child, reaction, ends, str(child.newest))
        child.reacting[child.newest] = step
        try:
            return bool(await outcome)
        except Exception as error:
            raise step.error or error from None
        finally:
            del child.reacting[int(step.number)]

    async def perform_behavior(self, behavior: Behavior, timeout: float | None) -> Any:
        child = self._child
        if in_use(behavior):
            refuse([used_already(behavior)], "")
        portal = None
        if not inspect.iscoroutinefunction(behavior.run):
            portal = Portal(child.name, child.owner)
        over = child.call("step", child.recipe(behavior), timeout, step=self._step)
        number, granted = child.newest, child.loop.create_future()
        child.told_of(number, granted.set_result)
        try:
            await asyncio.wait({over, granted}, return_when=asyncio.FIRST_COMPLETED)
        except asyncio.CancelledError:
            over.cancel()
            raise
        if over.done():
            return over.result()
        host = fill(child, behavior, portal, str(number))
        try:
            return await run_as_step(
                *(behavior, child.name, portal, child.owner, timeout),
                lambda: child.wait("stage", number),
            )
        finally:
            take_back(behavior, host, portal)
            with contextlib.suppress(Exception):  # the behavior's own is told
                child.note("stage", number)
                child.note("stage", number)
                await over
            over.cancel()

    async def register(self, terms: PortTerms) -> Any:
        resource, access, _, priority, hold, max_age = terms
        key = await self._child.call(
            *("register", self._step, resource, access),
            priority=priority,
            hold=hold,
            max_age=max_age,
        )
        return port_for(self._child, key, resource, self.portal)

    def halt_robot(self, reason: str) -> Halting:
        child, halting = self._child, Halting()
        child.wait("halt", reason)

        async def hear() -> None:
            halting.settle(await child.call("halted"))

        def begin() -> None:
            spawn(child.loop, hear(), name="halted", owner=child.owner)

        child.loop.call_soon_threadsafe(begin)
        return halting

    async def stop_robot(self, reason: str) -> Stopped:
        return Stopped(*await self._child.call("stop", reason))

    def query(self, name: str) -> BehaviorStatus:
        return self._child.wait("query", name)  # type: ignore[no-any-return]

    async def manage(self, verb: str, *args: Any) -> Any:
        told = (
            self._child.recipe(each) if isinstance(each, _ACTIONS) else each
            for each in args
        )
        return await self._child.call("manage", verb, *told)


def fill(
    child: Child, behavior: Behavior, portal: Portal | None, step: str = ""
) -> Host:
    """Give a behavior what it declares: it, or a step that it performs."""
    host = Host(child, portal, step)

    def port_of(attribute: str, need: Need) -> Any:
        return port_for(child, f"{step}:{attribute}", need.resource, portal)

    def loop_of(attribute: str, _: Any) -> Callable[[], Loop]:
        return lambda: Loop(child, attribute)

    give(behavior, host, host, portal, port_of, loop_of)
    return host


class Reacting:
    """A reaction that decides here, when it is asked: it, or a step of a behavior.

    Attributes:
        error: What it has raised.
    """

    def __init__(
        self,
        child: Child,
        reaction: Reaction,
        until: Callable[[dict[str, Any]], bool] | None = None,
        number: str = "",
    ) -> None:
        for attribute, need in reaction.needs.items():
            key = f"{number}:{attribute}"
            vars(reaction)[attribute] = port_for(child, key, need.resource, None)
        self.number = number
        self.error: BaseException | None = None
        self._told = {reaction, getattr(reaction, "reaction", reaction)}
        self._names, self._react = ordered(reaction)
        self._until = until
        self._stepping = Stepping.of(child.loop)
        self.owner: Owner = child.owner

    def decide(self, values: list[Any], now_ms: int, elapsed_ms: int) -> Any:
        """Make a step; returns what it decides, and of a step whether it was the last."""
        for each in self._told:
            each.now_ms, each.elapsed_ms = now_ms, elapsed_ms
        self._stepping.runner = self  # whose random numbers it draws
        try:
            decided = self._react(*values)
            if not self.number:
                return decided
            read = dict(zip(self._names, values, strict=True))
            return decided, self._until is not None and bool(self._until(read))
        except BaseException as error:
            self.error = error
            raise raisable(error, "the reaction") from error
        finally:
            self._stepping.runner = None


def port_for(child: Child, key: str, resource: str, portal: Portal | None) -> Any:
    """Return the way to a device: to that of its registration, in the robot."""
    port = RemotePort(child, key, resource)
    return port if portal is None else BlockingPort(port, portal)


class RemotePort:
    """A `SensorPort` or an `ActuatorPort` of the robot, with the same methods."""

    def __init__(self, child: Child, key: str, resource: str) -> None:
        self._child = child
        self._key = key
        self.resource = resource

    def __aiter__(self) -> AsyncIterator[Any]:
        return self._values()

    async def _values(self) -> AsyncGenerator[Any, None]:
        child = self._child
        try:
            number, value = await child.call("values", self._key)
            try:
                while True:
                    yield value
                    value = await child.call("next", number)
            finally:
                child.note("left", number)
        except BadValueError as error:
            raise _of(self.resource, error) from None


def _of(resource: str, error: BadValueError) -> BadValueError:
    """Let an error that an answer does not fit say whose answer it is."""
    if error.field != "answer":
        return error
    told = str(error).partition(" answer: ")[2]
    return BadValueError(error.component, resource, told)


def _awaited(name: str) -> Any:
    async def call(self: RemotePort, *args: Any, **options: Any) -> Any:
        try:
            return await self._child.call(f"{name} {self._key}", *args, **options)
        except BadValueError as error:
            raise _of(self.resource, error) from None

    return call


def _called(name: str) -> Any:
    def call(self: RemotePort, *args: Any) -> Any:
        found = self._child.wait("peek", self._key, name, *args)
        return DONE if name == "release" else found

    return call


for _names, _made in ((AWAITED, _awaited), (CALLED, _called)):
    for _name in _names:
        setattr(RemotePort, _name, _made(_name))
for _name in ASKED:
    setattr(RemotePort, _name, property(_called(_name)))


class BlockingPort:
    """The same port for the thread of a plain behavior."""

    def __init__(self, port: RemotePort, portal: Portal) -> None:
        self._port = port
        self._portal = portal

    def __getattr__(self, name: str) -> Any:
        port, call = self._port, self._portal.call
        if name in AWAITED | CALLED:
            return lambda *args, **options: call(
                in_loop, lambda: getattr(port, name)(*args, **options)
            )
        return call(in_loop, getattr, port, name)

    def __iter__(self) -> Iterator[Any]:
        return each_of(self._port._values(), self._portal)  # noqa: SLF001 - as the port


class Loop(AsyncIterator[Any]):
    """One loop of a behavior over the requests that it takes."""

    def __init__(self, child: Child, attribute: str) -> None:
        self._child = child
        self._attribute = attribute
        # What the robot keeps for a loop goes to the next one: some begin one each second.
        self._number = child.free.pop() if child.free else next(child.numbers)
        self._is_begun = False

    def __del__(self) -> None:
        self._child.free.append(self._number)

    async def __anext__(self) -> Any:
        """Wait for the next request."""
        child = self._child
        if not self._is_begun:
            self._is_begun = True
            await child.call("loop", self._number, self._attribute)
        number, data, sender = await child.fetch("next_order", self._number)
        order = Order(child, number, data, sender, self._number)
        order.serve()
        return order.handle


class Order:
    """One request on its way from its asker, in the robot, to its one outcome."""

    def __init__(
        self,
        child: Child,
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
        return bool(self._child.wait("order", self._number, "cancelled"))

    def answer(self, value: Any) -> bool:
        return bool(self._child.wait("order", self._number, "answer", value))

    def refuse(self, reason: str) -> bool:
        return bool(self._child.wait("order", self._number, "refuse", reason))

    def progress(self, value: Any) -> bool:
        return bool(self._child.wait("order", self._number, "progress", value))

    def enter(self) -> None:
        """Somebody begins to work on it, in a block of its own."""
        if asyncio._get_running_loop() is not None:  # noqa: SLF001 - it does not raise
            self._worker = asyncio.current_task()
            assert self._worker is not None
            self._before = self._worker.cancelling()
            self._child.orders[self._number] = self._withdrawn
        self._child.wait("enter", self._number)

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
        told = None if error is None else self._child.pack_error(error)
        self._child.wait("leave", self._number, told)
        return mine

    def _withdrawn(self) -> None:
        if self._worker is not None and not self._cancels:
            self._cancels = True
            self._worker.cancel()
