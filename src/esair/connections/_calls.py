"""The calls of one driver: each has a number, a deadline and one outcome.

A `Driver` says how a resource's methods are called (in the loop, or on the thread of its
bus), a `Call` is one that waits, and `translate` says what a driver's error means.
"""

from __future__ import annotations

import asyncio
import errno
import functools
import inspect
import math
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import attrs

from esair.exceptions import (
    BusyError,
    DeviceFaultError,
    DeviceLostError,
    DriverStuckError,
    EsairError,
    NoTurnError,
    describe,
)
from esair.loop import (
    COMMAND,
    ENDED,
    LASTS,
    REACHED,
    WAITS,
    Caller,
    CallRefused,
    Deadline,
    Deadlines,
    Door,
    Executor,
    First,
    FirstSteps,
    LightTask,
    Order,
    Player,
    TapeWriter,
    Urgency,
    clock_of,
    current_task_of,
    current_tasks,
    leave_line,
    raisable,
    waits_in_line,
    wake,
)
from esair.messages import Stamped
from esair.resources import Actuator, Resource

OPERATE = "operate"
"""How the calls of operations are named; the operation's name comes after it."""

_GONE = frozenset(
    {errno.ENODEV, errno.ENOENT, errno.ENOTCONN, errno.ESHUTDOWN, errno.EBADF}
)

Guard = Callable[[], bool]


@attrs.frozen
class Method:
    """A method of a driver, and where it is called."""

    function: Callable[..., Any]
    executor: Callable[[], Executor] | None
    """Returns the thread that calls it; None if it is called in the loop."""
    name: str = ""
    is_plain: bool = False  # a plain function that is called in the loop
    is_usual: bool = attrs.field(init=False)  # a coroutine function, as most are

    @is_usual.default
    def _find_usual(self) -> bool:
        return self.executor is None and not self.is_plain

    def bound(self, /, **options: Any) -> Method:
        """Return the same with keyword arguments."""
        return attrs.evolve(self, function=functools.partial(self.function, **options))


class Driver:
    """The calls of one resource: in the loop, or on the executor of its bus."""

    def __init__(self, resource: Resource) -> None:
        self.resource = resource
        self.uses_threads: bool = resource.bus is not None
        """Whether a thread may have had any of its calls."""
        moves = isinstance(resource, Actuator)
        self.urgency: Urgency = Urgency(COMMAND if moves else 0)
        """How urgent is what it waits for on its bus."""
        self._own_executor: Executor | None = None
        self._stream_executor: Executor | None = None

    @property
    def executor(self) -> Executor:
        """The thread for blocking methods: the bus's, or one of its own."""
        if self.resource.bus is not None:
            executor: Executor = self.resource.bus.executor
            return executor
        if self._own_executor is None:
            self._own_executor = Executor(self.resource.name)
        return self._own_executor

    @property
    def is_stuck(self) -> bool:
        """Whether a blocking call has not returned within its deadline."""
        bus = self.resource.bus
        executor = self._own_executor if bus is None else bus.executor
        return executor is not None and executor.stuck_since is not None

    async def stream_executor(self) -> Executor:
        """Return the one thread that waits for the next value of a blocking stream."""
        resource = self.resource
        executor = self._stream_executor
        if executor is None:
            executor = self._stream_executor = Executor(f"{resource.name}_stream")
        if executor.stuck_since is not None:  # and one more thread would not help
            raise DriverStuckError(resource.name, "stream", resource.deadline)
        await executor.call(_nothing, timeout=resource.deadline)
        return executor

    async def end_executors(self, timeout: float) -> bool:
        """End the resource's own threads; tells whether they have ended in time."""
        executors = filter(None, (self._own_executor, self._stream_executor))
        return all(await asyncio.gather(*(each.join(timeout) for each in executors)))

    def method(self, name: str) -> Method:
        """Return a method, to be called where it belongs."""
        function = getattr(self.resource, name)
        is_plain = not inspect.iscoroutinefunction(function)
        if is_plain and self.resource.blocking:
            self.uses_threads = True
            return Method(function, lambda: self.executor, name)
        return Method(function, None, name, is_plain)

    async def call(self, name: str, *args: Any, **options: Any) -> Any:
        """Call a method where it belongs, and wait for what it returns."""
        method = self.method(name)
        function = functools.partial(method.function, *args, **options)
        if method.executor is None:
            result = function()
        else:
            executor, limit = method.executor(), self.resource.deadline
            result = await executor.call(function, timeout=limit)
        return await result if inspect.isawaitable(result) else result


def _nothing() -> None:
    """Come after all calls that were made before."""


def stamped(value: Any, ended: float | None, now: float) -> Any:
    """Return what was brought from beside, with its time if that is a turn ago or more."""
    if ended is None or now - ended < LASTS:
        return value
    if type(value) is not Stamped:
        return Stamped(value, ended)
    return value if value.time is not None else Stamped(value.value, ended - value.age)


def is_loss(error: BaseException) -> bool:
    """Tell whether an error of a driver means that its device is gone."""
    if isinstance(error, ConnectionError | EOFError | FileNotFoundError):
        return True
    return isinstance(error, OSError) and error.errno in _GONE


def translate(resource: str, error: BaseException) -> EsairError:
    """Turn whatever a driver raised into the error that its caller gets."""
    if isinstance(error, DeviceFaultError | DriverStuckError):
        return error
    if isinstance(error, DeviceLostError) and error.resource == resource:
        return error
    translated: EsairError
    if is_loss(error):
        translated = DeviceLostError(resource, describe(error))
    elif isinstance(error, BusyError):  # of its bus: the device was not asked
        translated = NoTurnError(resource, "a call", 0.0)
    else:
        translated = DeviceFaultError(resource, describe(error))
    translated.__cause__ = error
    return translated


def translate_call(
    resource: str, kind: str, limit: float, error: BaseException
) -> EsairError:
    """Turn what came of a call into the error that its caller gets."""
    if isinstance(error, TimeoutError) and not isinstance(error, EsairError):
        stuck = DriverStuckError(resource, kind, limit)
        stuck.__cause__ = error
        return stuck
    return translate(resource, error)


class End(NamedTuple):
    """What came of a call: a value, or an error."""

    value: Any
    error: BaseException | None


Apply = Callable[["Call", End], None]


@attrs.define(eq=False, repr=False)
class Call:
    """One call of a driver that waits; one that ends in its first step is over at once."""

    resource: str
    kind: str  # what was called: read, write, safe, open, close, apply, identify
    opening: int  # the opening of the device that it belongs to
    number: int  # higher than that of all calls of this driver before
    args: tuple[Any, ...]
    begun: float  # when, on the loop's clock
    apply: Apply | None = None
    ended: float | None = None
    """When the driver's code has ended; None while it is alive."""
    outcome: End | None = None
    """What its caller was told; None while nobody was told anything."""
    cancelled: bool = False  # its caller has gone; what it still does is nobody's fault
    withdrawn: bool = False  # before its turn on the bus came: then it is refused
    owner: object = None  # the right by which it was begun, if it needs one
    takes_over: bool = False  # another's motion stands until it has landed
    engine: LightTask | ThreadedCall | None = None
    until: float = math.inf  # when its time is over, on the loop's clock
    limit: float = math.inf  # for how many seconds that was
    waiters: list[asyncio.Future[None]] = attrs.field(factory=list)
    taped: Callable[[End], None] | None = None  # keeps its end, where a run is recorded

    @property
    def is_abandoned(self) -> bool:
        """Whether its caller was told an outcome while it is still alive."""
        return self.ended is None and self.outcome is not None

    @property
    def may_move(self) -> bool:
        """Whether it may move an actuator: a command, also the safe one; an operation."""
        return self.kind in {"write", "safe"} or self.kind.startswith(OPERATE)

    def cancel(self) -> None:
        """Ask the driver to end it; a thread cannot be asked."""
        self.cancelled = True
        self.stop()

    def withdraw(self) -> None:
        """Have it refused if it still waits for a turn, which another can have."""
        if self.engine is not None and waits_in_line(self.engine):
            self.withdrawn = True
            self.stop()

    def stop(self) -> None:
        """Ask the driver to end it; what waits in a line then is never begun.

        But for what makes safe, or closes: that goes on, whoever waits for it.
        """
        if self.kind not in {"safe", "close"}:
            leave_line(self.engine)
        if self.engine is not None:
            self.engine.cancel()

    def wake(self) -> None:
        """Let those go on who wait for its outcome, or its end."""
        waiters, self.waiters = self.waiters, []
        wake(*waiters)

    def __str__(self) -> str:
        what = ", ".join(f"{each!r:.40}" for each in self.args)
        return f"{self.kind} {self.number}" + (f" ({what})" if what else "")


class GivenUpError(DeviceLostError):
    """The robot closes a device that is there: it may move still, and obey."""


def given_up(call: Call) -> GivenUpError:
    """Make the error for a device whose driver does not end a call."""
    return GivenUpError(call.resource, f"{call} was given up and does not end")


UNWIND = 0.1
"""How long a call that was given up may take to end, before its device is closed, in s."""

ABANDONED_LIMIT = 8
"""How many abandoned calls of one device may be alive; with so many, none is begun."""


@attrs.define(eq=False)
class Calls:
    """The calls of one driver. Their numbers, and those of the openings, only grow.

    A call has one outcome, within its deadline, whatever the driver does with a
    cancellation: then it is abandoned, listed and counted, and nothing that it does
    later has an effect, but that whoever owns it hears of its end (``on_late``).
    """

    driver: Driver
    _loop: asyncio.AbstractEventLoop
    _on_late: Callable[[Call], None] = attrs.field(kw_only=True)
    _on_stuck: Callable[[Call], None] = attrs.field(kw_only=True)
    _left: set[Call] = attrs.field(kw_only=True)
    resource: str = attrs.field(init=False)
    time: Callable[[], float] = attrs.field(init=False)
    caller: Caller = attrs.field(init=False)
    """What the driver's first steps run in, so that it belongs to nobody."""
    _deadlines: Deadlines = attrs.field(init=False)
    _deadline: Deadline = attrs.field(
        init=False
    )  # of the call whose time is over first
    _door: Door = attrs.field(init=False)
    _steps: FirstSteps = attrs.field(init=False)
    opening: int = 0
    number: int = 0  # of the newest call that waits, or has waited
    alive: dict[int, Call] = attrs.field(factory=dict)
    """The calls whose driver's code has not ended, by number."""
    abandoned: int = 0  # how many calls have had their outcome before they ended
    late: int = 0  # how many of them have ended since, without an effect
    lost: EsairError | None = None
    """What each call of this opening meets, from when the device was told to be lost
    until that takes effect at the border of a turn. It is an outcome of the calls, which
    a replay can repeat; a state that changes amid a turn is not."""
    on_late_open: Apply | None = None
    """Told of an opening that has ended after it was given up."""

    def __attrs_post_init__(self) -> None:
        loop, self.resource = self._loop, self.driver.resource.name
        self.time = clock_of(loop)
        self._deadlines = Deadlines.of(loop)
        self._deadline = self._deadlines.idle(self._expire)
        self._door = Door.of(loop)
        self._steps = FirstSteps.of(loop)
        self.caller = Caller(f"{self.resource} driver", self.driver.urgency)

    def begin(
        self,
        kind: str,
        method: Method,
        args: tuple[Any, ...],
        limit: float | None,
        guard: Guard | None = None,
    ) -> Any:
        if self.alive and len(self.alive) >= ABANDONED_LIMIT:
            self._check_abandoned(kind)
        if self._door.tape is not None:
            return self._begin_taped(self._door.tape, kind, method, args, limit, guard)
        if self.lost is not None and kind != "close":
            raise self.lost.with_traceback(None)
        if method.is_plain:
            try:
                value = self.caller.context.run(method.function, *args)
            except BaseException as error:
                raise raisable(error, "the driver") from error.__cause__
            if value is None or not hasattr(value, "__await__"):
                return value
            method, args = _REST, (value,)
        light = self._steps.spare
        if light.caller is not None or not method.is_usual:
            return self._begin_untaped(kind, method, args, limit, guard)
        # Most calls are these, and end here: it is `FirstSteps.begin` in its place.
        light.caller = self.caller
        loop = self._loop
        caller = current_task_of(loop)
        current_tasks[loop] = light
        waits_for: Any = None
        try:
            coroutine = method.function(*args)
            waits_for = self.caller.context.run(light.send, coroutine)
        except BaseException as error:
            contained = raisable(error, "the driver")
            raise contained from contained.__cause__
        finally:
            if caller is None:
                del current_tasks[loop]
            else:
                current_tasks[loop] = caller
            if waits_for is ENDED and not light._num_cancels_requested:  # noqa: SLF001 - the name that anyio looks at
                light.caller = None
            else:
                self._steps.spare = LightTask(loop)
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
        if self.lost is not None and kind != "close":
            raise self.lost.with_traceback(None)
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
                value = self.caller.context.run(method.function, *args)
                if value is None or not hasattr(value, "__await__"):
                    return value
                coroutine = _awaited(value)
            else:
                coroutine = method.function(*args)
            value = self._steps.begin(coroutine, self.caller)
        except BaseException as error:
            contained = raisable(error, "the driver")
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
            tape.first(tag, First(error=error))
            raise
        if type(value) is not Call:
            tape.first(tag, First(value=value))
            return value
        number = tape.first(tag, First(waits=True))
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

    def withdraw_at(self, moment: float, call: Call) -> None:
        """Have a call refused that still waits for its turn on the bus at a moment."""
        if moment < call.until:  # it has its outcome by then, and may be forgotten
            self._deadlines.at(moment, call.withdraw, order=Order.EXPIRY)

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
        if call.withdrawn and isinstance(end.error, asyncio.CancelledError):
            end = End(None, CallRefused())
        if call.taped is not None:
            call.taped(end)
        call.ended = self.time()
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
            end = End(None, raisable(end.error, "the driver"))
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
        while self.alive and self.time() + REACHED < until:
            waiter: asyncio.Future[None] = self._loop.create_future()
            calls = tuple(self.alive.values())
            for call in calls:
                call.waiters.append(waiter)
            try:
                await self._deadlines.pulse(waiter, until - self.time())
            finally:
                for call in calls:
                    if waiter in call.waiters:
                        call.waiters.remove(waiter)

    # Inside.

    def _track(self, kind: str, args: tuple[Any, ...], limit: float | None) -> Call:
        number = self.number = self.number + 1
        call = Call(self.resource, kind, self.opening, number, args, self.time())
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
        now = self.time()
        for call in tuple(self.alive.values()):
            if call.outcome is not None:
                continue
            if now + REACHED < call.until:
                self._deadline.start_by(call.until)
            else:
                in_line = waits_in_line(call.engine, call.limit / 2)
                late = NoTurnError if in_line else DriverStuckError
                self._abandon(call, late(self.resource, call.kind, call.limit))

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
        call.stop()

    def _give_up(self, call: Call) -> None:
        begun = not waits_in_line(call.engine)
        if call.ended is None and begun and call.opening == self.opening:
            self._on_stuck(call)

    def _tell(self, call: Call, end: End, *, current: bool = True) -> None:
        call.outcome = end
        if current and call.apply is not None:
            call.apply(call, end)
        if call.waiters:
            call.wake()

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
        self.executor: Executor = method.executor()
        self._calls = calls
        self._call = call
        self._function = method.function
        self._guard = guard
        self._wanted = True
        self._rest: LightTask | None = None
        self.begun: float | None = None
        self.ended: float | None = None

    def submit(self, loop: asyncio.AbstractEventLoop) -> None:
        args, guard = self._call.args, self._may_begin
        urgent = self._calls.driver.urgency
        self.executor.submit(
            loop, self, self._function, *args, guard=guard, urgent=urgent
        )

    def _may_begin(self) -> bool:
        kind = self._call.kind
        if self._calls.lost is not None and kind != "close":
            return False
        # Who has asked was told that it failed, and there may be a successor by now.
        if not self._wanted and kind not in {"safe", "close"}:
            return False
        return self._guard is None or self._guard()

    def cancel(self) -> None:
        self._wanted = False
        if self._rest is not None:
            self._rest.cancel()

    def expired(self) -> None:
        if self._rest is None and self.begun is not None:
            self.executor.expired()

    # The outcome of the executor.

    def done(self) -> bool:
        return False  # its end is wanted, however late

    def set_result(self, result: Any, /) -> None:
        if not hasattr(result, "__await__"):
            if self._call.kind == "read":
                result = stamped(result, self.ended, self._calls.time())
            self._calls.ended(self._call, End(result, None))
            return
        rest = self._rest = LightTask(
            asyncio.get_running_loop(), str(self._call), self._calls.caller.fresh()
        )
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
