"""The calls of one driver: each has a number, a deadline and one outcome."""

from __future__ import annotations

import asyncio
import contextvars
from collections.abc import Callable
from functools import partial
from typing import Any

from esair.connections._driver import Apply, Call, Driver, End, Guard, Method
from esair.exceptions import DeviceFaultError, DriverStuckError, EsairError, describe
from esair.loop import (
    ENDED,
    REACHED,
    WAITS,
    CallRefused,
    Deadlines,
    Door,
    First,
    FirstSteps,
    LightTask,
    Player,
    TapeWriter,
    clock_of,
    current_task_of,
    current_tasks,
    wake,
)

UNWIND = 0.1
"""How long a call that was given up may take to end, before its device is closed, in s."""

ABANDONED_LIMIT = 8
"""How many abandoned calls of one device may be alive; with more, none is begun."""


class Calls:
    """The calls of one driver. Their numbers, and those of the openings, only grow.

    A call has one outcome, within its deadline, whatever the driver does with a
    cancellation: then it is abandoned, listed and counted, and nothing that it does
    later has an effect, but that whoever owns it hears of its end (``on_late``).
    """

    # Slots: a thousand of these are touched a hundred times a second.
    __slots__ = (
        "_deadline",
        "_deadlines",
        "_door",
        "_left",
        "_loop",
        "_on_late",
        "_on_stuck",
        "_steps",
        "_time",
        "abandoned",
        "alive",
        "context",
        "driver",
        "late",
        "lost",
        "number",
        "on_late_open",
        "opening",
        "resource",
    )

    def __init__(
        self,
        driver: Driver,
        loop: asyncio.AbstractEventLoop,
        *,
        on_late: Callable[[Call], None],
        on_stuck: Callable[[Call], None],
        left: set[Call],
    ) -> None:
        self.driver = driver
        self.resource = driver.resource.name
        self.opening = 0
        self.number = 0
        self.alive: dict[int, Call] = {}
        """The calls whose driver's code has not ended, by number."""
        self.abandoned = 0  # how many calls have had their outcome before they ended
        self.late = 0  # how many of them have ended since, without an effect
        self.lost: EsairError | None = None
        """What each call of this opening meets, from when the device was told to be lost
        until that takes effect at the border of a turn. It is an outcome of the calls,
        which a replay can repeat; a state that changes amid a turn is not."""
        self.on_late_open: Apply | None = None
        """Told of an opening that has ended after it was given up."""
        self._loop = loop
        self._time = clock_of(loop)
        self._deadlines = Deadlines.of(loop)
        self._deadline = self._deadlines.idle(self._expire)
        """That of the call whose time is over first."""
        self._door = Door.of(loop)
        self._on_late = on_late
        self._on_stuck = on_stuck
        self._left = left
        self._steps = FirstSteps.of(loop)
        self.context = contextvars.Context()
        """What the driver's first steps run in, so that it belongs to nobody."""

    @property
    def task_name(self) -> str:
        """What tools see where a task of the driver runs."""
        return f"{self.resource} driver"

    def begin(
        self,
        kind: str,
        method: Method,
        args: tuple[Any, ...],
        limit: float | None,
        guard: Guard | None = None,
    ) -> Any:
        self.number += 1
        if self.alive and len(self.alive) > ABANDONED_LIMIT:
            self._check_abandoned(kind)
        tape = self._door.tape
        if tape is not None:
            return self._begin_taped(tape, kind, method, args, limit, guard)
        if self.lost is not None:
            self._check_lost(kind)
        if method.is_plain:
            try:
                value = self.context.run(method.function, *args)
            except BaseException as error:
                raise self._contained(error) from error.__cause__
            if value is None or not hasattr(value, "__await__"):
                return value
            method, args = _REST, (value,)
        steps = self._steps
        light = steps.spare
        if light.caller is not None or not method.is_usual:
            return self._begin_untaped(kind, method, args, limit, guard)
        # Most calls are these, and end here: it is `FirstSteps.begin` in its place.
        light.caller = self
        loop = self._loop
        caller = current_task_of(loop)
        current_tasks[loop] = light
        waits_for: Any = None
        try:
            coroutine = method.function(*args)
            waits_for = self.context.run(light.send, coroutine)
        except BaseException as error:
            contained = self._contained(error)
            raise contained from contained.__cause__
        finally:
            if caller is None:
                del current_tasks[loop]
            else:
                current_tasks[loop] = caller
            if waits_for is ENDED and not light._num_cancels_requested:  # noqa: SLF001 - the name that anyio looks at
                light.caller = None
            else:
                steps.spare = LightTask(loop)
        if waits_for is ENDED:
            return light.value
        light.goes_on(coroutine, waits_for)
        return self._follow(light, kind, args, limit)

    def _begin_untaped(
        self,
        kind: str,
        method: Method,
        args: tuple[Any, ...],
        limit: float | None,
        guard: Guard | None,
    ) -> Any:
        """Call a method of the driver, whether or not the run is kept."""
        self._check_lost(kind)
        if method.executor is not None:
            call = self._track(kind, args, limit)
            threaded = ThreadedCall(self, call, method, guard)
            call.engine = threaded
            try:
                threaded.submit(self._loop)
            except BaseException:
                del self.alive[call.number]
                raise
            return call
        try:
            if method.is_plain:
                value = self.context.run(method.function, *args)
                if value is None or not hasattr(value, "__await__"):
                    return value
                coroutine = _awaited(value)
            else:
                coroutine = method.function(*args)
            value = self._steps.begin(coroutine, self)
        except BaseException as error:
            contained = self._contained(error)
            raise contained from contained.__cause__
        if type(value) is not LightTask or value.get_coro() is None:
            return value  # also a light task that the driver has returned
        return self._follow(value, kind, args, limit)

    def _begin_taped(
        self,
        tape: TapeWriter | Player,
        kind: str,
        method: Method,
        args: tuple[Any, ...],
        limit: float | None,
        guard: Guard | None,
    ) -> Any:
        """Call a method and keep what comes of it; in a replay take that from the tape."""
        if getattr(self.driver.resource, "is_computed", False):  # it is no device
            return self._begin_untaped(kind, method, args, limit, guard)
        tag = ("call", self.resource, kind)
        if isinstance(tape, Player):
            number, first = tape.first(tag)
            if first.error is not None:
                raise first.error
            if not first.waits:
                return first.value
            call = self._track(kind, args, limit)
            tape.expect(tag, number, lambda end: self.ended(call, End(*end)))
            return call
        try:
            value = self._begin_untaped(kind, method, args, limit, guard)
        except Exception as error:
            tape.first(tag, First(waits=False, value=None, error=error))
            raise
        if type(value) is not Call:
            tape.first(tag, First(waits=False, value=value, error=None))
            return value
        number = tape.first(tag, First(waits=True, value=None, error=None))
        value.taped = lambda end: tape.arrived(tag, tuple(end), number=number)
        return value

    def _follow(
        self, light: LightTask, kind: str, args: tuple[Any, ...], limit: float | None
    ) -> Call:
        """Make the call of a driver that goes on in a light task."""
        call = self._track(kind, args, limit)
        call.engine = light
        light.then(partial(self.over, call))
        return call

    async def run(
        self, kind: str, method: Method, *args: Any, limit: float | None
    ) -> Any:
        """Call a method of the driver and wait for its outcome."""
        value = self.begin(kind, method, args, limit)
        return await self.outcome(value) if type(value) is Call else value

    def attempt(
        self, method: Method, limit: float, told: Callable[[End], None], apply: Apply
    ) -> Call | None:
        """Call a method of the driver, and tell its end now, unless it waits."""
        try:
            value = self.begin(method.name, method, (), limit)
        except Exception as error:
            told(End(None, error))
            return None
        if type(value) is Call:
            value.apply = apply
            return value
        told(End(value, None))
        return None

    async def outcome(self, call: Call) -> Any:
        """Wait for the outcome of a call; whoever is cancelled here cancels it."""
        if call.outcome is None:
            waiter: asyncio.Future[None] = self._loop.create_future()
            call.waiters.append(waiter)
            try:
                await waiter
            except asyncio.CancelledError:
                if call.ended is None:
                    call.cancel()
                raise
        outcome = call.outcome
        assert outcome is not None
        if outcome.error is not None:
            raise outcome.error
        return outcome.value

    def over(self, call: Call, value: Any, error: BaseException | None) -> None:
        """Let the end of a call take effect, in its turn."""
        end = End(value, error)
        self._door.end(("call", self.resource), self.ended, call, end)

    def ended(self, call: Call, end: End) -> None:
        """Apply the end of a call: the one place where it takes effect, in the loop.

        Every way that a call can end comes here: its coroutine, its thread. If the
        outcome is out already (the deadline is over, the device was closed, another
        driver has its place), the end is counted and told to ``on_late``, and that is
        all.
        """
        if self.alive.pop(call.number, None) is None:
            return
        if call.taped is not None:
            call.taped(end)
        call.ended = self._time()
        call.engine = None
        if call.outcome is not None:
            self._left.discard(call)
            if call.kind != "stream":
                self.late += 1
            if call.kind == "open" and self.on_late_open:
                self.on_late_open(call, end)
            self._on_late(call)
            call.wake()
            return
        self._rest()
        if end.error is not None:
            end = End(None, self._contained(end.error))
        self._tell(call, end)

    def next_opening(self, error: BaseException) -> None:
        """Fence every call that is alive: they belong to an opening that is over."""
        self.opening += 1
        self.lost = None
        for call in tuple(self.alive.values()):
            if call.outcome is None:
                self._abandon(call, error)

    async def quiet(self, until: float) -> None:
        """Wait until no call is alive, or until a moment."""
        while self.alive and self._time() + REACHED < until:
            await self.next_end(until)

    async def next_end(self, until: float) -> None:
        """Wait until some call that is alive has its outcome or its end, or a moment."""
        waiter: asyncio.Future[None] = self._loop.create_future()
        calls = tuple(self.alive.values())
        for call in calls:
            call.waiters.append(waiter)
        deadline = self._deadlines.after(max(0.0, until - self._time()), wake, waiter)
        try:
            await waiter
        finally:
            deadline.cancel()
            for call in calls:
                if waiter in call.waiters:
                    call.waiters.remove(waiter)

    # Inside.

    def _track(self, kind: str, args: tuple[Any, ...], limit: float | None) -> Call:
        number = self.number
        call = Call(self.resource, kind, self.opening, number, args, self._time())
        self.alive[number] = call
        if limit is not None:
            call.until, call.limit = call.begun + limit, limit
            self._deadline.start_by(call.until)
        return call

    def _rest(self) -> None:
        """Have no deadline if nobody waits for an outcome."""
        if not self.alive or all(each.outcome for each in self.alive.values()):
            self._deadline.cancel()

    def _expire(self) -> None:
        now = self._time() + REACHED
        for call in tuple(self.alive.values()):
            if call.outcome is not None:
                continue
            if call.until > now:
                self._deadline.start_by(call.until)
            else:
                stuck = DriverStuckError(self.resource, call.kind, call.limit)
                self._abandon(call, stuck)

    def _abandon(self, call: Call, error: BaseException) -> None:
        if call.kind != "stream":  # nobody waits for the end of a stream
            self.abandoned += 1
        self._left.add(call)
        if type(call.engine) is ThreadedCall:
            call.engine.expired()
        current = call.opening == self.opening
        if current:
            self._deadlines.after(UNWIND, self._give_up, call)
        self._tell(call, End(None, error), current=current)
        self._rest()
        if call.engine is not None:
            call.engine.cancel()

    def _give_up(self, call: Call) -> None:
        if call.ended is None and call.opening == self.opening:
            self._on_stuck(call)

    def _tell(self, call: Call, end: End, *, current: bool = True) -> None:
        call.outcome = end
        if current and call.apply is not None:
            call.apply(call, end)
        if call.waiters:
            call.wake()

    def _contained(self, error: BaseException) -> Exception:
        """Make an error that may be raised in any task of what the driver has raised."""
        if isinstance(error, Exception) and not isinstance(error, StopIteration):
            return error
        fault = DeviceFaultError(self.resource, describe(error))
        fault.__cause__ = error
        return fault

    def _check_lost(self, kind: str) -> None:
        if self.lost is not None and kind != "close":
            raise self.lost.with_traceback(None)

    def _check_abandoned(self, kind: str) -> None:
        if kind in {"safe", "close"}:
            return
        alive = sum(1 for call in self.alive.values() if call.is_abandoned)
        if alive >= ABANDONED_LIMIT:
            raise DriverStuckError(
                self.resource, f"{kind}: {alive} calls have not ended; one call", UNWIND
            )


class ThreadedCall:
    """A call on a worker thread; what the function returns may have to be awaited."""

    def __init__(
        self, calls: Calls, call: Call, method: Method, guard: Guard | None
    ) -> None:
        assert method.executor is not None
        self.executor = method.executor()
        self._calls = calls
        self._call = call
        self._function = method.function
        self._guard = guard
        self._wanted = True
        self._rest: LightTask | None = None

    def submit(self, loop: asyncio.AbstractEventLoop) -> None:
        args, guard = self._call.args, self._may_begin
        self.executor.submit(loop, self, self._function, *args, guard=guard)

    def _may_begin(self) -> bool:
        if self._calls.lost is not None and self._call.kind != "close":
            return False
        return self._guard is None or (self._wanted and self._guard())

    def cancel(self) -> None:
        self._wanted = False
        if self._rest is not None:
            self._rest.cancel()

    def expired(self) -> None:
        if self._rest is None:
            self.executor.expired()

    # The outcome of the executor.

    def done(self) -> bool:
        return False  # its end is wanted, however late

    def set_result(self, result: Any, /) -> None:
        if not hasattr(result, "__await__"):
            self._calls.ended(self._call, End(result, None))
            return
        rest = self._rest = LightTask(asyncio.get_running_loop(), str(self._call))
        try:
            value = rest.begin(_awaited(result))
        except BaseException as error:  # contained: it is the driver's
            self.set_exception(error)
            return
        if value is WAITS:
            rest.then(partial(self._calls.over, self._call))
        else:
            self._calls.ended(self._call, End(value, None))

    def set_exception(self, error: BaseException, /) -> None:
        if isinstance(error, CallRefused):
            error = self._calls.lost or error
        self._calls.ended(self._call, End(None, error))


async def _awaited(awaitable: Any) -> Any:
    """Wait for what a plain method has returned."""
    return await awaitable


_REST = Method(_awaited, None)
"""What goes on with what a plain method has returned, if that has to be awaited."""
