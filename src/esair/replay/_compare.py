"""What a robot does in a replay, beside what it did when the run was recorded."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Generator, Iterable
from pathlib import Path
from typing import Any

import attrs

from esair.codec import Kinds
from esair.exceptions import RecordingBrokenError
from esair.journal import Event, Kind
from esair.loop import Player
from esair.recording import Kept, Recorded, chunks_of, events_of, plain

NOT_COMPARED = {Kind.LOG}  # What a robot says is no decision

_OF_ACTUATORS = {Kind.COMMAND, Kind.REFUSED, Kind.SENT, Kind.APPLIED, Kind.OPERATED}


@attrs.frozen
class Seen:
    """A reading that was there when something was decided."""

    sensor: str
    value: Any
    time: float  # When, on the robot's clock, in seconds


@attrs.frozen
class Divergence:
    """The first thing that a replay does otherwise.

    Attributes:
        turn: The number of the turn, since the start of the recording.
        seconds: When, since the start of the recording.
        component: Who decided otherwise.
        expected: What was recorded; None if nothing more was.
        actual: What happens now; None if nothing does.
        readings: The newest readings of what the component reads, or of all sensors.
    """

    turn: int
    seconds: float
    component: str
    expected: Recorded | None
    actual: Recorded | None
    readings: tuple[Seen, ...]


class Comparison:
    """Compares the events of a replay with recorded ones, in their order.

    Args:
        path: The recording.
        whole: Whether it has an end, and lacks nothing: else what comes after it is no
            news.
        kept: Its turns, where they are played.
        player: What plays them.
        diverged: Called once, when there is a difference.
    """

    def __init__(
        self,
        path: Path,
        *,
        whole: bool,
        kept: Kept | None,
        player: Player | None,
        diverged: Callable[[], object],
    ) -> None:
        self._path = path
        self._events = events_of(path)
        self.lost: int = 0
        """How many events were not recorded, in the first gap; it ends there."""
        self._number = 0
        self.span: Player | Span = Span(path) if player is None else player
        """How long the recorded run is, which is read while it is repeated."""
        self._whole = whole
        self._kept = kept
        self._diverged = diverged
        self._newest: dict[str, Seen] = {}
        self._reads: dict[str, dict[str, None]] = {}
        self.equal: int = 0
        """How many events were equal."""
        self.divergence: Divergence | None = None
        self.is_over: bool = False

    def close(self) -> None:
        """Read no further: else files are open until a collection."""
        self._events.close()
        if isinstance(self.span, Span):
            self.span.close()

    def hear(self, event: Event) -> None:
        """Compare what has happened now; a listener of the journal."""
        if self.is_over or event.kind in NOT_COMPARED:
            return
        value = event.value.value if event.kind is Kind.READING else event.value
        actual = Recorded(
            0,
            event.time,
            str(event.kind),
            event.component,
            event.peer,
            plain(value),
            event.text,
        )
        expected = self._next()
        if self.is_over:
            return
        if expected is None:
            if self._is_whole() and self.span.reaches(event.time):
                self._tell(None, actual)
            self.is_over = True
            return
        if _same(expected, actual):
            self.equal += 1
            self._note(actual)
        else:
            self._tell(expected, actual)

    def end(self) -> None:
        """The replay is over: what was recorded and did not happen is a difference."""
        if self.is_over:
            return
        expected = self._next()
        if not self.is_over and expected is not None:
            later = math.nextafter(expected.time, math.inf)
            if self.span.reaches(later):
                self._tell(expected, None)
        self.is_over = True

    def _is_whole(self) -> bool:
        """Tell whether nothing is lacking, in the turns either: those are wound on."""
        if self._whole and self._kept is not None:
            self.span.reaches(math.inf)
            return self._kept.spoiled is None
        return self._whole

    def _next(self) -> Recorded | None:
        for event in self._events:
            if self._number and event.number != self._number + 1:
                self.lost = max(1, event.number - self._number - 1)
                self.is_over = True
                return None
            self._number = event.number
            if event.kind not in NOT_COMPARED:
                return event
        return None

    def _note(self, event: Recorded) -> None:
        if event.kind == Kind.READING:
            self._newest[event.component] = Seen(
                event.component, event.value, event.time
            )
        elif event.kind == Kind.REGISTERED:
            self._reads.setdefault(event.component, {})[event.peer] = None

    def _tell(self, expected: Recorded | None, actual: Recorded | None) -> None:
        self.is_over = True
        first = expected or actual
        assert first is not None
        if expected is not None and actual is not None:
            first = min(expected, actual, key=lambda each: each.time)
        who = first.component
        if first.kind in _OF_ACTUATORS and first.peer:
            who = first.peer
        wanted = [name for name in self._reads.get(who, ()) if name in self._newest]
        readings = tuple(self._newest[name] for name in wanted or sorted(self._newest))
        turn = self._turn_of(first.time)
        seconds = first.time - self.span.began
        self.divergence = Divergence(turn, seconds, who, expected, actual, readings)
        self._diverged()

    def _turn_of(self, moment: float) -> int:
        """Return the number of the turn at a moment; the recording is read again."""
        moments: Iterable[float] = _moments_of_events(self._path)
        if self._kept is not None:
            kept = Kept(self._path, chunks_of(self._path), Kinds())
            moments = (item for item in kept if type(item) is float)
        with contextlib.suppress(RecordingBrokenError):  # it is told elsewhere
            for turn, each in enumerate(moments):
                if each >= moment:
                    return turn if each == moment else -1
        return -1


class Span:
    """How long a run took that is known by its events alone."""

    def __init__(self, path: Path) -> None:
        self._moments = _moments_of_events(path)
        self.began = self.moment = next(self._moments, 0.0)
        self.turns = 1

    def close(self) -> None:
        self._moments.close()

    def reaches(self, moment: float) -> bool:
        """Tell whether something has happened at a moment or later."""
        while self.moment < moment:
            following = next(self._moments, None)
            if following is None:
                return False
            self.moment = following
            self.turns += 1
        return True


def _moments_of_events(path: Path) -> Generator[float, None, None]:
    """Yield when something has happened, each moment once."""
    last: float | None = None
    for event in events_of(path):
        if last is None or event.time > last:
            yield event.time
            last = event.time


def _same(one: Recorded, other: Recorded) -> bool:
    """Tell whether two events are, but for their numbers and their words."""
    rest: dict[str, Any] = {"number": 0, "text": "", "measured": None}
    return one._replace(**rest) == other._replace(**rest)
