"""Runs a robot on a recording: its own code, the recorded world; and compares the two."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import json
import math
import time
from collections.abc import Callable, Coroutine, Generator, Iterable
from pathlib import Path
from typing import Any

import attrs

from esair.codec import Kinds, kinds_of
from esair.exceptions import BehaviorUnavailableError, RecordingBrokenError, describe
from esair.journal import Event, Kind
from esair.loop import Player, TurnLoop, run_and_end
from esair.messages import is_placed
from esair.recording import (
    GIVEN,
    VALUE_LIMIT,
    Kept,
    Recorded,
    chunks_of,
    events_of,
    facts_of,
    plain,
    size_of,
)
from esair.standard import (
    FORMAT,
    Robot,
    components_of,
    prepare_replay,
    run_to_its_end,
)

NOT_COMPARED = {Kind.LOG}  # What a robot says is no decision

_OF_PEERS = {
    *(Kind.COMMAND, Kind.REFUSED, Kind.SENT, Kind.APPLIED, Kind.OPERATED),
    *(Kind.CONFIGURED, Kind.ASKED, Kind.PUT, Kind.OPERATOR),
}
"""What the peer has decided, not the component that it happened to."""


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
        count: How many events it has; 0 if it has no end, or lacks some: then what
            comes after it is no news.
        kept: Its turns, where they are played.
        player: What plays them.
        diverged: Called once, when there is a difference.
    """

    def __init__(
        self,
        path: Path,
        *,
        count: int,
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
        self._count = count
        self._kept = kept
        self._diverged = diverged
        self._newest: dict[str, Seen] = {}
        self._rights: dict[str, dict[str, Any]] = {}  # By component and resource
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
        value = None if size_of(value) > VALUE_LIMIT else plain(value)  # as recorded
        actual = Recorded(*event._replace(value=value))
        expected = self._next()
        if expected is not None and _same(expected, actual):
            self.equal += 1
            self._note(actual)
        elif expected is not None:
            self._tell(expected, actual)
        elif not self.is_over:
            if self._is_whole() and self.span.reaches(event.time):
                self._tell(None, actual)
            self.is_over = True

    def end(self) -> None:
        """The replay is over: what was recorded and did not happen is a difference."""
        if self.is_over:
            return
        expected = self._next()
        if expected is not None:
            if self.span.reaches(math.nextafter(expected.time, math.inf)):
                self._tell(expected, None)
        elif not self.is_over and self._kept is None:
            self.span.reaches(math.inf)  # nobody has played it
        self.is_over = True

    def _is_whole(self) -> bool:
        """Tell whether nothing is lacking, in the turns either: those are wound on."""
        if self._count and self._kept is not None:
            self.span.reaches(math.inf)
            return self._kept.spoiled is None
        return self._count > 0

    def _next(self) -> Recorded | None:
        for event in self._events:
            if self._number and event.number != self._number + 1:
                self.lost = max(1, event.number - self._number - 1)
                break
            self._number = event.number
            if event.kind not in NOT_COMPARED:
                return event
        self.lost = self.lost or max(0, self._count - self._number)
        self.is_over = self.lost > 0
        return None

    def _note(self, event: Recorded) -> None:
        if event.kind == Kind.READING:
            self._newest[event.component] = Seen(
                event.component, event.value, event.time
            )
        elif event.kind == Kind.REGISTERED:
            self._rights.setdefault(event.component, {})[event.peer] = event.value

    def _tell(self, expected: Recorded | None, actual: Recorded | None) -> None:
        self.is_over = True
        first = self._first(expected, actual)
        who = self._who(first, actual if first is expected else expected)
        wanted = [name for name in self._rights.get(who, ()) if name in self._newest]
        readings = tuple(self._newest[name] for name in wanted or sorted(self._newest))
        turn = self._turn_of(first.time)
        seconds = first.time - self.span.began
        self.divergence = Divergence(turn, seconds, who, expected, actual, readings)
        self._diverged()

    def _first(self, expected: Recorded | None, actual: Recorded | None) -> Recorded:
        """Return what was first; of one moment, what the other run does not have."""
        if expected is None or actual is None or expected.time != actual.time:
            return min(filter(None, (expected, actual)), key=lambda each: each.time)
        rest = itertools.takewhile(lambda each: each.time == actual.time, self._events)
        return expected if any(_same(each, actual) for each in rest) else actual

    def _who(self, first: Recorded, other: Recorded | None) -> str:
        """Return who decided otherwise: where a command met somebody, that one."""
        for each in (first, other):
            if each and each.kind == Kind.REFUSED and isinstance(each.value, dict):
                holder = str(each.value.get("holder"))
                if holder in self._rights:
                    return holder
        is_other_value = other is not None and other[2:5] == first[2:5]
        if first.kind == Kind.SENT and (is_other_value or not first.peer):
            rights = self._rights.items()
            guards = [name for name, of in rights if of.get(first.component) == "GUARD"]
            return " or ".join(guards) or first.component
        is_of_peer = first.kind in _OF_PEERS
        if first.kind == Kind.GOT:
            is_of_peer = is_other_value  # else it was not asked for
        if first.kind == Kind.ANSWERED:  # to an asker who waited no longer
            is_of_peer = str(first.value).startswith(BehaviorUnavailableError.__name__)
        return (is_of_peer and first.peer) or first.component

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
    return one[1:6] == other[1:6]  # from the time to the value


AGES = 1e9
"""A time that no run takes, in seconds."""


@attrs.frozen
class Outcome:
    """What came of a replay.

    Attributes:
        equal: How many events were equal, from the first one on.
        divergence: The first that was not; None if all were.
        turns: How many turns were repeated.
        seconds: How long the run took that was recorded.
        took: How long the replay took, in seconds.
        short: Why it was not compared to the end of the recording; empty if it was.
        late: Whose own thread or process was waited for in vain; empty if nobody's.
    """

    equal: int
    divergence: Divergence | None
    turns: int
    seconds: float
    took: float
    short: str = ""
    late: str = ""


class Replay:
    """A recording that can be repeated.

    Args:
        path: The recording.

    Attributes:
        file: The name of the robot.toml that the robot was made of; empty if of none.
        digest: SHA-256 of that file, in hexadecimal.
        is_simulated: Whether the robot was simulated.
        program: The program that made the robot, if no file did.
        is_virtual: Whether its time was virtual: then all of it happens again, devices
            too.
        script: What ran the robot, if not `esair.run` alone: ``"demo"``, or ``"program"``
            for one of its user's; empty if nothing.

    Raises:
        RecordingBrokenError: It cannot be repeated, and why.
        OSError: It cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        facts = facts_of(path)
        if "replay" not in facts:
            told = "it has no turns: it is cut before the first, or of an earlier esair"
            raise RecordingBrokenError(str(path), told)
        self.facts = facts
        self.about: dict[str, str] = facts["replay"]
        if self.about.get("format") != FORMAT:
            told = "its turns were kept by another version of esair: it is not read"
            raise RecordingBrokenError(str(path), told)
        try:
            self.seed: int = int(facts["robot"]["seed"])
            exact, why = self.about["exact"], self.about["why"]
            self.file: str = self.about["file"]
            self.digest: str = self.about["sha256"]
            self.is_simulated: bool = self.about["simulated"] == "yes"
            self._has_seat = self.about["seat"] == "yes"
            lasts = self.about["duration"]
            self._duration = number_of(lasts) if lasts else None
            placed = json.loads(self.about.get("placed", "null"))
            self._placed: set[str] | None = placed and {*map(str, placed)}
        except (KeyError, ValueError, TypeError, RecursionError) as error:
            told = f"what it tells about itself is damaged: {describe(error)}"
            raise RecordingBrokenError(str(path), told) from error
        self.program: str = self.about.get("program", "")
        self.is_virtual: bool = self.about.get("clock") == "virtual"
        self.script: str = self.about.get("script", "")
        if exact != "yes":
            raise RecordingBrokenError(str(path), f"it is not exact: {why}")

    @property
    def options(self) -> dict[str, float]:
        """The numbers that the script was run with, by name.

        Raises:
            RecordingBrokenError: They are none.
        """
        try:
            told = json.loads(self.about["options"])
            return {str(name): number_of(value) for name, value in told.items()}
        except (KeyError, ValueError, TypeError, AttributeError, RecursionError):
            told = "what it tells about itself is damaged: options"
            raise RecordingBrokenError(str(self.path), told) from None

    def _place(self, robot: Robot) -> None:
        """Have components live where they did: a switch may have said so for that run."""
        if self._placed is None:
            return  # an earlier esair has kept none of it
        for each in (*robot.plan.resources, *robot.plan.behaviors):
            if is_placed(each) is not (each.name in self._placed):
                each.placement = "process" if each.name in self._placed else "task"

    def run(
        self,
        robot: Robot,
        script: Callable[[Robot], Coroutine[Any, Any, None]] | None = None,
        loop: asyncio.AbstractEventLoop | None = None,
    ) -> Outcome:
        """Repeat the run with a robot that was made as the recorded one.

        No driver is called, and it returns at the first difference.

        Args:
            robot: The robot, not started.
            script: A coroutine function that runs it, as the recorded one was run;
                `esair.run` unless given.
            loop: One with virtual time, on which all happens again, the devices too;
                one that plays what was recorded unless given.

        Raises:
            RecordingBrokenError: What was recorded cannot be read.
            ExceptionGroup: The robot cannot start; every mistake is named.
        """
        kept: Kept | None = None
        player: Player | None = None
        has_end = "end" in self.facts
        dropped = self._counted("dropped")
        chunks = chunks_of(self.path)
        if loop is None:
            kinds = kinds_of(lambda: components_of(robot), GIVEN)
            count = self._counted("turns")
            kept = Kept(self.path, chunks, kinds, whole=has_end, count=count)
            player = Player(kept, read=kept.read)
            if player.error is not None:
                raise player.error
            loop = TurnLoop(player=player)
        refused: list[BaseException] = []
        task: asyncio.Task[None]

        def diverged() -> None:
            loop.call_soon(over if player is None else player.end)

        def over() -> None:
            comparison.end()
            task.cancel()

        comparison = Comparison(
            self.path,
            count=0 if dropped else self._counted("events"),
            kept=kept,
            player=player,
            diverged=diverged,
        )
        self._place(robot)
        prepare_replay(robot, self.seed, has_seat=self._has_seat)
        listener = robot.journal.listen(comparison.hear, backlog=1 << 20)
        listener.is_waited_for = True  # what it was not told yet would be missed

        async def run() -> None:
            try:
                await (
                    script(robot) if script else run_to_its_end(robot, self._duration)
                )
            except BaseException as error:
                # The end of the recorded run, which a signal may have brought; or the
                # robot of today cannot start.
                if not (comparison.equal or comparison.is_over):
                    refused.append(error)

        async def main() -> None:
            nonlocal task
            task = asyncio.ensure_future(run())
            if player is not None:
                player.on_over = over
            await asyncio.wait({task})
            comparison.end()

        began = time.monotonic()
        try:
            run_and_end(main(), lambda: loop)
        finally:
            comparison.close()
            chunks.close()
        for error in refused:
            raise error
        if player and player.error is not None and not comparison.divergence:
            raise player.error
        span, lost = comparison.span, comparison.lost or dropped
        short = (kept and kept.spoiled) or ""
        if not short and lost:
            short = f"{lost} events were not recorded"
        if not short and not has_end:
            short = "it has no end: what came last may be missing"
        return Outcome(
            equal=comparison.equal,
            divergence=comparison.divergence,
            turns=span.turns,
            seconds=span.moment - span.began,
            took=time.monotonic() - began,
            short=short,
            late="" if player is None else player.late,
        )

    def _counted(self, what: str) -> int:
        """Return what the end of the recording counts; 0 if it does not."""
        told = self.facts.get("end", {}).get(what, "")
        return int(told) if told.isdecimal() and len(told) < 20 else 0


def number_of(told: Any) -> float:
    """Return a number that a recording tells: finite, and not of ages."""
    number = float(told) if isinstance(told, str) else told
    if type(number) not in {int, float} or not abs(number) < AGES:
        raise ValueError(f"expected a number, not {told!r:.40}")
    return number
