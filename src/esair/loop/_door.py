"""The one door: what comes in from outside takes effect in one order.

Entries take effect in the order in which they come in, at the next border of the loop. On a
virtual clock what comes from threads ripens before: news when nothing is ready, ends of
works when no thread is at work either, in the order in which the work was given out. So a
run repeats, however long threads take.

What one callback of the loop brings is an `Arrivals`: driver calls that wait for it go on
in that callback. What a robot asks of the world beside its drivers (`outside`,
`ask_outside`, `News`) is kept, and answered from the tape.
"""

from __future__ import annotations

import asyncio
import collections
import contextvars
import itertools
import logging
import threading
from collections.abc import Callable, Coroutine
from operator import itemgetter
from typing import TYPE_CHECKING, Any, TypeVar

from esair.loop._light_task import LightTask, current_task_of, settle
from esair.loop._of_loop import OfLoop, OfTurn
from esair.loop._ownership import Contained
from esair.loop._scheduler import contained
from esair.loop._tape import WAITS, Entry, First, Player, Tag, TapeWriter

if TYPE_CHECKING:
    from esair.loop._turn import Turn


T = TypeVar("T")


_Arrived = list[tuple[asyncio.Future[Any], Any, tuple[Any, contextvars.Context]]]
"""What somebody waits for, the value, and how who waits goes on."""


class Arrivals(OfLoop):
    """All that one callback of the loop brings from outside.

    A call of a driver that waits for some of it goes on in that very callback, and needs no
    turn of the loop for that; but only when all of it is there, so that nothing that came
    before it went on is taken for what came after it.

    Example:
        >>> with Arrivals.of(loop):
        ...     for message in framing.feed(data):
        ...         deliver(message)  # calls `arrive`
    """

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._depth = 0
        self.so_far: _Arrived | None = None
        """What has arrived; None where a task runs, as no other can go on in it."""

    def __enter__(self) -> None:
        self._depth += 1
        if self._depth == 1 and current_task_of(self._loop) is None:
            self.so_far = []

    def __exit__(self, _: object, error: BaseException | None, *__: object) -> None:
        so_far = self.so_far
        try:
            if self._depth == 1 and so_far is not None:
                self.so_far = made_of_it = _Arrived()
                if so_far:
                    self._go_on(so_far)
                self.so_far = None  # else who is answered at once would never give way
                if made_of_it:
                    self._go_on(made_of_it)
        finally:
            self._depth -= 1
            if not self._depth:
                self.so_far = None

    def _go_on(self, arrived: _Arrived) -> None:
        for future, value, (step, context) in arrived:
            if not future.done():
                future.remove_done_callback(step)
                future.set_result(value)
                contained(self._loop, context.run, step, future)


def arrive(future: asyncio.Future[T], value: T) -> None:
    """Bring what a future waits for; fine if nobody wants it any more."""
    if future.done():
        return
    loop = future.get_loop()
    arrivals = vars(loop).get("_esair_Arrivals") or Arrivals.of(loop)  # hot
    callbacks: Any = future._callbacks  # noqa: SLF001 - the protocol of futures
    if (
        callbacks
        and arrivals.so_far is not None
        and isinstance(getattr(callbacks[0][0], "__self__", None), LightTask)
    ):
        arrivals.so_far.append((future, value, callbacks[0]))
        return
    future.set_result(value)  # who waits goes on in the next turn


_log = logging.getLogger("esair")

_new = tuple.__new__
"""Makes an entry of what is in the right order, in half of the time."""


class Door(OfTurn):
    """Where what threads have done comes into a loop. One for each event loop.

    However many entries there are, one wake-up of the loop is under way at a time:
    what comes in until the loop gets to it goes with it.
    """

    def __init__(self, turn: Turn) -> None:
        self._turn = turn
        self._arrivals = Arrivals.of(turn.loop)
        self.player: Player | None = turn.player
        """What repeats a run on this loop, sooner or later."""
        self.holds: bool = turn.virtual
        """Whether time waits for threads."""
        self.tape: TapeWriter | Player | None = None
        """What keeps or gives what comes in, where a run can be repeated."""
        self.divert: Callable[[Entry], object] | None = None
        """Gets the entries of threads in a replay, which lets them wait."""
        self._lock = threading.Lock()
        self.entries: collections.deque[Entry] = collections.deque()
        self._brought: collections.deque[Entry] = (
            collections.deque() if self.holds else self.entries
        )
        """What threads have brought: where work is held it has to ripen."""
        self._held: collections.deque[tuple[int, Callable[[int], None], object]] = (
            collections.deque()
        )
        self._lanes: dict[int, object] = {}
        """Who has each work, where work is held: a thread, or how a process is looked at."""
        self._resting: set[object] = set()
        """The threads that wait for time to pass, or for the outside."""
        self._outside: set[object] = set()
        """The threads whose work is to wait for the outside."""
        self.wakes: bool = False
        self._works = itertools.count(1)
        self._sources = itertools.count(1)
        self.number: int = 0  # how many entries have come in
        self.at_work: int = 0  # how many works threads have in hand

    def source(self, name: str) -> Tag:
        """Return the tag of one more thread or process of a name: others may live on."""
        return "thread", name, str(next(self._sources))

    @property
    def has_news(self) -> bool:
        """Whether something is to be taken at the next border."""
        return bool(self.entries) or (self.wakes and not self.holds)

    def give_out(
        self,
        begin: Callable[[int], None],
        lane: threading.Thread | None = None,
        *,
        outside: bool = False,
    ) -> None:
        """Let a thread begin with a work; its end comes back by `post`."""
        work = next(self._works)
        if self.holds:
            if outside:
                self._outside.add(lane)
            self._held.append((work, begin, lane))
        else:
            self.at_work += 1
            begin(work)

    def let_go(self) -> None:
        """Let the threads begin whose work was held."""
        while self._held:
            work, begin, lane = self._held.popleft()
            with self._lock:
                self._lanes[work] = lane
                if lane not in self._resting:
                    self.at_work += 1
            begin(work)

    def begun(self, work: int) -> None:
        """Take note, in a thread, that it has a work which any thread could have taken."""
        with self._lock:
            self._lanes[work] = threading.current_thread()

    def at_hand(self) -> list[tuple[threading.Thread, bool, bool]]:
        """Return the threads that have work, where work is held."""
        with self._lock:
            lanes = dict.fromkeys(self._lanes.values())
            return [
                (lane, lane in self._outside, lane not in self._resting)
                for lane in lanes
                if isinstance(lane, threading.Thread)
            ]

    def look(self) -> None:
        """Let those processes see whether they hang whose work time waits for."""
        with self._lock:
            lanes = [each for each in self._lanes.values() if each not in self._resting]
        for lane in lanes:
            if callable(lane):
                lane()

    def rest(self, lane: threading.Thread) -> None:
        """Take note that a thread waits for time to pass, or the outside, where work is held.

        What it has in hand, and what waits behind that, holds time up no more.
        """
        with self._lock:
            if lane not in self._resting:
                self._resting.add(lane)
                self.at_work -= self._given_to(lane)

    def go_on(self, lane: threading.Thread) -> None:
        """Take note, in the loop, that its thread goes on."""
        with self._lock:
            if lane in self._resting:
                self._resting.discard(lane)
                self.at_work += self._given_to(lane)

    def _given_to(self, lane: object) -> int:
        return sum(each is lane for each in self._lanes.values())

    def post(
        self, work: int, tag: Tag, function: Callable[..., object], *arguments: Any
    ) -> None:
        """Bring in the end of a work, from any thread."""
        with self._lock:
            if work:
                lane = self._lanes.pop(work, None)
                if lane is not None and lane in self._resting:
                    # It has waited for the outside, which it has heard from.
                    self._resting.discard(lane)
                    self.at_work += self._given_to(lane)
                else:
                    self.at_work -= 1
            self.number += 1
            entry = _new(Entry, (work, tag, function, arguments))
            divert = self.divert
            if divert is None or (work and tag[0] != "thread"):
                self._add(entry)
                return
        if tag[0] == "thread":
            divert(entry)
        # Else it is news from outside: in a replay they come from the tape.

    def bring(self, entry: Entry) -> None:
        """Bring in an entry, from any thread."""
        with self._lock:
            self._add(entry)

    def _add(self, entry: Entry) -> None:
        self._brought.append(entry)
        if not self.wakes:
            self.wakes = True
            self._turn.ring()

    def tell(self, tag: Tag, function: Callable[..., object], *arguments: Any) -> None:
        """Bring in news that are the end of no work, from any thread."""
        self.post(0, tag, function, *arguments)

    def end(self, tag: Tag, function: Callable[..., object], *arguments: Any) -> None:
        """Bring in the end of something in the loop itself: it ripens at once."""
        if self.divert is not None:
            return  # in a replay it comes from the tape
        with self._lock:
            self.number += 1
            self.entries.append(_new(Entry, (0, tag, function, arguments)))
        self._turn.expect()

    def ripen(self, *, works: bool) -> bool:
        """Let what threads have brought take effect at the next border; tells if any.

        Args:
            works: Whether ends of works are ripe too; else only news are.
        """
        if not self._brought:
            return False  # what comes from now on wakes the loop
        with self._lock:
            # Before the look: what comes later wakes the loop again.
            self.wakes = False
            brought = self._brought
            ripe = [each for each in brought if works or not each.work]
            if ripe:
                left = [each for each in brought if not works and each.work]
                brought.clear()
                brought.extend(left)
                self.entries.extend(
                    sorted(ripe, key=itemgetter(0, 1)) if works else ripe
                )
        return bool(ripe)

    def take(self) -> None:
        """Let what has come in take effect; called at the border if there is any."""
        if not self.holds:
            # Before the look: what comes later wakes the loop again.
            self.wakes = False
        entries = self.entries
        with self._arrivals:
            while entries:
                _, tag, function, arguments = entries.popleft()
                if tag[0] == "thread" and isinstance(self.tape, TapeWriter):
                    self.tape.arrived(tag, number=1)
                try:
                    function(*arguments)
                except Exception:
                    _log.exception("what came in from %s raised", " ".join(tag))


def ask_outside(tag: Tag, look: Callable[[], T]) -> T:
    """Look at something outside of the robot, now; a replay does not look."""
    tape = Door.of(asyncio.get_running_loop()).tape
    if isinstance(tape, Player):
        _, first = tape.first(tag)
        if not tape.is_over:
            value: T = first.value
            return value
    value = look()
    if isinstance(tape, TapeWriter):
        tape.first(tag, First(value=value))
    return value


async def outside(tag: Tag, work: Callable[[], Coroutine[Any, Any, T]]) -> T:
    """Await work outside of the robot; in a replay only its outcome comes again.

    The outcome takes effect at the border of a turn.
    """
    loop = asyncio.get_running_loop()
    door = Door.of(loop)
    tape = door.tape
    outcome: asyncio.Future[T] = loop.create_future()
    number = 0

    def over(end: tuple[Any, BaseException | None]) -> None:
        if isinstance(tape, TapeWriter):
            tape.arrived(tag, end, number=number)
        value, error = end
        is_over = isinstance(tape, Player) and tape.is_over
        settle(outcome, value, None if is_over else error)

    if isinstance(tape, Player):
        if tape.is_over:  # the robot stops: nothing outside is left that could fail
            await asyncio.sleep(0)
            return None  # type: ignore[return-value]
        number, _ = tape.first(tag)
        tape.expect(tag, number, over)
        return await outcome
    if isinstance(tape, TapeWriter):
        number = tape.first(tag, WAITS)
    # A context of nobody: what it starts is no part of the robot.
    task = asyncio.Task(
        Contained(work()), loop=loop, name=" ".join(tag), context=contextvars.Context()
    )
    task.add_done_callback(lambda done: door.end(tag, over, _end_of(done)))
    try:
        return await outcome
    except asyncio.CancelledError:
        task.cancel()
        raise


def _end_of(task: asyncio.Task[Any]) -> tuple[Any, BaseException | None]:
    if task.cancelled():
        return None, asyncio.CancelledError()
    error = task.exception()
    return (None, error) if error is not None else (task.result(), None)


class News:
    """What is told from outside, in the loop or in a thread: kept, and told again."""

    def __init__(
        self, loop: asyncio.AbstractEventLoop, tag: Tag, function: Callable[..., object]
    ) -> None:
        self._home = threading.get_ident()
        self._door = Door.of(loop)
        self._tag = tag
        self._function = function
        if self._door.player is not None:
            self._door.player.listen(tag, lambda told: function(*told))

    def tell(self, *told: Any) -> None:
        """Tell it, in any thread; it takes effect at the border of a turn."""
        in_loop = threading.get_ident() == self._home
        bring = self._door.end if in_loop else self._door.tell
        bring(self._tag, self._take, told)

    def _take(self, told: tuple[Any, ...]) -> None:
        if isinstance(self._door.tape, TapeWriter):
            self._door.tape.arrived(self._tag, told)
        self._function(*told)
