"""The turn: one border, at which everything takes effect, on every event loop.

A turn is one pass of the loop. At its border what came in takes effect, in the order of
its numbers; then each stepper that is due looks: deadlines and the scheduler, those of the
robot and those of what is outside of it. Between two borders nothing takes effect but what
coroutines on the loop do themselves.

Loops differ in who comes to the border, and in how time passes, in nothing else. A
`TurnLoop` comes there by itself, in its selector, and reads its clock there and nowhere
else: so what the robot does in a turn follows from the time of the turn and from its
entries alone, and a run can be replayed. The virtual loop of the test kit is a subclass
with another way to wait. On any other loop (plain asyncio, uvloop) the border is asked for
by ``call_soon`` and ``call_at``.
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
import heapq
import itertools
import logging
import math
import os
import selectors
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

from esair.loop._budget import LASTS, Budget
from esair.loop._deadlines import Deadlines
from esair.loop._door import Arrivals, Door
from esair.loop._light_task import ignore, raisable, settle
from esair.loop._of_loop import OfLoop, OfTurn
from esair.loop._ownership import current_owner
from esair.loop._scheduler import EARLY, FAR, NEVER, NOW, SECOND, Scheduler
from esair.loop._tape import Player, TapeWriter

_log = logging.getLogger("esair")
_log_of_asyncio = logging.getLogger("asyncio")

Select = Callable[[float | None], Any]


def computer_slept() -> float:
    """Return how long the computer has slept in all, in seconds; 0 if it cannot tell."""
    boot = getattr(time, "CLOCK_BOOTTIME", None)
    return 0.0 if boot is None else time.clock_gettime(boot) - time.monotonic()


class Turn(OfLoop):
    """What the turns of a loop are made of, and the border between them.

    This one is for loops that know nothing of turns: it asks them to come to the border.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self.loop = loop
        self.number: int = 0
        """The number of this turn, since the run began that is kept or repeated."""
        self.due: float = NEVER
        """The earliest moment at which something is to be done, in ns; `NOW`: at once."""
        self.time: Callable[[], float]
        """Reads the clock of the turns, in seconds; in the loop."""
        self.clock: Callable[[], float]
        """Reads the clock amid a turn too, in any thread; see `clock_beside`."""
        self.slept: Callable[[], float] = computer_slept
        """Tells for how long the computer has slept in all, in seconds."""
        self.wait_in_thread: Callable[[float], None] = time.sleep
        """Lets time pass in a thread, in seconds."""
        self.player: Player | None = None
        """What repeats a run on this loop, sooner or later."""
        self.virtual = False
        """Whether time passes only when nothing is left to be done."""
        self.keep: Callable[[TapeWriter | None], object] = ignore
        """Keeps what happens from this turn on, where it can be repeated; None: no more."""
        self.play: Callable[[], object] = ignore
        """Begins to repeat the run that `player` has."""
        self.early = EARLY
        """How far ahead something is due already, in ns; nothing where time jumps."""
        self.listen: Callable[[int, Callable[[], object]], object]
        """Calls a function when a file can be read; just before the border if it can, so
        that what it has for the door takes effect at once."""
        self.forget: Callable[[int], object]
        """Listens to a file no more, that is to be closed."""
        self._timer: asyncio.TimerHandle | None = None
        self._is_asked = False
        self._is_at_border = False
        self._take_over(loop)
        Turn.settle(loop, self)
        self.door: Door = Door(self)
        self.budget: Budget = Budget(self)
        self.robot: Scheduler = Scheduler(self)
        self.outside: Scheduler = Scheduler(self)
        self.deadlines: Deadlines = Deadlines(self, self.robot)
        self.deadlines_outside: Deadlines = Deadlines(self, self.outside)
        Door.settle(loop, self.door)
        Budget.settle(loop, self.budget)
        Scheduler.settle(loop, self.robot)
        Deadlines.settle(loop, self.deadlines)
        # In this order they look.
        inside, outside = self.deadlines, self.deadlines_outside
        self._steppers = (inside, self.robot, outside, self.outside)
        self.suspends: SuspendWatch = SuspendWatch(self)
        """Told when the computer slept, before anything else that is due."""

    def _take_over(self, loop: Any) -> None:
        self.time = self.clock = _clock_of_stranger(loop)
        self.listen, self.forget = loop.add_reader, loop.remove_reader

    @property
    def repeats(self) -> bool:
        """Whether a run of this loop can be repeated from a tape."""
        return False

    def want(self, due: float) -> None:
        """Have the steppers look at a moment, in ns; called in the loop."""
        if due < self.due:
            self.due = due
            self._ask()

    def expect(self) -> None:
        """The door has news: come to the border soon; called in the loop."""
        self.want(NOW)

    def border(self, now: float) -> None:
        """Let what came in take effect, and have those look who are due."""
        self.budget.late = now + LASTS
        door = self.door
        if door.entries or door.wakes:  # hot
            door.take()
        reached = round(now * SECOND) + self.early
        if self.due > reached:
            return  # most passes end here
        self.suspends.look()
        for each in self._steppers:
            if each.due <= reached:
                each.look(reached)
        first, second, third, fourth = self._steppers
        self.due = min(first.due, second.due, third.due, fourth.due)  # hot

    def is_due(self, now: float) -> bool:
        """Tell whether something is to be done at a border now."""
        return self.due <= round(now * SECOND) + self.early

    def gap(self) -> float:
        """Tell for how long nothing is due, in seconds."""
        if self.door.has_news:
            return 0.0
        return min(each.gap() for each in self._steppers)

    def has_lasted(self) -> bool:
        """Tell whether this turn has begun as long ago as its budget says.

        Such a loop does not say when a pass begins: it counts from the first who asks.
        """
        return self.budget.is_counted or self.count()

    def count(self) -> bool:
        """Count what this turn takes from now on; it has not lasted long."""
        self.budget.late = self.clock() + LASTS
        self.budget.is_counted = True
        self.loop.call_soon(setattr, self.budget, "is_counted", False)
        return False

    def ring(self) -> None:
        """Have the loop come to the border, from any thread.

        Raises:
            RuntimeError: The loop is closed.
        """
        self.loop.call_soon_threadsafe(self.come)

    def come(self) -> None:
        """Be at the border: the loop has come."""
        self._is_asked = False
        self._is_at_border = True  # what is wanted in it is asked for at its end
        self.number += 1
        try:
            self.border(self.time())
        finally:
            self._is_at_border = False
            self._ask()

    def _ask(self) -> None:
        """Ask the loop to come when something is due."""
        if self._is_asked or self._is_at_border:
            return
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        if self.due == NOW:
            self._is_asked = True
            self.loop.call_soon(self.come)
        elif self.due < NEVER:
            self._timer = self.loop.call_at(self.due / SECOND, self.come)


OfTurn.made_by = Turn.of


class OwnTurn(Turn):
    """The turns of a loop that comes to the border by itself."""

    def ring(self) -> None:
        """Wake the selector, from any thread."""
        self.loop.ring()  # type: ignore[attr-defined]

    def _take_over(self, loop: TurnLoop) -> None:
        self.time, self.clock, self.slept = loop.time, loop.clock, loop.slept
        self.wait_in_thread = loop.wait_in_thread
        self.player, self.virtual = loop.player, loop.virtual
        self.early = 0 if loop.virtual else EARLY
        self.keep, self.play = loop.keep, loop.play
        self.listen, self.forget = loop.listen, loop.forget

    @property
    def repeats(self) -> bool:
        return not self.virtual

    def has_lasted(self) -> bool:
        return not self.virtual or self.budget.is_of_one()

    def count(self) -> bool:
        """Count what this turn takes: it does so from its border on."""
        return False

    def want(self, due: float) -> None:
        """Have the steppers look at a moment, in ns: the selector does."""
        if due < self.due:
            self.due = due

    def expect(self) -> None:
        """The door has news: the selector does not wait."""

    def come(self) -> None:
        """Have been woken: the border is in the selector."""


class When(float):
    """The moment of a timer; among equal moments the first one made comes first.

    Equal moments are usual where the clock stands still in a turn, and a heap keeps no
    order among equals: it would depend on timers of drivers, which a replay has not.
    """

    __slots__ = ("number",)
    number: int

    def __lt__(self, other: float) -> bool:
        if float(self) == float(other) and isinstance(other, When):
            return self.number < other.number
        return float(self) < float(other)


class NamedHandle(asyncio.Handle):
    """A handle that says how long it took, in debug mode.

    asyncio itself measures by the clock of the loop, which stands still in a turn.
    """

    __slots__ = ()

    def _run(self) -> None:
        began = time.monotonic()
        super()._run()
        loop: Any = self._loop  # type: ignore[attr-defined]
        took = time.monotonic() - began
        if took >= loop.slow_callback_duration:
            who = getattr(self._callback, "__self__", None)  # type: ignore[attr-defined]
            who = who if isinstance(who, asyncio.Task) else self
            _log_of_asyncio.warning("Executing %r took %.3f seconds", who, took)


class TurnLoop(asyncio.SelectorEventLoop):
    """The event loop of `esair.run`: what happens in it can be kept and repeated."""

    virtual = False
    """Whether time jumps instead of passing."""

    def __init__(self, *, player: Player | None = None) -> None:
        self.player = player
        """What repeats a run on this loop, sooner or later."""
        self._plays = False
        self._tape: TapeWriter | None = None
        self._shift = 0.0
        if player is not None:
            self._shift = player.began - time.monotonic()
        elif type(self).clock is TurnLoop.clock:
            self.clock = time.monotonic  # type: ignore[method-assign]  # hot
        self._now = self.clock()
        self._timers = itertools.count()
        self._works = itertools.count(1)
        selector: Any = selectors.DefaultSelector()
        super().__init__(selector)
        bell = self._ssock.fileno()  # type: ignore[attr-defined]
        self._listens = {bell: self._read_from_self}  # type: ignore[attr-defined]
        self._rises: bool = False  # it is on its way to the border: nobody has to ring
        self._turn = OwnTurn(self)
        self._alarm = None if self.virtual else Alarm.on(self)
        self._select: Select = selector.select
        selector.select = self._pass  # the border is there

    @property
    def turn(self) -> int:
        """The number of this turn, since the run began that is kept or repeated."""
        return self._turn.number

    def keep(self, tape: TapeWriter | None) -> None:
        """Keep what happens from this turn on; None: no more."""
        if self._tape is not None:
            self._tape.close()
        self._tape = self._turn.door.tape = tape
        if tape is not None:
            self._turn.number = 0
            self._turn.budget.keep()
            tape.turn(self._now)

    def play(self) -> None:
        """Begin to repeat the run, in the turn in which its keeping began."""
        player = self.player
        assert player is not None
        self._plays = True
        self._turn.number = 0
        self._now = player.began
        self._turn.door.tape = player
        self._turn.budget.play()
        player.begin(self._turn.door)

    def time(self) -> float:
        """Return when this turn began, in seconds of the monotonic clock."""
        return self._now

    def clock(self) -> float:
        """Return the time amid a turn too, in any thread."""
        return time.monotonic() + self._shift

    slept = staticmethod(computer_slept)

    def wait_in_thread(self, seconds: float) -> None:
        """Let time pass in a thread that works for a robot, and wait for that."""
        time.sleep(seconds)

    def listen(self, file: int, function: Callable[[], object]) -> None:
        """Call a function when a file can be read, before the border."""
        self._selector.register(file, selectors.EVENT_READ)  # type: ignore[attr-defined]
        self._listens[file] = function

    def forget(self, file: int) -> None:
        """Listen to a file no more; fine if it is not listened to."""
        if self._listens.pop(file, None) is not None:
            self._selector.unregister(file)  # type: ignore[attr-defined]

    def ring(self) -> None:
        """Wake the selector, from any thread."""
        if self._rises:
            return
        alarm = self._alarm
        if alarm is None or not alarm.ring():
            self._check_closed()  # type: ignore[attr-defined]
            self._write_to_self()  # type: ignore[attr-defined]

    def close(self) -> None:
        """Close the loop; what was to be done in it is not done."""
        if self._alarm is not None:
            self._alarm.close()
            self._alarm = None
        super().close()

    def call_at(  # type: ignore[override]
        self, when: float, callback: Any, *args: Any, context: Any = None
    ) -> asyncio.TimerHandle:
        """Call a function at a moment; functions of one moment in the order of calls."""
        moment = When(when)
        moment.number = next(self._timers)
        return super().call_at(moment, callback, *args, context=context)

    def first_timer(self) -> float:
        """Return when the first timer of asyncio is due, in seconds."""
        scheduled = self._scheduled  # type: ignore[attr-defined]
        while scheduled and scheduled[0]._cancelled:  # noqa: SLF001 - as asyncio does
            heapq.heappop(scheduled)._scheduled = False  # noqa: SLF001
            count = self._timer_cancelled_count  # type: ignore[has-type]
            self._timer_cancelled_count = max(0, count - 1)
        return float(scheduled[0].when()) if scheduled else NEVER

    def set_debug(self, enabled: bool) -> None:
        """Begin or cease to look closer at what runs; slow callbacks are named."""
        super().set_debug(enabled)
        vars(self).pop("_call_soon", None)
        if enabled:
            self._call_soon = self._call_named

    def _call_named(self, callback: Any, args: Any, context: Any) -> asyncio.Handle:
        handle = NamedHandle(callback, args, self, context)
        self._ready.append(handle)  # type: ignore[attr-defined]
        return handle

    def run_in_executor(  # type: ignore[override]
        self, executor: Any, func: Callable[..., Any], *args: Any
    ) -> asyncio.Future[Any]:
        """Run a function in a thread; if a component asks, its end comes by the door."""
        if current_owner() is None:
            return super().run_in_executor(executor, func, *args)
        future: asyncio.Future[Any] = self.create_future()
        tag = ("thread", f"work {next(self._works)}")

        def work() -> None:
            result: Any = None
            error: BaseException | None = None
            try:
                result = func(*args)
            except BaseException as raised:  # contained, as in a task
                error = raisable(raised, "the behavior")
            with contextlib.suppress(RuntimeError):  # the loop is closed
                self._turn.door.post(0, tag, settle, future, result, error)

        inner = super().run_in_executor(executor, work)
        if self.player is None:  # what had begun when it was recorded has its end there
            future.add_done_callback(lambda done: done.cancelled() and inner.cancel())
        return future

    async def shutdown_default_executor(self, *args: Any, **options: Any) -> None:
        """End the threads of `run_in_executor`; no time is hurried on meanwhile."""
        self._plays = False
        await super().shutdown_default_executor(*args, **options)

    def _pass(self, timeout: float | None = None) -> Any:
        """Wait for the next turn, and be at its border."""
        if self._plays:
            return self._replay(timeout)
        events = self._wait(timeout)
        turn = self._turn
        turn.number += 1
        now = self._now = self.clock()
        if self._tape is not None:
            self._tape.turn(now)
        turn.border(now)
        return events

    def _wait(self, timeout: float | None) -> Any:
        turn = self._turn
        if turn.door.entries or turn.door.wakes:  # hot
            timeout = 0.0
        elif timeout is None or timeout > 0.0:
            now = self.clock()
            gap = (turn.due - EARLY) / SECOND - now
            if timeout is not None:  # asyncio counts from the beginning of the turn
                timeout = max(0.0, timeout - (now - self._now))
            if gap <= 0.0:
                timeout = 0.0
            elif self._alarm is not None and not self._shift:
                self._alarm.set(turn.due)
            elif gap < NEVER:
                timeout = gap if timeout is None else min(timeout, gap)
        events = self._select(timeout)
        return self._others(events) if events else events  # hot

    def _others(self, events: Any) -> Any:
        """Return what there is for asyncio; what is listened to is heard."""
        if events:
            listens = self._listens
            self._rises = True
            try:
                for each in tuple(events):
                    key = each[0]
                    function = listens.get(key.fd)
                    if function is None and key.data is not None:
                        continue
                    events.remove(each)
                    if function is None:
                        continue  # one that was heard before has forgotten it
                    try:
                        function()
                    except Exception as error:  # hot: `contained` is one more call
                        told = {"message": "a listener raised", "exception": error}
                        self.call_exception_handler(told)
            finally:
                self._rises = False
        return events

    def _replay(self, timeout: float | None) -> Any:
        turn, player = self._turn, self.player
        assert player is not None
        events = self._others(self._select(0.0))
        turn.number += 1
        moment = None if player.is_over else player.next_turn()
        if moment is not None:
            self._now = moment
            with Arrivals.of(self):  # as the door does
                player.take()
        else:
            player.end()
            events = [*events, *self._hurry(timeout)]
        turn.border(self._now)
        return events

    def _hurry(self, timeout: float | None) -> Any:
        """Nothing is repeated any more: time goes to what is next, without a wait."""
        turn = self._turn
        gap = max(0.0, min(turn.gap(), math.inf if timeout is None else timeout))
        if gap == 0.0:
            return ()
        events = self._others(self._select(0.001))  # what threads still do
        if not (events or turn.door.has_news) and gap < math.inf:
            self._now += gap
        return events


class Alarm:
    """Ends the wait of a selector: at a moment, or when a thread rings.

    By itself a selector rounds a moment up to a millisecond; Linux's timerfd ends its wait
    some 50 us after it. To ring by an eventfd costs the loop a third of asyncio's own way:
    that reads a socket until an exception says that there is no more.
    """

    def __init__(self, loop: TurnLoop) -> None:
        self._lock = threading.Lock()
        self._timer, self._settime = timerfd()
        self._due: float = NEVER
        try:
            self._bell = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        except OSError:
            os.close(self._timer)
            raise
        loop.listen(self._timer, self._silence)
        loop.listen(self._bell, functools.partial(os.eventfd_read, self._bell))

    @classmethod
    def on(cls, loop: TurnLoop) -> Alarm | None:
        """Return one that wakes a loop; None if this system has none."""
        try:
            return cls(loop)
        except (OSError, NotImplementedError, AttributeError):
            return None

    def set(self, due: float) -> None:
        """End the wait at a moment, in ns, and at no other."""
        if due != self._due:
            when = 0 if due == NEVER else max(1, int(min(due, FAR * SECOND)))
            self._settime(when)
            self._due = due

    def ring(self) -> bool:
        """End the wait now, from any thread; false if the loop is closed."""
        with self._lock:  # a number that was closed may be another file's
            if self._bell < 0:
                return False
            os.eventfd_write(self._bell, 1)
            return True

    def _silence(self) -> None:
        self._settime(0)
        self._due = NEVER

    def close(self) -> None:
        with self._lock:
            os.close(self._bell)
            os.close(self._timer)
            self._bell = -1


def _clock_of_stranger(loop: asyncio.AbstractEventLoop) -> Callable[[], float]:
    """Return the best function that reads a loop's clock, in seconds.

    That of uvloop stands still between its turns and counts whole milliseconds.
    """
    kind = type(loop)
    if kind.time is asyncio.BaseEventLoop.time or kind.__module__ == "uvloop":
        return time.monotonic  # what they read
    return loop.time


def new_event_loop() -> asyncio.AbstractEventLoop:
    """Make an event loop of the kind that `esair.run` uses.

    On any other loop a robot does the same, but its recordings are not exact. It is a
    loop factory for `asyncio.Runner`, for `asyncio.run` (Python 3.12) and for plugins
    of pytest.

    Example:
        >>> with asyncio.Runner(loop_factory=esair.new_event_loop) as runner:
        ...     runner.run(main())
    """
    return TurnLoop()


JUMP = 0.1  # from how many seconds of sleep on everything that is known counts as old

GLANCE = 0.25
"""How often a robot looks whether the computer slept, if nothing else is due, in s."""

_TAG = ("computer", "slept")


class SuspendWatch:
    """Tells who listens when the computer was suspended, and for how long.

    It compares the clock that goes on while the computer sleeps with the one that
    does not. It looks at each border where something is due, so listeners hear of a
    sleep before the next step.
    """

    def __init__(self, turn: Turn) -> None:
        self._slept = turn.slept
        self._door = turn.door
        if self._door.player is not None:
            self._door.player.listen(_TAG, self._woke)
        self._before = max(self._slept() for _ in range(3))
        self._listeners: tuple[Callable[[float], None], ...] = ()

    def listen(self, listener: Callable[[float], None]) -> None:
        """Call a function with the seconds of each sleep."""
        self._listeners = (*self._listeners, listener)

    def forget(self, listener: Callable[[float], None]) -> None:
        """Call the function no more."""
        self._listeners = tuple(each for each in self._listeners if each != listener)

    def look(self) -> None:
        """Find out whether the computer slept since the last look."""
        slept = self._slept() - self._before
        if slept <= 0.0:
            return  # a pause between the readings makes it smaller, never larger
        self._before += slept
        if slept > JUMP and self._door.player is None:
            if isinstance(self._door.tape, TapeWriter):
                self._door.tape.arrived(_TAG, slept)
            self._woke(slept)

    def _woke(self, slept: float) -> None:
        _log.warning("the computer slept for %.1f s: all readings are old", slept)
        for listener in self._listeners:
            listener(slept)


def timerfd() -> tuple[int, Callable[[int], object]]:
    """Return a new timer of Linux, and what sets it to a moment of the clock, in ns.

    Raises:
        OSError: The kernel gives none.
    """
    monotonic, absolute = 1, 1
    flags = os.O_NONBLOCK | getattr(os, "O_CLOEXEC", 0)
    if sys.version_info >= (3, 13):
        own = os.timerfd_create(monotonic, flags=flags)
        return own, lambda when: os.timerfd_settime_ns(
            own, flags=absolute, initial=when
        )
    import ctypes  # only when something runs

    libc = ctypes.CDLL(None, use_errno=True)
    itimerspec = ctypes.c_long * 4  # interval s, ns; value s, ns
    fd: int = libc.timerfd_create(monotonic, flags)
    if fd < 0:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))

    def settime(when: int) -> None:
        spec = itimerspec(0, 0, *divmod(when, SECOND))
        libc.timerfd_settime(fd, absolute, spec, None)

    return fd, settime
