"""What comes into a run, kept so that the run can be repeated without its devices.

A tape is one list in the order of the run: the moment at which each turn began, what a
call of a driver gave without a wait, and what came in. A `TapeWriter` makes it, wherever
it is kept; a `Player` gives it to a robot again.
"""

from __future__ import annotations

import collections
import threading
import time
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any, NamedTuple

from esair.exceptions import DeviceLostError
from esair.loop._light_task import ignore

if TYPE_CHECKING:
    from esair.loop._door import Door

Tag = tuple[str, ...]
"""Which call it is the end of, or who tells something: such as ``("sonar", "read")``."""

PATIENCE = (
    30.0  # how long a replay waits for a thread or a process of the robot's own, in s
)
IMPATIENT = 0.2  # how long it waits for one when it has waited in vain before
HOPELESS = 50  # how often it waits for threads in vain before it does no more

SPOILED: Tag = ("spoiled",)
"""The tag of what makes a run one that cannot be repeated from there on."""


class Entry(NamedTuple):
    """What has come in."""

    work: int  # the number of the work that it is the end of; 0 if it is none
    tag: Tag
    function: Callable[..., object]  # what lets it take effect, in the loop
    arguments: tuple[Any, ...]


class Arrived(NamedTuple):
    """What has taken effect at the beginning of a turn."""

    turn: int
    tag: Tag  # whose end or news it is
    number: int  # which of the calls with this tag has ended
    payload: Any


class First(NamedTuple):
    """What a call gave without a wait: a value, an error, or that it waits."""

    waits: bool = False
    value: Any = None
    error: BaseException | None = None


WAITS = First(waits=True)


class TapeWriter:
    """Writes what comes into a run on a tape."""

    def __init__(self, put: Callable[[Any], object]) -> None:
        self._put = put
        self.turn: Callable[[float], object] = put
        """Called with the moment at which a turn begins, that of the first one too."""
        self._arrivals: collections.Counter[Tag] = collections.Counter()
        self._calls: collections.Counter[Tag] = collections.Counter()

    def close(self) -> None:
        self._put = self.turn = ignore

    def spoil(self, why: str) -> None:
        """Something happens that cannot be repeated."""
        self._put((SPOILED, 0, why))

    def arrived(self, tag: Tag, payload: Any = None, *, number: int = 0) -> None:
        """Something takes effect."""
        if not number:
            self._arrivals[tag] += 1
            number = self._arrivals[tag]
        self._put((tag, number, payload))

    def first(self, tag: Tag, first: First) -> int:
        """A call has had its first step; return its number among those of its tag."""
        self._calls[tag] += 1
        self._put((tag, first))
        return self._calls[tag]


class Player:
    """Gives a robot what is on a tape: the clock, and what came in. No driver is called.

    Threads of the robot's own (plain behaviors) run for real: what they ask for waits
    for the turn in which it came in, and the replay waits for a thread that is late.

    When the tape is over every call is answered with `DeviceLostError`, so that the
    robot can stop. It is read turn by turn, while the run goes on.

    Args:
        items: What is on the tape, in its order.
        over: Called when it is over.
        read: Makes what came in of what is kept of it, when it takes effect; it is
            kept as it is unless given.
    """

    def __init__(
        self,
        items: Iterable[Any],
        over: Callable[[], object] | None = None,
        *,
        read: Callable[[Any], Any] | None = None,
    ) -> None:
        self._items = iter(items)
        self._read = read
        self._arrived: collections.deque[Arrived] = collections.deque()
        self._firsts: dict[Tag, collections.deque[First]] = {}
        self.turns: int = 0
        """How many turns have begun."""
        self.began: float = 0.0
        """When the first one did."""
        self.moment: float = 0.0
        """When this one did."""
        self._following: float | None = 0.0
        self.error: Exception | None = None
        """Why the rest of the tape cannot be read; None if it can."""
        self.on_over = over
        self.is_over: bool = False
        self._door: Door | None = None
        self._counts: collections.Counter[Tag] = collections.Counter()
        self._ends: dict[tuple[Tag, int], Callable[[Any], object]] = {}
        self._listeners: dict[Tag, Callable[[Any], object]] = {}
        self._came: dict[Tag, collections.deque[Entry]] = {}
        self._news = threading.Condition()
        self._patience = PATIENCE
        self._hopes = HOPELESS
        self.late: str = ""
        """Whose own thread or process was not waited for any longer, of all the first."""
        self.missed: int = 0
        """How much came in when the run was recorded, and nobody waited for now."""
        self._load()
        if self.next_turn() is not None:
            self.began = self.moment

    def begin(self, door: Door) -> None:
        """The recorded part of the run begins."""
        self._door = door
        door.divert = self._come

    def next_turn(self) -> float | None:
        """Begin the next turn of the tape; return its moment, or None if it is over."""
        if self._following is None:
            return None
        self.moment = self._following
        self.turns += 1
        self._load()
        return self.moment

    def reaches(self, moment: float) -> bool:
        """Tell whether the tape has a turn at a moment or later; it may be wound on."""
        while self.moment < moment and self._following is not None:
            self.moment = self._following
            self._load()
        return self.moment >= moment

    def _load(self) -> None:
        """Take from the tape what came in until the following turn."""
        self._following = None
        try:
            for item in self._items:
                if type(item) is float:
                    self._following = item
                    return
                if len(item) == 3:
                    self._arrived.append(Arrived(self.turns - 1, *item))
                else:
                    tag, first = item
                    self._firsts.setdefault(tag, collections.deque()).append(first)
        except Exception as error:  # it is a file of anybody
            self.error = self.error or error

    def _payload(self, kept: Any) -> Any:
        return kept if self._read is None else self._read(kept)

    def take(self) -> None:
        """Let what came in take effect again in this turn."""
        arrived = self._arrived
        while arrived and not self.is_over:
            each = arrived.popleft()
            try:
                self._apply(each)
            except Exception as error:  # nothing that a run has kept leads there
                self.fail(error)

    def fail(self, error: Exception) -> None:
        """The rest of the tape cannot be used."""
        self.error = self.error or error
        self.end()

    def end(self) -> None:
        """The tape is over, or nobody wants the rest of it."""
        if self.is_over:
            return
        self.is_over = True
        door = self._door
        assert door is not None
        door.divert = None
        with self._news:
            came, self._came = self._came, {}
        for entries in came.values():
            for entry in entries:
                door.bring(entry)
        ends, self._ends = self._ends, {}
        for (tag, _), end in ends.items():
            end((None, _lost(tag)))
        if self.on_over is not None:
            self.on_over()

    def first(self, tag: Tag) -> tuple[int, First]:
        """Return what the next call of a tag gave without a wait, and its number."""
        self._counts[tag] += 1
        number = self._counts[tag]
        firsts = self._firsts.get(tag)
        if firsts:
            try:
                return number, First(*self._payload(firsts.popleft()))
            except Exception as error:  # it is a file of anybody
                self.fail(error)
        if self.is_over:
            return number, First(error=_lost(tag))
        return number, WAITS

    def has_first(self, tag: Tag) -> bool:
        """Tell whether something of a tag is on the tape until the following turn."""
        return bool(self._firsts.get(tag))

    def expect(self, tag: Tag, number: int, end: Callable[[Any], object]) -> None:
        """Call a function with the end of a call, as (value, error), when it comes."""
        self._ends[tag, number] = end
        if self.is_over:
            assert self._door is not None
            self._door.end(tag, self._end_now, tag, number)

    def _end_now(self, tag: Tag, number: int) -> None:
        end = self._ends.pop((tag, number), None)
        if end is not None:
            end((None, _lost(tag)))

    def listen(self, tag: Tag, function: Callable[[Any], object]) -> None:
        """Call a function with each thing that comes with a tag."""
        self._listeners[tag] = function

    def _come(self, entry: Entry) -> None:
        with self._news:
            self._came.setdefault(entry.tag, collections.deque()).append(entry)
            self._news.notify_all()

    def _apply(self, arrived: Arrived) -> None:
        end = self._ends.pop((arrived.tag, arrived.number), None)
        end = end or self._listeners.get(arrived.tag)
        if end is not None:
            end(self._payload(arrived.payload))
        elif arrived.tag[0] == "thread":
            entry = self._wait_for(arrived.tag)
            if entry is None:
                self.missed += 1
            else:
                entry.function(*entry.arguments)
        else:
            self.missed += 1

    def _wait_for(self, tag: Tag) -> Entry | None:
        end = time.monotonic() + self._patience
        with self._news:
            while not self._came.get(tag):
                if not self._news.wait(max(0.0, end - time.monotonic())):
                    self.late = self.late or tag[1]
                    self._hopes -= 1
                    self._patience = IMPATIENT if self._hopes > 0 else 0.0
                    return None
            entry = self._came[tag].popleft()
            if not self._came[tag]:
                del self._came[tag]  # it may be over: each request may have a thread
            return entry


def _lost(tag: Tag) -> DeviceLostError:
    name = tag[1] if tag[0] == "call" else tag[0]
    return DeviceLostError(name, "the recording is over")
