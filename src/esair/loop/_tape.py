"""What comes into a run, kept so that the run can be repeated without its devices."""

from __future__ import annotations

import collections
import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from esair.loop._door import Door, Entry

PATIENCE = 30.0
"""How long a replay waits for a thread of the robot's own, in seconds."""

Tag = tuple[str, ...]


class Arrived(NamedTuple):
    """What has taken effect at the beginning of a turn."""

    turn: int
    tag: Tag
    number: int
    payload: Any


class First(NamedTuple):
    """What a call gave without a wait: a value, an error, or that it waits."""

    waits: bool
    value: Any
    error: BaseException | None


class Tape:
    """A recorded run.

    Attributes:
        moments: When each turn began, the beginning of the loop first.
        arrived: What has come in, in its order.
        firsts: What calls gave without a wait, by their tags, in their order.
    """

    def __init__(self) -> None:
        self.moments: list[float] = []
        self.arrived: list[Arrived] = []
        self.firsts: dict[Tag, list[First]] = {}

    def dump(self) -> bytes:
        """Return it as bytes.

        Raises:
            PicklingError: A driver has given something that cannot be kept.
        """
        import pickle  # only for the runs that are recorded

        return pickle.dumps((self.moments, self.arrived, self.firsts))

    @classmethod
    def load(cls, data: bytes) -> Tape:
        """Return the tape of some bytes, which must come from `dump`."""
        tape = cls()
        import pickle

        tape.moments, tape.arrived, tape.firsts = pickle.loads(data)
        return tape


class Recorder:
    """Writes what comes into a run on a tape."""

    is_replay = False

    def __init__(self, tape: Tape) -> None:
        self._tape = tape
        self._turn = 0
        self._counts: collections.Counter[Tag] = collections.Counter()

    def begin(self, now: float) -> None:
        """The loop begins."""
        self._tape.moments.append(now)

    def turn(self, number: int, now: float) -> None:
        """A turn begins."""
        self._turn = number
        self._tape.moments.append(now)

    def arrived(self, tag: Tag, payload: Any = None, *, number: int = 0) -> None:
        """Something takes effect."""
        if not number:
            self._counts[tag] += 1
            number = self._counts[tag]
        self._tape.arrived.append(Arrived(self._turn, tag, number, payload))

    def first(self, tag: Tag, first: First) -> int:
        """A call has had its first step; return its number among those of its tag."""
        firsts = self._tape.firsts.setdefault(tag, [])
        firsts.append(first)
        return len(firsts)


class Player:
    """Gives a robot what is on a tape: the clock, and what came in. No driver is called.

    Threads of the robot's own (plain behaviors) run for real: what they ask for waits
    for the turn in which it came in, and the replay waits for a thread that is late.
    """

    is_replay = True

    def __init__(self, tape: Tape) -> None:
        self._tape = tape
        self._place = 0
        self._counts: collections.Counter[Tag] = collections.Counter()
        self._taken: collections.Counter[Tag] = collections.Counter()
        self._ends: dict[tuple[Tag, int], Callable[[Any], object]] = {}
        self._listeners: dict[Tag, Callable[[Any], object]] = {}
        self._came: dict[Tag, collections.deque[Entry]] = {}
        self._news = threading.Condition()
        self._over = 0.0
        self.missed: list[Arrived] = []
        """What came in when the run was recorded, and nobody waited for now."""

    @property
    def ended(self) -> bool:
        """Whether the tape is over."""
        return self._place >= len(self._tape.arrived)

    def begin(self, door: Door) -> float:
        """The loop begins; return the time."""
        door.divert = self._come
        return self._tape.moments[0]

    def moment(self, turn: int) -> float:
        """Return when a turn began; when the tape is over time passes."""
        moments = self._tape.moments
        if turn < len(moments):
            return moments[turn]
        if not self._over:
            self._over = time.monotonic()
        return moments[-1] + time.monotonic() - self._over

    def take(self, turn: int) -> None:
        """Let what came in take effect again in a turn."""
        arrived = self._tape.arrived
        while self._place < len(arrived) and arrived[self._place].turn <= turn:
            entry = arrived[self._place]
            self._place += 1
            self._apply(entry)

    def first(self, tag: Tag) -> tuple[int, First]:
        """Return what the next call of a tag gave without a wait, and its number."""
        self._counts[tag] += 1
        number = self._counts[tag]
        firsts = self._tape.firsts.get(tag, [])
        if number > len(firsts):  # the recording was over
            return number, First(waits=True, value=None, error=None)
        return number, firsts[number - 1]

    def expect(self, tag: Tag, number: int, end: Callable[[Any], object]) -> None:
        """Call a function with the end of a call when it comes."""
        self._ends[tag, number] = end

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
            end(arrived.payload)
        elif arrived.tag[0] == "thread":
            entry = self._wait_for(arrived.tag)
            if entry is None:
                self.missed.append(arrived)
            else:
                entry.function(*entry.arguments)
        else:
            self.missed.append(arrived)

    def _wait_for(self, tag: Tag) -> Entry | None:
        end = time.monotonic() + PATIENCE
        with self._news:
            while not self._came.get(tag):
                if not self._news.wait(max(0.0, end - time.monotonic())):
                    return None
            return self._came[tag].popleft()
