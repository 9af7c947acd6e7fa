"""The one door: what comes in from threads takes effect in one order.

An entry gets a number and a time when it comes in. On a real clock entries take effect
in the order of their numbers, at the beginning of the next turn of the loop. A loop on a
virtual clock takes them when nothing is ready and no thread is at work, in the order in
which the work was given out: so a run repeats, however long the threads take.
"""

from __future__ import annotations

import asyncio
import collections
import itertools
import logging
import threading
from collections.abc import Callable
from typing import Any, NamedTuple

from esair.loop._of_loop import of_loop
from esair.loop._tape import Player, Recorder
from esair.loop._timer import clock_of

_log = logging.getLogger("esair")

Tag = tuple[str, ...]
"""Which call it is the end of, or who tells something: such as ``("sonar", "read")``."""


class Entry(NamedTuple):
    """What has come in.

    Attributes:
        number: Grows by one with each entry.
        time: When it came in, in seconds of the loop's clock.
        work: The number of the work that it is the end of; 0 if it is none.
        tag: Whose it is.
        function: What lets it take effect, in the loop.
        arguments: What the function gets.
    """

    number: int
    time: float
    work: int
    tag: Tag
    function: Callable[..., object]
    arguments: tuple[Any, ...]


class Door:
    """Where what threads have done comes into a loop. One for each event loop.

    However many entries there are, one wake-up of the loop is under way at a time:
    what comes in until the loop gets to it goes with it.

    Args:
        loop: An attribute ``takes_entries`` says that it calls `take` by itself, and
            ``holds_work`` that threads begin only when it lets them.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._time = clock_of(loop)
        self._is_taken: bool = getattr(loop, "takes_entries", False)
        self._holds: bool = getattr(loop, "holds_work", False)
        self.tape: Recorder | Player | None = None
        """What keeps or gives what comes in, on a `TurnLoop`."""
        self.divert: Callable[[Entry], object] | None = None
        """Gets the entries of threads in a replay, which lets them wait."""
        self._lock = threading.Lock()
        self._entries: collections.deque[Entry] = collections.deque()
        self._held: collections.deque[tuple[int, Callable[[int], None]]] = (
            collections.deque()
        )
        self._wakes = False
        self._works = itertools.count(1)
        self.number = 0
        """How many entries have come in."""
        self.at_work = 0
        """How many works threads have in hand."""

    @classmethod
    def of(cls, loop: asyncio.AbstractEventLoop) -> Door:
        """Return the door of a loop."""
        return of_loop(loop, cls)

    @property
    def waiting(self) -> bool:
        """Whether something has come in that has not taken effect."""
        return bool(self._entries)

    @property
    def held(self) -> bool:
        """Whether work was given out that has not begun."""
        return bool(self._held)

    def give_out(self, begin: Callable[[int], None]) -> None:
        """Let a thread begin with a work; its end comes back by `post`.

        Args:
            begin: Called in the loop with the number of the work, at once or, on a
                virtual clock, when nothing else is ready; must not raise.
        """
        work = next(self._works)
        if self._holds:
            self._held.append((work, begin))
        else:
            self.at_work += 1
            begin(work)

    def let_go(self) -> None:
        """Let the threads begin whose work was held."""
        while self._held:
            work, begin = self._held.popleft()
            with self._lock:
                self.at_work += 1
            begin(work)

    def post(
        self, work: int, tag: Tag, function: Callable[..., object], *arguments: Any
    ) -> None:
        """Bring in the end of a work, from any thread.

        Raises:
            RuntimeError: The loop is closed.
        """
        with self._lock:
            if work:
                self.at_work -= 1
            self.number += 1
            entry = Entry(self.number, self._time(), work, tag, function, arguments)
            if self.divert is not None and tag[0] == "thread":
                self.divert(entry)
                return
            if self.divert is not None and not work:
                return  # news of a device: in a replay they come from the tape
            self._entries.append(entry)
            if self._wakes:
                return
            self._wakes = True
        self._loop.call_soon_threadsafe(self._woken)

    def tell(self, tag: Tag, function: Callable[..., object], *arguments: Any) -> None:
        """Bring in news that are the end of no work, from any thread.

        Raises:
            RuntimeError: The loop is closed.
        """
        self.post(0, tag, function, *arguments)

    def end(self, tag: Tag, function: Callable[..., object], *arguments: Any) -> None:
        """Bring in the end of something in the loop itself.

        It takes effect at the beginning of the next turn where turns have a border,
        and at once where they have none.
        """
        if self.tape is None:
            function(*arguments)
            return
        if self.divert is not None:
            return  # in a replay it comes from the tape
        with self._lock:
            self.number += 1
            self._entries.append(
                Entry(self.number, self._time(), 0, tag, function, arguments)
            )

    def _woken(self) -> None:
        self._wakes = False  # before the look: what comes later wakes the loop again
        if not self._is_taken:
            self.take()

    def take(self, *, by_work: bool = False) -> None:
        """Let what has come in take effect; called in the loop.

        Args:
            by_work: In the order in which the work was given out, not as it came in.
        """
        entries = self._entries
        if by_work:
            with self._lock:
                entries = collections.deque(sorted(entries, key=_by_work))
                self._entries.clear()
        while entries:
            entry = entries.popleft()
            if entry.tag[0] == "thread" and isinstance(self.tape, Recorder):
                self.tape.arrived(entry.tag)
            try:
                entry.function(*entry.arguments)
            except Exception:
                _log.exception("what came in from %s raised", " ".join(entry.tag))


def _by_work(entry: Entry) -> tuple[int, Tag, int]:
    return entry.work, entry.tag, entry.number
