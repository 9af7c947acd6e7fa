"""What lies between esair and one device or behavior: its faults, and what it was told."""

from __future__ import annotations

import asyncio
import contextlib
import functools
import inspect
import random
import types
from collections.abc import (
    AsyncIterator,
    Callable,
    Coroutine,
    Generator,
    Iterator,
    Sequence,
)
from typing import TYPE_CHECKING, Any

import attrs

from esair.actions import Guards, Reaction
from esair.loop import portal
from esair.resources import HOLD, Resource, Sensor
from esair.testing import VirtualLoop
from esair.torture._values import (
    CannotMakeError,
    has_number,
    is_good,
    make,
    same,
    wrong,
)
from esair.values import fits

if TYPE_CHECKING:
    from esair.torture._judge import Judge
    from esair.torture._kinds import Step

CALLS = {
    "open": "",
    "close": "",
    "identify": "identifies",
    "apply": "",
    "is_set_up": "can_tell_set_up",
    "read": "can_be_asked",
    "write": "command_timeout",
}
"""The methods of a driver that esair calls, beside ``stream`` and operations, each if the
driver has this."""

MOODS = (0.0, 0.1, 1.0, 1.0, 2.0)
"""How late the calls of a late device are, times what was said: not equally."""

AT_ONCE = 20
"""How many calls a device takes in one moment: then one takes `TAKES` seconds, so that
a loop which only waits for its device goes on in time."""

TAKES = 0.04

SOON = 0.1  # How often the stand-in of a sensor that pushes does so, in seconds


@attrs.define(eq=False)
class Told:
    command: Any
    safe: bool  # Whether it is the safe one, or to stay
    begun: float  # When the driver was called, in seconds of the loop's clock
    number: int  # How many it was told before
    landed: float | None = None  # When the device had it; None if it never did
    mover: str = ""  # Whose motion it is
    priority: int = 0  # With which priority
    watched: Sequence[Any] = ()  # The actions that the robot had then


class UnprintableError(Exception):
    """An error of a driver that cannot even be printed."""

    def __str__(self) -> str:
        raise RuntimeError("this error has no words")


ERRORS: dict[str, Callable[[], BaseException]] = {
    "OSError": lambda: OSError(5, "injected"),
    "ValueError": lambda: ValueError("injected"),
    "TimeoutError": lambda: TimeoutError("injected"),
    "SystemExit": lambda: SystemExit(3),
    "KeyboardInterrupt": KeyboardInterrupt,
    "CancelledError": asyncio.CancelledError,
    "unprintable": UnprintableError,
}
"""What a driver, or a behavior, may raise."""


_INJECTED = "injected by torture"


def injected(error: str) -> BaseException:
    """Make an error that a driver, or a behavior, is made to raise; it says so."""
    made = ERRORS[error]()
    made.add_note(_INJECTED)
    return made


def is_injected(error: BaseException) -> bool:
    """Tell whether an error is one of those, or a group of them."""
    if isinstance(error, BaseExceptionGroup):
        return all(map(is_injected, error.exceptions))
    return _INJECTED in getattr(error, "__notes__", ())


class Gate:
    def __init__(
        self,
        resource: Resource,
        loop: VirtualLoop,
        seed: int,
        judge: Judge,
        *,
        alone: bool,
    ) -> None:
        self.resource = resource
        self.name: str = resource.name
        self.told: list[Told] = []
        self.safe_begun: float = -1.0  # When it was told its newest safe command
        self.safe_landed: int = -1  # The number of the newest one that it had
        self.heard: float = -1e9  # When the robot got a good value from it last
        self.applied: float = -1e9  # When it was configured last
        # When it was taken away from the robot; None while it belongs to it
        self.left: float | None = None
        self.faulty: float = -1.0  # When its last fault is over
        # Until when each kind of fault lasts, on the loop's clock, and how it is
        self.faults: dict[str, tuple[float, Step]] = {}
        self.deaf = self.unpowered = self._opens = False
        self.was_here: bool = False  # Whether its driver was ever called
        self.in_thread: bool = False  # Whether it is read or told in a thread
        self.speechless: str = ""  # Why a stand-in has nothing to say; empty if it has
        self._loop = loop
        self._dice = random.Random(f"{seed}/{resource.name}")
        self._moods = random.Random(seed)
        self._judge = judge
        self._called, self._at_once = -1.0, 0  # when last, and how often in that moment
        self._last: Any = None
        self._good: Any = self
        self._install(alone)

    # In front of the driver.

    def _install(self, alone: bool) -> None:
        resource, own = self.resource, vars(self.resource)
        if isinstance(resource, Sensor) and resource.is_computed:
            return  # it has no driver
        stand_in = _StandIn(self, self._dice) if alone else None
        if stand_in is not None and isinstance(resource, Sensor):
            try:
                stand_in.value()
            except CannotMakeError as error:
                self.speechless = str(error)
        if stand_in is not None and resource.bus is not None:
            vars(resource.bus).update(open=stand_in.open, close=stand_in.close)
        for name, asked in CALLS.items():
            if not asked or getattr(resource, asked, False):
                inner = getattr(resource, name)
                if stand_in is not None:
                    inner = getattr(stand_in, name)
                own[name] = self._passing(name, inner)
        if isinstance(resource, Sensor) and resource.pushes:
            values = resource.stream if stand_in is None else stand_in.stream
            own["stream"] = self._stream(values)
        if stand_in is not None:
            for name in resource.operations:
                own[name] = self._passing(name, stand_in.operate)

    def _passing(self, name: str, inner: Callable[..., Any]) -> Callable[..., Any]:
        if inspect.iscoroutinefunction(inner):

            @functools.wraps(inner)
            async def call(*args: Any, **options: Any) -> Any:
                told = self._begins(name, args)
                await self._wait(self._pause())
                self._check(name)
                result = await inner(*args, **options)
                result = self._ended(name, told, result)
                await self._wait(self.late("after"))
                self._returns(name, result)
                return result

            return call

        self.in_thread |= name in {"read", "write"}

        @functools.wraps(inner)
        def blocking(*args: Any, **options: Any) -> Any:
            told = self._begins(name, args)
            self._sleep(self._pause())
            self._check(name)
            result = self._ended(name, told, inner(*args, **options))
            self._sleep(self.late("after"))
            self._returns(name, result)
            return result

        return blocking

    def _stream(self, values: Callable[[], Any]) -> Callable[[], Any]:
        if not inspect.isasyncgenfunction(values):
            if inspect.isgeneratorfunction(values):
                return functools.wraps(values)(lambda: self._blocking_stream(values))
            return values

        @functools.wraps(values)
        async def stream() -> AsyncIterator[Any]:
            # Closed here: the collector would do it at a moment that does not repeat.
            async with contextlib.aclosing(values()) as pushed:
                async for value in pushed:
                    await self._wait(self._pause())
                    for each in self._passes(value):
                        yield each

        return stream

    def _blocking_stream(self, values: Callable[[], Any]) -> Iterator[Any]:
        for value in values():
            yield from self._passes(value)

    def _passes(self, value: Any) -> list[Any]:
        """Return what comes out if a device pushes a value."""
        self._check("stream")
        value = self._reading(value)
        self._returns("stream", value)
        flood = self._fault("flooding")
        return [value] * (int(flood.much) if flood else 1)

    # Faults.

    def _fault(self, kind: str) -> Step | None:
        until, step = self.faults.get(kind, (-1.0, None))
        return step if self._loop.time() < until else None

    def _begins(self, name: str, args: tuple[Any, ...]) -> Told | None:
        self.was_here = True
        if name != "write":
            return None
        safe = args[0] is HOLD or same(args[0], getattr(self.resource, "safe", None))
        told = Told(args[0], safe, self._loop.time(), len(self.told))
        self.told.append(told)
        self.safe_begun = told.begun if safe else self.safe_begun
        self._judge.begins(self, told)
        return told

    def _ended(self, name: str, told: Told | None, result: Any) -> Any:
        if told is not None:
            told.landed = self._loop.time()
            self._judge.lands(self, told)
        elif name == "read":
            return self._reading(result)
        elif name == "open":
            self.unpowered = False
        elif name == "is_set_up" and self.unpowered:
            return False
        return result

    def _pause(self) -> float:
        """How long a call waits before the device has it, in seconds."""
        silent = self.faults["silent"][0] if "silent" in self.faults else 0.0
        late, now = self.late("before"), self._loop.time()
        self._at_once = self._at_once + 1 if now == self._called else 1
        self._called = now
        return max(
            late * self._moods.choice(MOODS) if late else 0.0,
            silent - now,
            TAKES if self._at_once > AT_ONCE else 0.0,
        )

    def late(self, how: str) -> float:
        """How late its calls are now, before or after the device has it, in seconds."""
        late = self._fault("late")
        return late.much if late and late.how.startswith(how) else 0.0

    def _check(self, name: str) -> None:
        """Raise what the device's absence, or a fault of its driver, raises."""
        if self._fault("unplugged") and name != "close":
            raise ConnectionResetError(104, "unplugged")
        if fails := self._fault("failing"):
            raise injected(fails.how)

    def _reading(self, value: Any) -> Any:
        if bad := self._fault("wrong"):
            value = wrong(value, bad.how)
            # Of a sensor that does not say what it gives anything is believed.
            passes = bad.how in {"nothing", "type"} and fits(
                value, self.resource.value_type
            )
            self._good = value if passes or bad.how == "huge" else self
            return value
        if self._fault("stuck"):
            value = self._last
        self._last = self._good = value
        return value

    def _returns(self, name: str, value: Any) -> None:
        """Take note that the robot gets a value now, if it is a good one."""
        # The initial value counts when the opening is over, whose last call applies.
        opened = name == "open" or (name == "apply" and self._opens)
        if name != "identify":
            self._opens = name == "open"
        if name == "apply":
            self.applied = self._loop.time()
        is_first = opened and hasattr(self.resource, "initial")
        if is_first or (name in {"read", "stream"} and value is self._good):
            self.heard = self._loop.time()

    async def _wait(self, seconds: float) -> None:
        if seconds <= 0.0:
            return
        until = self._loop.time() + seconds
        while (left := until - self._loop.time()) > 1e-9:
            try:
                await asyncio.sleep(left)
            except asyncio.CancelledError:
                if not self.deaf:
                    raise

    def _sleep(self, seconds: float) -> None:
        if seconds > 0.0:
            self._loop.wait_in_thread(seconds)


class _StandIn:
    """Answers in the place of a driver that must not be called."""

    def __init__(self, gate: Gate, dice: random.Random) -> None:
        self._gate = gate
        self._dice = dice

    async def open(self) -> None: ...

    async def close(self) -> None: ...

    async def apply(self, **_changes: Any) -> None: ...

    async def write(self, _command: Any) -> None: ...

    async def operate(self, *_args: Any, **_options: Any) -> None: ...

    async def identify(self) -> Any:
        return self._gate.resource.identity or "stand-in"

    async def is_set_up(self) -> bool:
        return True

    async def read(self) -> Any:
        await self.listen()
        return self.value()

    async def listen(self) -> None:
        if self._gate.speechless:
            await asyncio.get_running_loop().create_future()

    async def stream(self) -> AsyncIterator[Any]:
        await self.listen()
        resource: Any = self._gate.resource
        while True:
            yield self.value()
            await asyncio.sleep((resource.period or 3 * SOON) / 3)

    def value(self) -> Any:
        resource: Any = self._gate.resource
        return make(resource.value_type, self._dice, resource.limits)


class Lever:
    def __init__(self, action: Any, loop: Any) -> None:
        self.action = action
        # Until when it does not go on, its commands are no good
        self.hangs = self.mad = -1.0
        self.slow: list[tuple[float, float]] = []  # Until when each step takes how long
        # Deaf: it does not hear its cancellation meanwhile, as no thread does
        self.deaf = self.was_deaf = False
        self.undecided = False  # Whether the last step of a reaction gave nothing good
        # Whether this guard has refused a command, and latches, until it is reset
        self.latched = False
        needs = action.needs.values()
        self._latches = any(isinstance(n, Guards) and n.latch for n in needs)
        self.how = "nan"
        self._loop = loop
        self._error: str | None = None
        self._in_thread = False
        self._tasks: set[asyncio.Task[Any]] = set()
        own = vars(action)
        if isinstance(action, Reaction):
            own["react"] = self._stepping(action.react)
        elif inspect.iscoroutinefunction(action.run):
            own["run"] = self._running(action.run)
        else:
            own["run"] = self._running_in_thread(action.run)

    @property
    def is_running(self) -> bool:
        """Whether its ``run`` has not ended, a plain one aside."""
        return any(not task.done() for task in self._tasks)

    def hang(self, seconds: float, *, deaf: bool) -> None:
        """Do not go on for a while."""
        self.hangs = self._loop.time() + seconds
        self.deaf = deaf or self._in_thread
        self.was_deaf |= self.deaf

    def crash(self, error: str) -> None:
        """Raise an error from its code: at once, or in the next step."""
        self._error = error
        for task in tuple(self._tasks):
            task.cancel()

    def _stepping(self, react: Any) -> Any:
        @functools.wraps(react)
        def step(*args: Any, **readings: Any) -> Any:
            error, self._error = self._error, None
            now = self._loop.time()
            if self.slow and now < self.slow[-1][0]:
                self._loop.advance(self.slow[-1][1])
            self.undecided = True
            if error is not None:
                raise injected(error)
            command = react(*args, **readings)
            if now < self.mad and command is not None and has_number(command):
                command = wrong(command, self.how)
            self.undecided = not is_good(command)
            self.latched |= self._latches and command is None
            return command

        return step

    def _running(self, run: Any) -> Any:
        @functools.wraps(run)
        async def running() -> None:
            task = asyncio.current_task()
            assert task is not None
            self._tasks.add(task)
            self._error = None
            try:
                await self._driven(run())
            except asyncio.CancelledError:
                error, self._error = self._error, None
                if error is None:
                    raise
                task.uncancel()
                raise injected(error) from None
            finally:
                self._tasks.discard(task)

        return running

    def _running_in_thread(self, run: Any) -> Any:
        self._in_thread = True

        @functools.wraps(run)
        def running() -> None:
            mine: Any = portal.get()
            call = mine.call
            self._error = None

            def obeying(*args: Any, **options: Any) -> Any:
                try:
                    return call(*args, **options)
                finally:  # hang, then crash, if it was told to
                    hangs = self.hangs - self._loop.time()
                    if hangs > 0.0:
                        self._loop.wait_in_thread(hangs)
                    error, self._error = self._error, None
                    if error is not None:
                        raise injected(error)

            mine.call = obeying
            run()

        return running

    @types.coroutine
    def _driven(self, run: Coroutine[Any, Any, None]) -> Generator[Any, Any, None]:
        """Go on with a coroutine, but not while it hangs."""
        go_on: Any = run.send
        value: Any = None
        while True:
            try:
                awaited = go_on(value)
            except StopIteration:
                return
            try:
                value, go_on = (yield awaited), run.send
            except BaseException as error:
                value, go_on = error, run.throw
            while self._loop.time() < self.hangs and not isinstance(
                value, GeneratorExit
            ):
                waits = self._loop.create_future()
                timer = self._loop.call_at(self.hangs, _done, waits)
                try:
                    yield from waits
                except asyncio.CancelledError as error:
                    if not self.deaf:
                        value, go_on = error, run.throw
                        break
                finally:
                    timer.cancel()


def _done(future: asyncio.Future[None]) -> None:
    if not future.done():
        future.set_result(None)
