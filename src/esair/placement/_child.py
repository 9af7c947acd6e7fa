"""What runs in a child: one component, unmodified, whose robot is at the end of a wire."""

from __future__ import annotations

import asyncio
import concurrent.futures
import contextlib
import contextvars
import faulthandler
import functools
import importlib.util
import inspect
import itertools
import json
import logging
import os
import random
import signal
import socket
import sys
import threading
import time
from collections.abc import AsyncIterator, Callable, Iterator
from types import ModuleType
from typing import Any, Final, NamedTuple, NoReturn

from esair.actions import Behavior, Reaction, adapt_action, in_loop
from esair.codec import Kinds, declared, inner_of
from esair.exceptions import BusyError, ConfigError
from esair.loop import (
    NEVER,
    OwnedTasks,
    Owner,
    Portal,
    current_task_of,
    raisable,
    settle,
    spawn,
)
from esair.placement._home import Order, Reacting, fill, scope
from esair.placement._loop import ChildLoop
from esair.placement._verbs import SCRIPT_OF_CHILD
from esair.placement._wire import (
    ALWAYS,
    CALLS,
    ITEMS,
    RECORD,
    End,
    Exchange,
    Item,
    Op,
    Wire,
    make,
)
from esair.plan import SCRIPT, recipe_of
from esair.resources import Sensor, adapt_resource

_MIB: Final = 1 << 20
_OF_OTHERS: Final = frozenset({"get", "ask"})  # the calls that may be in a circle
_MEASURE: Final = frozenset({"read", "next"})  # the calls of the robot that measure


class KindsOfChild(Kinds):
    """The classes that a child may get: the robot names them, and it imports them."""

    def __init__(self) -> None:
        self._own: list[type] = []
        super().__init__(ALWAYS, more=self._add_own)

    def declare(self, kind: type) -> None:
        """Let those cross that a class declares."""
        self.programs.append(kind.__module__)
        self._own.append(kind)

    def _add_own(self, _: Kinds) -> None:
        while self._own:
            for each in declared(self._own.pop()):
                self.add(each)

    def find(self, name: str) -> Any:
        found = super().find(name)
        if found is None:
            module, _, path = name.partition(":")
            try:
                made: Any = importlib.import_module(module)
                for part in path.split("."):
                    made = getattr(made, part)
            except (ImportError, AttributeError):
                return None
            self.add(made)
            found = super().find(name)
        return found


_KINDS: Final = KindsOfChild()  # made once, for all children


def live(end: int) -> int:
    """Live as a child: the whole of a process."""
    sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]
    faulthandler.enable()
    faulthandler.register(signal.SIGUSR1)
    sys.breakpointhook = _no_terminal
    child = Child(Wire(socket.socket(fileno=end)))
    child.loop.run_forever()
    return 0


def _no_terminal(*_: object, **__: object) -> None:
    raise RuntimeError(
        "breakpoint() in a process without a terminal: run the component in the robot's "
        "process, with esair run --placement NAME=task"
    )


class Child(Exchange):
    """One component, and its way to the robot."""

    def __init__(self, wire: Wire) -> None:
        super().__init__("", _KINDS, ChildLoop(wire.fileno()), Owner())
        self.loop.home = self
        self._wire = wire
        self.component: Any = None
        self.portal: Portal | None = None
        self._of_threads: Portal
        self._news: dict[int, Callable[[Any], object]] = {}
        self.orders: dict[int, Callable[[], object]] = {}
        """What ends the work on a request, by its number."""
        self.numbers: Iterator[int] = itertools.count(-1, -1)
        """Of its loops over requests; those of calls are above 0."""
        self.free: list[int] = []
        """Of loops that are over."""
        self._heard = time.monotonic()
        self._has_turn = False
        self._of_others: set[int] = set()  # the calls that other behaviors answer
        self._asked_at = 0  # the pass of the loop in which it has waited last
        self._streams: dict[int, Any] = {}
        self.reacting: dict[int, Reacting] = {}
        """The reaction that it is, or those that it performs, by the number of the call."""
        self._at_once: dict[str, Callable[..., Any]] = {
            "settle": self._settle,
            "make": self._make,
            "made": lambda: None,
            "react": lambda step, *asked: self.reacting[step].decide(*asked),
        }
        self._own_verbs: dict[str, Callable[..., Any]] = {
            "stream": self._stream,
            "next": self._next,
            "order": self._answer,
            "apply": self._apply,
        }
        self._thread = threading.get_ident()
        asyncio.set_event_loop(self.loop)
        OwnedTasks.of(self.loop).install()

    # What the loop asks.

    def idle(self, wake: float) -> None:
        """Say that nothing is ready, and when to go on."""
        if self._has_turn:
            self._has_turn = False
            is_still = False
            if self._of_others:
                self._of_others &= self.calls.keys()
                is_still = bool(self._of_others) and self._is_still()
            self._send(Op.STILL if is_still else Op.IDLE, wake)

    def _is_still(self) -> bool:
        """Tell whether each of its tasks waits for the end of a call."""
        waiters = [getattr(each, "_fut_waiter", None) for each in self.owner.living()]
        waits = sum(isinstance(each, Outcome) for each in waiters)
        # A task that carries threads does nothing but wait for them.
        threads = len(self.owner.threads)
        return len(waiters) - waits <= (1 if threads and waits >= threads else 0)

    def tick(self) -> None:
        self._wire.send(Op.TICK, NEVER)

    def hear(self) -> None:
        """Take what the robot says."""
        for item in self._receive():
            self._take(item)

    def give_turn(self) -> None:
        """Let the robot go on, and tell what time it is, before this goes on."""
        self._send(Op.TURN)
        self.hear()

    def _send(self, kind: bytes, wake: float = NEVER) -> None:
        items = self.message()
        if self.queue and kind in {Op.IDLE, Op.STILL}:
            kind = Op.TURN  # there is more to tell
        try:
            self._wire.send(kind, wake, items)
        except ConnectionError:
            self.end()

    def _receive(self) -> list[Item]:
        _, now, items = self._wire.receive() or self.end()
        self._has_turn = True
        self._heard = time.monotonic()
        self.loop.told(now, self._heard)
        return items

    def end(self) -> NoReturn:
        """The robot wants no more of this process."""
        with contextlib.suppress(BaseException):
            if "coverage" in sys.modules:
                sys.modules["coverage"].Coverage.current().save()
            sys.stdout.flush()
            sys.stderr.flush()
        os._exit(0)

    # What the component asks of the robot.

    def call(self, verb: str, *args: Any, **options: Any) -> asyncio.Future[Any]:
        """Call the robot; awaiting waits for the end."""
        outcome = Outcome(loop=self.loop)
        outcome.child = self
        end = functools.partial(settle, outcome)
        outcome.number = self._call(end, verb, args, options)
        if verb in _OF_OTHERS:
            self._of_others.add(outcome.number)
        return outcome

    async def fetch(self, verb: str, *args: Any) -> Any:
        """Wait until the robot has something for a call, and take it, without a turn.

        So who is cancelled, hangs or dies before has taken nothing.
        """
        there = self.call(verb, *args)
        number = self.newest
        self.told_of(number, lambda _: settle(there, None, None))
        await there
        return self.wait("fetch", number)

    def told_of(self, number: int, hear: Callable[[Any], object]) -> None:
        self._news[number] = hear

    def wait(self, verb: str, *args: Any, **options: Any) -> Any:
        """Call the robot, and wait without a turn: what it does is done when this returns."""
        if threading.get_ident() != self._thread:
            return self._of_threads.call(in_loop, self.wait, verb, *args, **options)
        outcome: list[Any] = []
        number = self._call(lambda *end: outcome.extend(end), verb, args, options)
        goes_on = self.loop.passes != self._asked_at
        self._asked_at = self.loop.passes
        while not outcome:
            self._send(Op.TURN if goes_on else Op.SYNC)
            for item in self._receive():
                if item.number == number and item.op in {Op.DONE, Op.FAIL}:
                    self.ended(number, *self.opened(item))
                else:
                    self.loop.call_soon(self._take, item)
            goes_on = False
        value, error = outcome
        if error is not None:
            raise error
        return value

    def note(self, verb: str, *args: Any) -> None:
        """Tell the robot something, from any thread, and wait for nothing."""
        if threading.get_ident() != self._thread:
            self.loop.call_soon_threadsafe(self.note, verb, *args)
            return
        self._call(lambda *_: None, verb, args, {})

    def _call(
        self, end: End, verb: str, args: tuple[Any, ...], options: dict[str, Any]
    ) -> int:
        if len(self.queue) >= ITEMS // 2:
            raise BusyError(self.name, "number of calls from its process", CALLS)
        worked = time.monotonic() - self._heard
        return self.ask(end, verb, args, options, scope.get(), worked)

    # What the robot asks.

    def _take(self, item: Item) -> None:
        op, number, verb, data, *_ = item
        if op == Op.DONE or op == Op.FAIL:
            self._news.pop(number, None)
            self.ended(number, *self.opened(item))
        elif op == Op.CALL:
            self._begin(number, verb, data)
        elif op == Op.CANCEL:
            self._cancel(number)
        elif op == Op.NEWS:
            self._news[number](self.unpack(data))
        elif op == Op.WITHDRAWN and number in self.orders:  # it may be over by now
            self.orders[number]()

    def _begin(self, number: int, verb: str, data: bytes) -> None:
        try:
            options, *args = self.unpack(data) if data else (None,)
            if verb in self._at_once:
                self.answer(number, self._at_once[verb](*args), None)
                return
            method = self._method(verb)
        except BaseException as error:
            self.answer(number, None, error)
            return
        context = contextvars.copy_context()
        context.run(scope.set, number)
        self.tasks[number] = spawn(
            self.loop,
            self._work(number, method, args, options or {}, verb in _MEASURE),
            name=f"{self.name} {verb}",
            owner=self.owner,
            context=context,
            leaves=True,
        )

    async def _work(
        self, number: int, function: Any, args: Any, options: Any, measures: bool
    ) -> None:
        value: Any = None
        failed: BaseException | None = None
        try:
            value = await function(*args, **options)
        except BaseException as error:  # told to the robot
            failed = error
        ended = time.monotonic() if measures else 0.0
        if type(value) is Brought:
            value, ended = value
        self.over(number, current_task_of(self.loop), value, failed, ended)

    def _cancel(self, number: int) -> None:
        """End the work on a call, whose end tells so."""
        if (task := self.tasks.get(number)) is None:
            return
        task.cancel()
        if inspect.getcoroutinestate(task.get_coro()) == inspect.CORO_CREATED:
            # It will not even begin, so this is its end.
            self.over(number, task, None, asyncio.CancelledError())

    def _method(self, verb: str) -> Callable[..., Any]:
        if verb in self._own_verbs:
            return self._own_verbs[verb]
        function: Callable[..., Any] = getattr(self.component, verb)
        if inspect.iscoroutinefunction(function):
            return function
        if isinstance(self.component, Behavior):
            return self._in_thread(verb, function)
        return _called(function)

    def _in_thread(self, verb: str, function: Callable[..., Any]) -> Callable[..., Any]:
        portal = self.portal
        if portal is None or verb not in {"setup", "run", "teardown"}:
            portal = Portal(f"{self.name}_{verb}", self.owner)
        return functools.partial(portal.run, function)

    # The component.

    def _settle(self, given: dict[str, Any]) -> None:
        sys.path[:], sys.argv[:] = given["path"], given["argv"]
        self.name = given["name"]
        self._of_threads = Portal(self.name, self.owner)
        self.owner.stream = given["stream"] or random.Random()
        self.loop.is_of_virtual = given["is_virtual"]
        if given["memory"] is not None:
            import resource

            bytes_ = given["memory"] * _MIB
            resource.setrlimit(resource.RLIMIT_AS, (bytes_, bytes_))
        os.nice(given["nice"])
        root = logging.getLogger()
        root.handlers[:] = [Words()]
        root.setLevel(given["level"])
        with contextlib.suppress(OSError), open("/proc/self/comm", "w") as comm:
            comm.write(f"esair {self.name}"[:15])

    def _make(self, recipe: dict[str, Any], settings: dict[str, Any]) -> None:
        made = adapt_action(adapt_resource(make(recipe, find(recipe))))
        made._name = recipe["name"]  # noqa: SLF001 - as the robot calls it
        for name, value in settings.items():  # as it was configured since
            setattr(made, name, value)
        _KINDS.declare(type(inner_of(made)))
        self.component = made
        if isinstance(made, Behavior):
            if not inspect.iscoroutinefunction(made.run):
                self.portal = Portal(self.name, self.owner)
            fill(self, made, self.portal)
        elif isinstance(made, Reaction):
            self.reacting[0] = Reacting(self, made)
        else:
            assert isinstance(made, Sensor)
            self.who = "the driver"
            made._listener = self._device_said  # noqa: SLF001 - as its life does
            self.loop.runs = not self.loop.is_of_virtual

    def recipe(self, action: Any) -> dict[str, Any]:
        """Return what the robot makes of an action that was made here."""
        _KINDS.declare(type(inner_of(action)))
        return recipe_of(adapt_action(action))

    def _device_said(self, error: BaseException | None) -> None:
        if error is None:
            self.note("arrived")
        else:
            # Behind the answer of a call that says so and is over.
            lost = raisable(error, self.who)
            self.loop.call_soon_threadsafe(self.note, "lost", lost)

    async def _apply(self, **changes: Any) -> None:
        await _called(self.component.apply)(**changes)
        for name, value in changes.items():
            setattr(self.component, name, value)

    async def _stream(self) -> int:
        stream = self.component.stream()
        number = len(self._streams)
        if not hasattr(stream, "__anext__"):
            stream = _of_thread(iter(stream))
        self._streams[number] = stream
        return number

    async def _next(self, number: int) -> Any:
        return await anext(self._streams[number])

    async def _answer(self, attribute: str, number: int, data: Any, sender: str) -> Any:
        return await self._method(attribute)(Order(self, number, data, sender).handle)


class Outcome(asyncio.Future[Any]):
    """The end of a call of the robot; who cancels it cancels that."""

    child: Child
    number: int

    def cancel(self, msg: Any | None = None) -> bool:
        if self.child.calls.pop(self.number, None) is not None:
            self.child.tell(Item(Op.CANCEL, self.number, "", b""))
        return super().cancel(msg)


def _called(function: Callable[..., Any]) -> Callable[..., Any]:
    """Call a plain method of a driver: nobody else is here who would wait for it."""

    async def call(*args: Any, **options: Any) -> Any:
        found = function(*args, **options)
        return await found if inspect.isawaitable(found) else found

    return call


class Brought(NamedTuple):
    """A value that a thread has brought, and when it had it."""

    value: Any
    ended: float


async def _of_thread(values: Iterator[Any]) -> AsyncIterator[Brought]:
    """Yield what a blocking stream gives; a thread waits for it."""
    end = object()

    def wait() -> Brought:
        try:
            return Brought(next(values, end), time.monotonic())
        except BaseException as error:
            raise raisable(error, "the driver") from error

    thread = concurrent.futures.ThreadPoolExecutor(1)
    while (brought := await asyncio.wrap_future(thread.submit(wait))).value is not end:
        yield brought


def find(recipe: dict[str, Any]) -> Any:
    """Return the class that a recipe names, in the child."""
    module = recipe["module"]
    if module == SCRIPT:
        found: Any = _script(recipe["file"], recipe["within"])
    else:
        try:
            __import__(module)
        except ModuleNotFoundError as error:
            absent = f"{module}.".startswith(f"{error.name}.")
            if not absent or recipe.get("file") is None:
                raise
            _load(module, recipe["file"])
        found = sys.modules[module]
    for part in recipe["class"].split("."):
        found = getattr(found, part)
    return found


def _load(name: str, path: str) -> None:
    """Import a file that the robot's process has found by itself, not by its path."""
    import pathlib  # only where it cannot be found at once

    file, names = pathlib.Path(path).resolve(), name.split(".")
    sys.path.insert(0, str(file.parents[len(names) - 1]))
    if list(file.with_suffix("").parts[-len(names) :]) == names:
        importlib.import_module(name)
        return
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    sys.modules[name] = module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)


def _script(path: str, within: str) -> ModuleType:
    """Import the script that the robot was started with, but not as the one that runs."""
    import runpy

    known = sys.modules.get(SCRIPT_OF_CHILD)
    if known is None:
        known = ModuleType(SCRIPT_OF_CHILD)
        sys.modules[SCRIPT] = sys.modules[SCRIPT_OF_CHILD] = known
        try:
            if within == SCRIPT:
                found = runpy.run_path(path, run_name=SCRIPT_OF_CHILD)
            else:  # its relative imports are those of its package
                found = runpy.run_module(within, run_name=SCRIPT_OF_CHILD)
            vars(known).update(found)
        except (RuntimeError, ConfigError) as error:  # of the loop that runs here
            told = "a child imports it: put what runs under if __name__ == '__main__':"
            raise ConfigError(path, "", told) from error
    return known


class Words(logging.Handler):
    """Writes records as lines that the robot understands."""

    def emit(self, record: logging.LogRecord) -> None:
        try:
            told: dict[str, Any] = {"level": record.levelno, "name": record.name}
            lines = self.format(record).splitlines()[-100:] or [""]  # a traceback, too
            for line in lines:  # each is written whole, beside what others print
                text = json.dumps(told | {"text": line[:2000]})
                os.write(1, f"{RECORD}{text}\n".encode())
        except Exception:
            self.handleError(record)
