"""What runs in a child: one component, unmodified, whose robot is at the end of a wire."""

from __future__ import annotations

import asyncio
import contextlib
import contextvars
import faulthandler
import inspect
import json
import logging
import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable
from typing import Any, Final

from esair.actions import Behavior, Reaction, adapt_action
from esair.exceptions import BusyError, describe
from esair.loop import OwnedTasks, Owner, Portal, Stream, raisable, spawn
from esair.placement._home import Order, Reacting, fill, scope
from esair.placement._kinds import KindsOfChild
from esair.placement._loop import ChildLoop
from esair.placement._recipe import find, make
from esair.placement._wire import CALLS, ITEMS, Item, Values, Wire
from esair.placement._words import RECORD
from esair.plan import inner_of, recipe_of
from esair.resources import Sensor, adapt_resource

_MIB: Final = 1 << 20

_KINDS: Final = KindsOfChild()  # made once, for all children


def live(end: int) -> int:
    """Live as a child: the whole of a process."""
    sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]
    faulthandler.enable()
    faulthandler.register(signal.SIGUSR1)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    sys.breakpointhook = _no_terminal
    child = Child(Wire(socket.socket(fileno=end)))
    child.loop.run_forever()
    return 0


def _no_terminal(*_: object, **__: object) -> None:
    raise RuntimeError(
        "breakpoint() in a process without a terminal: run the component in the robot's "
        "process, with esair run --placement NAME=task"
    )


class Child:
    """One component, and its way to the robot."""

    def __init__(self, wire: Wire) -> None:
        self._wire = wire
        self.values: Values
        self.name = ""
        self._own = Owner()
        self.owner: Owner | None = self._own
        self.component: Any = None
        self.portal: Portal | None = None
        self._news: dict[int, Callable[[Any], object]] = {}
        self.orders: dict[int, Callable[[], object]] = {}
        """What ends the work on a request, by its number."""
        self._calls: dict[int, asyncio.Future[Any] | None] = {}
        self._working: dict[int, asyncio.Task[Any]] = {}
        self._number = 0
        self._out: list[Item] = []
        self._heard = time.monotonic()
        self._has_turn = False
        self._stall: float | None = None
        self._streams: dict[int, Any] = {}
        self.reacting: dict[int, Reacting] = {}
        """The reaction that it is, or those that it performs, by the number of the call."""
        self._thread = threading.get_ident()
        self.loop = ChildLoop(self)
        asyncio.set_event_loop(self.loop)
        OwnedTasks.of(self.loop).install()

    # What the loop asks (`Home`).

    def fileno(self) -> int:
        return self._wire.fileno()

    def idle(self, wake: float | None) -> None:
        if self._stall is not None:
            faulthandler.cancel_dump_traceback_later()
        if self._has_turn:
            self._has_turn = False
            self._send("idle", wake)

    def tick(self) -> None:
        self._wire.send(("tick", None), [])

    def hear(self) -> float:
        now, items = self._receive()
        for item in items:
            self._take(item)
        return now

    def _send(self, kind: str, wake: float | None) -> None:
        out, self._out = self._out, []
        try:
            self._wire.send((kind, wake), out)
        except OSError:
            self.end()

    def _receive(self) -> tuple[float, list[Item]]:
        message = self._wire.receive()
        if message is None:
            self.end()
        assert message is not None
        self._has_turn = True
        self._heard = time.monotonic()
        if self._stall is not None:  # nobody there has a clock that tells
            faulthandler.dump_traceback_later(self._stall, exit=True)
        return message

    def end(self) -> None:
        """The robot wants no more of this process."""
        faulthandler.cancel_dump_traceback_later()
        with contextlib.suppress(BaseException):
            if "coverage" in sys.modules:
                sys.modules["coverage"].Coverage.current().save()
            sys.stdout.flush()
            sys.stderr.flush()
        os._exit(0)

    # What the component asks of the robot.

    def call(self, verb: str, *args: Any, **options: Any) -> asyncio.Future[Any]:
        """Call the robot; awaiting waits for the end."""
        future = self.loop.create_future()
        number = self._ask(verb, args, options, future)

        def done(future: asyncio.Future[Any]) -> None:
            if future.cancelled() and self._calls.pop(number, None) is not None:
                self._out.append(Item("cancel", number, "", b""))

        future.add_done_callback(done)
        return future

    def told_of(self, number: int, hear: Callable[[Any], object]) -> None:
        self._news[number] = hear

    @property
    def newest(self) -> int:
        """The number of the newest call."""
        return self._number

    def ask(self, verb: str, *args: Any, **options: Any) -> Any:
        """Call the robot, and wait without a turn: what it does is done when this returns."""
        if threading.get_ident() != self._thread:
            return self.here(self.ask, verb, *args, **options)
        number = self._ask(verb, args, options, None)
        self._send("sync", None)
        found: Item | None = None
        while found is None:
            _, items = self._receive()
            for item in items:
                if item.number == number and item.op in {"done", "fail"}:
                    found = item
                else:
                    self.loop.call_soon(self._take, item)
            if found is None:
                self._send("sync", None)
        del self._calls[number]
        if found.op == "done":
            return self.values.unpack(found.data)
        raise self.values.unpack_error(found.data)

    def note(self, verb: str, *args: Any) -> None:
        """Tell the robot something, from any thread, and wait for nothing."""
        if threading.get_ident() != self._thread:
            self.loop.call_soon_threadsafe(self.note, verb, *args)
            return
        self._ask(verb, args, {}, None)

    def here(self, function: Callable[..., Any], *args: Any, **options: Any) -> Any:
        """Call something in the loop, and wait for it in a thread."""
        ready = threading.Event()
        outcome: list[Any] = []
        context = contextvars.copy_context()

        def run() -> None:
            try:
                outcome.extend((context.run(function, *args, **options), None))
            except BaseException as error:
                outcome.extend((None, error))
            ready.set()

        self.loop.call_soon_threadsafe(run)
        ready.wait()
        value, error = outcome
        if error is not None:
            raise error
        return value

    def _ask(
        self,
        verb: str,
        args: tuple[Any, ...],
        options: dict[str, Any],
        future: asyncio.Future[Any] | None,
    ) -> int:
        if len(self._calls) >= CALLS or len(self._out) >= ITEMS // 2:
            raise BusyError(self.name, "number of calls from its process", CALLS)
        busy = time.monotonic() - self._heard
        data = self.values.pack(verb, (scope.get(), busy, args, options))
        self._number += 1
        self._calls[self._number] = future
        self._out.append(Item("call", self._number, verb, data))
        return self._number

    # What the robot asks.

    def _take(self, item: Item) -> None:
        op, number, verb, data = item
        if op == "call":
            self._begin(number, verb, data)
        elif op == "cancel":
            if number in self._working:
                self._working[number].cancel()
        elif op == "news":
            self._news[number](self.values.unpack(data))
        elif op == "withdrawn":
            self.orders[number]()
        else:
            self._news.pop(number, None)
            future = self._calls.pop(number, None)
            if future is None or future.done():
                return
            if op == "done":
                future.set_result(self.values.unpack(data))
                return
            error = self.values.unpack_error(data)
            if isinstance(error, asyncio.CancelledError):
                future.cancel()
            else:
                future.set_exception(error)

    def _begin(self, number: int, verb: str, data: bytes) -> None:
        if verb == "settle":
            self.values = Values("", _KINDS)
        try:
            args, options = self.values.unpack(data)
            quick: dict[str, Callable[..., Any]] = {
                "settle": self._settle,
                "make": self._make,
                "react": self._decide,
            }
            if verb in quick:
                self._end_call(number, quick[verb](*args), None)
                return
        except BaseException as error:
            self._end_call(number, None, error)
            return
        context = contextvars.copy_context()
        context.run(scope.set, number)
        self._working[number] = spawn(
            self.loop,
            self._do(number, verb, args, options),
            name=f"{self.name} {verb}",
            owner=self.owner,
            context=context,
        )

    def _end_call(self, number: int, value: Any, error: BaseException | None) -> None:
        self._working.pop(number, None)
        if error is None:
            try:
                data = self.values.pack("answer", value)
            except Exception as unfit:
                error = unfit
            else:
                self._out.append(Item("done", number, "", data))
                return
        self._out.append(Item("fail", number, "", self.values.pack_error(error)))

    async def _do(
        self, number: int, verb: str, args: tuple[Any, ...], options: dict[str, Any]
    ) -> None:
        value: Any = None
        failed: BaseException | None = None
        try:
            value = await self._method(verb)(*args, **options)
        except BaseException as error:  # told to the robot
            failed = error
        self._end_call(number, value, failed)

    def _method(self, verb: str) -> Callable[..., Any]:
        own: dict[str, Callable[..., Any]] = {
            "stream": self._stream,
            "next": self._next,
            "order": self._answer,
        }
        if verb in own:
            return own[verb]
        if verb == "apply":
            return self._apply
        function: Callable[..., Any] = getattr(self.component, verb)
        if inspect.iscoroutinefunction(function):
            return function
        if isinstance(self.component, Behavior):
            return self._in_thread(verb, function)
        return _called(function)

    def _in_thread(self, verb: str, function: Callable[..., Any]) -> Callable[..., Any]:
        portal = self.portal
        if portal is None or verb not in {"setup", "run", "teardown"}:
            portal = Portal(f"{self.name}_{verb}", self._own)

        async def run(*args: Any) -> Any:
            result: list[Any] = []
            await portal.run(lambda: result.append(function(*args)))
            return result[0]

        return run

    # The component.

    def _settle(self, given: dict[str, Any]) -> None:
        sys.path[:] = given["path"]
        self.name = self.values.name = given["name"]
        self._own.stream = Stream(given["stream"])
        self._stall = given["stall"]
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

    def _make(self, recipe: dict[str, Any]) -> None:
        made = adapt_action(adapt_resource(make(recipe, find(recipe))))
        made._name = recipe["name"]  # noqa: SLF001 - as the robot calls it
        _KINDS.declare(type(inner_of(made)))
        self.component = made
        if isinstance(made, Behavior):
            if not inspect.iscoroutinefunction(made.run):
                self.portal = Portal(self.name, self._own)
            fill(self, made, self.portal)
        elif isinstance(made, Reaction):
            self.reacting[0] = Reacting(self, made)
        else:
            assert isinstance(made, Sensor)
            made._listener = self._device_said  # noqa: SLF001 - as its life does

    def _decide(self, step: int, *asked: Any) -> Any:
        return self.reacting[step].decide(*asked)

    def recipe(self, action: Any) -> dict[str, Any]:
        """Return what the robot makes of an action that was made here."""
        _KINDS.declare(type(inner_of(action)))
        return recipe_of(adapt_action(action))

    def _device_said(self, error: BaseException | None) -> None:
        if error is None:
            self.note("arrived")
        else:
            self.note("lost", raisable(error))

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
        try:
            return (await anext(self._streams[number]),)
        except StopAsyncIteration:
            return None

    async def _answer(self, attribute: str, number: int, data: Any, sender: str) -> Any:
        return await self._method(attribute)(Order(self, number, data, sender).handle)


def _called(function: Callable[..., Any]) -> Callable[..., Any]:
    """Call a plain method of a driver: nobody else is here who would wait for it."""

    async def call(*args: Any, **options: Any) -> Any:
        found = function(*args, **options)
        return await found if inspect.isawaitable(found) else found

    return call


async def _of_thread(values: Any) -> Any:
    """Yield what a blocking stream gives; a thread waits for it."""
    end = object()
    loop = asyncio.get_running_loop()
    while True:
        future = loop.create_future()

        def wait(future: asyncio.Future[Any] = future) -> None:
            try:
                outcome, error = next(values, end), None
            except BaseException as raised:
                outcome, error = end, raised

            def tell() -> None:
                if not future.done():
                    if error is None:
                        future.set_result(outcome)
                    else:
                        future.set_exception(raisable(error))

            loop.call_soon_threadsafe(tell)

        threading.Thread(target=wait, daemon=True).start()
        value = await future
        if value is end:
            return
        yield value


class Words(logging.Handler):
    """Writes records as lines that the robot understands."""

    def emit(self, record: logging.LogRecord) -> None:
        try:
            text = record.getMessage()
            if record.exc_info and record.exc_info[1] is not None:
                text = f"{text}: {describe(record.exc_info[1])}"
            told = {"level": record.levelno, "name": record.name, "text": text[:2000]}
            os.write(1, RECORD.encode() + json.dumps(told).encode() + b"\n")
        except Exception:
            self.handleError(record)
