"""The place of one component in its robot, while its code runs in a child.

The component itself stays where it is, with its ports, its rights and its mail; its
methods go to the child while it sits there. What the child asks for is done here, by the
component's own ports, in tasks of its own: so every rule of the robot holds for it.
"""

from __future__ import annotations

import asyncio
import contextvars
import logging
import sys
from collections.abc import Callable, Coroutine, Iterable, Mapping
from typing import Any, Final, Protocol

from esair.actions import Behavior, Reaction, Takes
from esair.codec import kinds_of
from esair.exceptions import ProcessDiedError
from esair.loop import Owner, outside, spawn, turn_of
from esair.messages import Placement, placement_of
from esair.placement._kinds import ALWAYS, plain_result
from esair.placement._nursery import Nursery
from esair.placement._process import End, Process
from esair.placement._verbs import (
    Asked,
    BehaviorVerbs,
    PortVerbs,
    SensorVerbs,
    StepSeat,
)
from esair.placement._wire import CALLS, Item, Values
from esair.plan import recipe_of
from esair.resources import Resource

_NOBODY: Final = contextvars.Context()


__all__ = ["Seat", "Seats", "StepSeat"]


class Verbs(Protocol):
    """What a child may ask for: what is done at once, and what is waited for."""

    @property
    def plain(self) -> Mapping[str, Callable[..., Any]]: ...
    @property
    def waits(self) -> Mapping[str, Callable[..., Any]]: ...


class Seats:
    """The places of one robot's components that live in children.

    Args:
        components: Returns the components of the robot; their classes may cross.
        seed: What the random numbers of its components begin with.
        command_timeout: Returns that of an actuator, by its name.
    """

    def __init__(
        self,
        components: Callable[[], Iterable[Any]],
        seed: object,
        command_timeout: Callable[[str], float | None],
    ) -> None:
        self.kinds = kinds_of(components, ALWAYS)
        self.seed = seed
        self.command_timeout = command_timeout
        self.nursery: Nursery = Nursery.hold()
        self._taken: dict[Seat, None] = {}

    async def ready(self) -> None:
        """Wait until children can be made."""

        async def wait() -> None:
            loop = asyncio.get_running_loop()
            await loop.run_in_executor(None, self.nursery.wait)

        await outside(("placement", "ready"), wait)

    def seat(self, component: Any) -> Seat:
        """Return the place of a component."""
        placement = placement_of(component.placement)
        assert placement is not None
        seat = Seat(component, placement, self)
        self._taken[seat] = None
        return seat

    def close(self) -> None:
        """End what is left of the children."""
        for seat in tuple(self._taken):
            seat.rise()
        self.nursery.let_go()

    def left(self, seat: Seat) -> None:
        self._taken.pop(seat, None)


class Seat:
    """The place of one component, and the process that it has now, if any."""

    def __init__(self, component: Any, placement: Placement, seats: Seats) -> None:
        self.component = component
        self.placement = placement
        self.name: str = component.name
        self.process: Process | None = None
        self._recipe = recipe_of(component)  # now: later it knows its robot
        self.lost: int = 0
        """How many of its processes have died."""
        self._seats = seats
        self._values = Values(self.name, seats.kinds)
        self._owner: Owner | None = None
        self._tasks: dict[int, asyncio.Task[None]] = {}
        self._before: dict[str, Any] = {}
        self._on_death: Callable[[ProcessDiedError], object] | None = None
        self._verbs: Verbs

    @property
    def loop(self) -> asyncio.AbstractEventLoop:
        """The robot's."""
        return asyncio.get_running_loop()

    @property
    def pid(self) -> int | None:
        return None if self.process is None else self.process.pid

    def sit(self, owner: Owner | None = None) -> None:
        """Let the component's methods go to a child, which begins with the first."""
        self.end()
        self._owner = owner
        component = self.component
        if isinstance(component, Behavior):
            methods = ["run", *(["provide"] if component.provides else [])]
            given = {"setup": self._first("setup"), "teardown": self._last("teardown")}
            given |= {name: self._method(name) for name in methods}
            for attribute, each in component.takes.items():
                if isinstance(each, Takes) and each.method is not None:
                    given[attribute] = self._answers(attribute)
        elif isinstance(component, Reaction):
            given = {}
        else:
            given = self._methods_of_driver(component)
        fields = vars(component)
        for name, method in given.items():
            self._before.setdefault(name, fields.get(name))
            fields[name] = method

    def rise(self) -> None:
        """Have the component as it was, and its process ended."""
        self.end()
        for name, before in self._before.items():
            vars(self.component).pop(name, None)
            if before is not None:
                vars(self.component)[name] = before
        self._before.clear()
        self._seats.left(self)

    def end(self) -> None:
        """End its process, if there is one, without a wait."""
        process, self.process = self.process, None
        if process is not None:
            process.close()
        for task in tuple(self._tasks.values()):
            task.cancel()
        self._tasks.clear()

    def begin(
        self, on_death: Callable[[ProcessDiedError], object] | None = None
    ) -> None:
        """Begin a process with the component as it was added."""
        self.end()
        self._on_death = on_death
        component, loop = self.component, asyncio.get_running_loop()
        if isinstance(component, Behavior):
            self._verbs = BehaviorVerbs(self, component)
        elif isinstance(component, Reaction):
            self._verbs = PortVerbs(self, component)
        else:
            self._verbs = SensorVerbs(component)
        process = self.process = Process(
            self._values,
            self.placement,
            self._seats.nursery,
            repeats=isinstance(component, Behavior | Reaction),
            serve=self._serve,
            withdraw=self._withdraw,
            died=self._died,
        )
        settled = {
            "path": list(sys.path),
            "name": self.name,
            "stream": f"{self._seats.seed}/{self.name}"
            + ("" if not self.lost else f"/{self.lost}"),
            "stall": self.placement.stall if turn_of(loop).virtual else None,
            "memory": self.placement.memory,
            "nice": self.placement.nice,
            "level": logging.getLogger().getEffectiveLevel(),
        }
        process.call("settle", (settled,), self._settled)
        process.call("make", (self._recipe,), self._settled)

    def _settled(self, _value: Any, error: BaseException | None) -> None:
        """What could not be made answers every call with why."""
        if error is not None and self.process is not None:
            self.process.refuse(error)

    def decide(self, step: tuple[Any, ...], end: End, number: int = 0) -> None:
        """Have a reaction decide in the child; its decision comes to a function."""
        assert self.process is not None
        self.process.call("react", (number, *step), end)

    # What its verbs need (`Chair`).

    def reply(self, op: str, number: int, value: Any) -> None:
        """Tell the child something about a call or a request."""
        process = self.process
        if process is not None:
            process.tell(Item(op, number, "", self._values.pack(op, value)))

    def spawn(self, coroutine: Coroutine[Any, Any, None], name: str) -> object:
        """Do something in the name of the component."""
        loop, called = asyncio.get_running_loop(), f"{self.name} {name}"
        return spawn(loop, coroutine, name=called, owner=self._owner)

    def keep_scope(self) -> int:
        """Keep for whom the code that runs now works; return its number."""
        assert self.process is not None
        number = -1 - len(self.process.scopes)
        self.process.scopes[number] = contextvars.copy_context()
        return number

    def unpack_error(self, data: bytes) -> BaseException:
        return self._values.unpack_error(data)

    def command_timeout(self, resource: str) -> float | None:
        return self._seats.command_timeout(resource)

    # Its methods.

    def _method(self, name: str) -> Callable[..., Any]:
        async def method(*args: Any, **options: Any) -> Any:
            if self.process is None:
                raise ProcessDiedError(self.name, "is not there")
            return await self.process.run(name, *args, **options)

        return method

    def _first(self, name: str) -> Callable[..., Any]:
        async def method() -> Any:
            self.begin(self._on_death)
            assert self.process is not None
            return await self.process.run(name)

        return method

    def _last(self, name: str) -> Callable[..., Any]:
        async def method() -> None:
            process = self.process
            try:
                if process is not None and process.is_well:
                    await process.run(name)
            finally:
                if process is self.process:
                    self.end()
                elif process is not None:
                    process.close()

        return method

    def _answers(self, attribute: str) -> Callable[..., Any]:
        async def method(request: Any) -> Any:
            if self.process is None:
                raise ProcessDiedError(self.name, "is not there")
            assert isinstance(self._verbs, BehaviorVerbs)
            number = self._verbs.hand(request)
            try:
                return await self.process.run(
                    "order", attribute, number, request.data, request.sender
                )
            finally:
                self._verbs.orders.pop(number, None)

        return method

    def _methods_of_driver(self, sensor: Any) -> dict[str, Callable[..., Any]]:
        self._on_death = sensor.report_lost
        given = {"open": self._first("open"), "close": self._last("close")}
        given["apply"] = self._method("apply")
        for name in ("identify", "is_set_up"):
            if getattr(type(sensor), name) is not getattr(Resource, name):
                given[name] = self._method(name)
        if sensor.can_be_asked:
            given["read"] = self._method("read")
        if sensor.pushes:
            given["stream"] = self._stream
        for name in sensor.operations:
            given[name] = self._method(name)
        return given

    async def _stream(self) -> Any:
        process = self.process
        assert process is not None
        number = await process.run("stream")
        while (value := await process.run("next", number)) is not None:
            yield value[0]

    # What the child asks for.

    def _serve(self, number: int, verb: str, given: Any) -> None:
        process = self.process
        assert process is not None
        match given:
            case (int(scope), float(busy), tuple(args), dict(options)) if busy >= 0.0:
                pass
            case _:
                process.condemn("has asked for what it cannot have")
                return
        context: contextvars.Context | None
        context = process.scopes.get(scope, _NOBODY).copy()
        if plain := self._verbs.plain.get(verb):
            value: Any = None
            failed: BaseException | None = None
            try:
                value = context.run(plain, *args, **options)
            except Exception as error:
                failed = error
            process.answer(number, plain_result(value), failed)
            return
        waits = self._verbs.waits.get(verb)
        if verb == "next order":  # what it asks for next it does for that
            context = process.scopes.get(args[0]) if args else None
        is_known = number in self._tasks
        if waits is None or context is None or is_known or len(self._tasks) >= CALLS:
            process.condemn("has asked for what it cannot have")
            return
        asked = Asked(number, process.lateness(busy))
        self._tasks[number] = spawn(
            asyncio.get_running_loop(),
            self._wait(process, asked, waits, args, options),
            name=f"{self.name} {verb}",
            owner=self._owner,
            context=context,
        )

    async def _wait(
        self,
        process: Process,
        asked: Asked,
        function: Callable[..., Any],
        args: tuple[Any, ...],
        options: dict[str, Any],
    ) -> None:
        number = asked.number
        value: Any = None
        failed: BaseException | None = None
        try:
            value = await function(asked, *args, **options)
        except BaseException as error:  # told to the child
            failed = error
        if self._tasks.pop(number, None) is not None:
            process.answer(number, plain_result(value), failed)

    def _withdraw(self, number: int) -> None:
        task = self._tasks.get(number)
        if task is not None:
            task.cancel()

    def _died(self, error: ProcessDiedError) -> None:
        self.lost += 1
        for task in tuple(self._tasks.values()):
            task.cancel()
        self._tasks.clear()
        if self._on_death is not None:
            self._on_death(error)
