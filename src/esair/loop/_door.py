"""The one door: what comes in from threads takes effect in one order.

An entry gets a number and a time when it comes in. Entries take effect in the order of
their numbers, at the next border of the loop. On a virtual clock what comes from threads
ripens before: news when nothing is ready, ends of works when no thread is at work either,
in the order in which the work was given out. So a run repeats, however long threads take.
"""

from __future__ import annotations

import collections
import itertools
import logging
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from esair.loop._arrivals import Arrivals
from esair.loop._bell import Bell
from esair.loop._of_loop import OfTurn
from esair.loop._rate_group import NOW
from esair.loop._tape import Entry, Player, Tag, TapeWriter

if TYPE_CHECKING:
    from esair.loop._turn import Turn

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
        self._time = turn.time
        self.player: Player | None = turn.player
        """What repeats a run on this loop, sooner or later."""
        self._holds = turn.virtual
        self.tape: TapeWriter | Player | None = None
        """What keeps or gives what comes in, where a run can be repeated."""
        self.divert: Callable[[Entry], object] | None = None
        """Gets the entries of threads in a replay, which lets them wait."""
        self._lock = threading.Lock()
        self._entries: collections.deque[Entry] = collections.deque()
        self._brought: collections.deque[Entry] = (
            collections.deque() if self._holds else self._entries
        )
        """What threads have brought: where work is held it has to ripen."""
        self._held: collections.deque[tuple[int, Callable[[int], None], object]] = (
            collections.deque()
        )
        self._lanes: dict[int, object] = {}
        """Which thread has each work, where work is held."""
        self._resting: set[object] = set()
        """The threads that wait for time to pass, or for the outside."""
        self._outside: set[object] = set()
        """The threads whose work is to wait for the outside."""
        self._wakes = False
        self.bell = Bell(turn)
        self._works = itertools.count(1)
        self.number: int = 0  # how many entries have come in
        self.at_work: int = 0  # how many works threads have in hand

    @property
    def has_news(self) -> bool:
        """Whether something is to be taken at the next border."""
        return bool(self._entries) or (self._wakes and not self._holds)

    @property
    def held(self) -> bool:
        """Whether work was given out that has not begun."""
        return bool(self._held)

    def give_out(
        self,
        begin: Callable[[int], None],
        lane: threading.Thread | None = None,
        *,
        outside: bool = False,
    ) -> None:
        """Let a thread begin with a work; its end comes back by `post`."""
        work = next(self._works)
        if self._holds:
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
            entry = _new(
                Entry, (self.number, self._time(), work, tag, function, arguments)
            )
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
        if not self._wakes:
            self._wakes = True
            self.bell.ring()

    def tell(self, tag: Tag, function: Callable[..., object], *arguments: Any) -> None:
        """Bring in news that are the end of no work, from any thread."""
        self.post(0, tag, function, *arguments)

    def end(self, tag: Tag, function: Callable[..., object], *arguments: Any) -> None:
        """Bring in the end of something in the loop itself: it ripens at once."""
        if self.divert is not None:
            return  # in a replay it comes from the tape
        with self._lock:
            self.number += 1
            self._entries.append(
                Entry(self.number, self._time(), 0, tag, function, arguments)
            )
        self._turn.want(NOW)

    def ripen(self, *, works: bool) -> bool:
        """Let what threads have brought take effect at the next border; tells if any.

        Args:
            works: Whether ends of works are ripe too; else only news are.
        """
        with self._lock:
            self._wakes = (
                False  # before the look: what comes later wakes the loop again
            )
            brought = self._brought
            ripe = [each for each in brought if works or not each.work]
            if ripe:
                left = [each for each in brought if not works and each.work]
                brought.clear()
                brought.extend(left)
                self._entries.extend(sorted(ripe, key=_by_work) if works else ripe)
        return bool(ripe)

    def take(self) -> None:
        """Let what has come in take effect; called at the border."""
        if not self._holds:
            self._wakes = (
                False  # before the look: what comes later wakes the loop again
            )
        entries = self._entries
        with self._arrivals:
            while entries:
                _, _, _, tag, function, arguments = entries.popleft()
                if tag[0] == "thread" and isinstance(self.tape, TapeWriter):
                    self.tape.arrived(tag, number=1)
                try:
                    function(*arguments)
                except Exception:
                    _log.exception("what came in from %s raised", " ".join(tag))


def _by_work(entry: Entry) -> tuple[int, Tag, int]:
    return entry.work, entry.tag, entry.number
