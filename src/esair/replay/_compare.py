"""What a robot does in a replay, beside what it did when the run was recorded."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any, Protocol

import attrs

from esair.journal import Event, Kind
from esair.recording import Recorded, plain

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


class Span(Protocol):
    """How long a recorded run is, which is read while it is repeated."""

    began: float
    moment: float
    turns: int

    def reaches(self, moment: float) -> bool:
        """Tell whether it has a turn at a moment or later."""


class Comparison:
    """Compares the events of a replay with recorded ones, in their order.

    Args:
        recorded: What was recorded, in its order.
        span: How long the run took.
        whole: Tells whether the recording has an end: else what comes after it is no
            news.
        turn_of: Finds the turn of a moment.
        diverged: Called once, with the first difference.
    """

    def __init__(
        self,
        recorded: Iterable[Recorded],
        span: Span,
        *,
        whole: Callable[[], bool],
        turn_of: Callable[[float], int],
        diverged: Callable[[Divergence], object],
    ) -> None:
        self._events = iter(recorded)
        self.lost: int = 0
        """How many events were not recorded, in the first gap; it ends there."""
        self._number = 0
        self._span = span
        self._whole = whole
        self._turn_of = turn_of
        self._diverged = diverged
        self._newest: dict[str, Seen] = {}
        self._reads: dict[str, list[str]] = {}
        self.equal: int = 0
        """How many events were equal."""
        self.is_over: bool = False

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
            if self._whole() and self._span.reaches(event.time):
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
            if self._span.reaches(later):
                self._tell(expected, None)
        self.is_over = True

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
            self._reads.setdefault(event.component, []).append(event.peer)

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
        seconds = first.time - self._span.began
        self._diverged(Divergence(turn, seconds, who, expected, actual, readings))


def _same(one: Recorded, other: Recorded) -> bool:
    return (
        one.kind == other.kind
        and one.component == other.component
        and one.peer == other.peer
        and one.time == other.time
        and one.value == other.value
    )
