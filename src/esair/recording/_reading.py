"""Recordings read back: whole ones, and what a cut file still has."""

from __future__ import annotations

import itertools
import json
import re
from collections.abc import Generator, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from esair.exceptions import RecordingBrokenError
from esair.recording._parts import Fact, Message, Start, Topic, parts_of

TURNS = "esair-turns-2"  # The encoding of the messages that hold the turns of a run

MESSAGE = 32 << 20
"""The greatest size of a message that is read, in bytes: a picture in the turns."""

EVENT = 4 << 20
"""The greatest size of an event, in bytes."""

FACTS = 64
"""How many kinds of facts a recording may tell about itself."""

NESTED = 40
"""How deep the value of an event may be nested."""

LATEST = 1e12
"""The greatest time, in seconds: that of no clock is greater."""

PROFILE = "esair"


class Recorded(NamedTuple):
    """An event of a recording; its value is plain: numbers, texts, lists, objects.

    Attributes:
        number: The number of the event.
        time: When, on the clock of the robot that recorded, in seconds.
        kind: What happened (a `esair.journal.Kind` as text).
        component: To which component.
        peer: The other one, if there is one.
        value: What it is about.
        text: Why.
        measured: When a reading was measured, if that was before it came in.
    """

    number: int
    time: float
    kind: str
    component: str
    peer: str
    value: Any
    text: str
    measured: float | None = None


_NUMBERED = re.compile(r"(.+)\.([1-9][0-9]*)")  # The stem of a later segment


def facts_of(path: str | Path) -> dict[str, dict[str, str]]:
    """Return the facts that a recording tells about itself, by name."""
    facts: dict[str, dict[str, str]] = {}
    for place, segment in enumerate(segments_of(Path(path))):
        is_ours = False
        for part in parts_of(segment, skip_messages=True):
            if isinstance(part, Start):
                is_ours = part.profile == PROFILE
            elif isinstance(part, Fact) and is_ours and len(facts) < FACTS:
                facts[part.name] = part.told
        if not (is_ours or place):  # a later one may have been cut when it began
            raise RecordingBrokenError(str(path), "it is no recording of esair")
    return facts


def events_of(path: str | Path) -> Generator[Recorded, None, None]:
    """Yield the events of a recording, as far as it is readable, in their order.

    Those of its later segments too. One is read at a time: a recording may be of any
    size.

    Raises:
        RecordingBrokenError: It is no recording of esair at all.
    """
    for data in _messages_of(Path(path), "json", EVENT):
        event = _event(data)
        if event is not None:
            yield event


def chunks_of(path: Path) -> Generator[bytes, None, None]:
    """Yield the turns of a recorded run, as `Turns` has made bytes of them.

    Raises:
        RecordingBrokenError: It is no recording of esair at all.
    """
    return _messages_of(path, TURNS, MESSAGE)


def _messages_of(path: Path, encoding: str, most: int) -> Generator[bytes, None, None]:
    """Yield the messages of one encoding, a file at a time."""
    for place, segment in enumerate(segments_of(path)):
        wanted: set[int] = set()
        is_ours = False
        for part in parts_of(segment):
            if isinstance(part, Message):
                if is_ours and part.channel in wanted and len(part.data) <= most:
                    yield bytes(part.data)
            elif isinstance(part, Start):
                is_ours = part.profile == PROFILE
            elif isinstance(part, Topic) and part.encoding == encoding:
                wanted.add(part.number)
        if not (is_ours or place):  # a later one may have been cut when it began
            raise RecordingBrokenError(str(path), "it is no recording of esair")


def _event(data: bytes) -> Recorded | None:
    """Return the event of a message; None if it is none that a recorder writes."""
    try:
        message = json.loads(data.decode())  # of bytes it would guess their encoding
        told = message.get("esair", message)
        found = Recorded(*map(told.get, Recorded._fields))
        texts = (*found[2:5], found.text)
        times = found.time, 0.0 if found.measured is None else found.measured
        is_one = (
            type(found.number) is int
            and all(type(each) in {int, float} for each in times)
            and all(abs(each) < LATEST for each in times)
            and all(type(each) is str for each in texts)
            and not _is_deep(data, found.value)
        )
    except (ValueError, TypeError, AttributeError, RecursionError):
        return None
    return found._replace(time=float(found.time)) if is_one else None


def _is_deep(data: bytes, value: Any) -> bool:
    """Tell whether a value is nested deeper than a recorder writes any."""
    if data.count(b"[") + data.count(b"{") <= NESTED:
        return False
    layer = [value]
    for _ in range(NESTED):
        layer = [
            part
            for each in layer
            if isinstance(each, list | dict)
            for part in (each.values() if isinstance(each, dict) else each)
            if isinstance(part, list | dict)
        ]
        if not layer:
            return False
    return True


class Gaps:
    """Hears the events of a recording, and tells what it lacks.

    Args:
        facts: What the recording tells about itself.

    Attributes:
        offset: The wall clock minus the robot's, in seconds.
    """

    def __init__(self, facts: Mapping[str, Mapping[str, str]]) -> None:
        self.offset: float = _number(facts.get("clock", {}).get("offset", ""))
        self._end = facts.get("end")
        self._number = self._missing = 0

    def hear(self, event: Recorded) -> None:
        """Hear of the next event."""
        if self._number and event.number > self._number + 1:
            self._missing += event.number - self._number - 1
        self._number = max(self._number, event.number)

    def told(self) -> str:
        """Return what it lacks, in words; empty if nothing."""
        missing = self._missing
        if self._end is not None:
            last = int(_number(self._end.get("events", "")))
            missing += max(0, last - self._number)
        words = []
        if missing:
            words.append(f"{missing} events were not recorded")
        if self._end is None:
            words.append("it has no end: what came last may be missing")
        return "; ".join(words)


def _number(text: str) -> float:
    try:
        number = float(text)
    except ValueError:
        return 0.0
    return number if abs(number) < LATEST else 0.0


def segments_of(path: Path) -> Iterator[Path]:
    """Yield the files of one recording: ``run.mcap``, ``run.2.mcap``, ...

    It begins with the one that is named. Where the first was deleted to make room, its
    name means the oldest that is left.
    """
    stem, number = path.stem, 1
    if not path.exists():
        number = min(_numbers_of(path), default=1)
    elif (found := _NUMBERED.fullmatch(stem)) and not any(_numbers_of(path)):
        stem, number = found[1], int(found[2])
    first = path if number == 1 else path.with_stem(f"{stem}.{number}")
    yield first
    for later in itertools.count(number + 1):
        segment = path.with_stem(f"{stem}.{later}")
        if not segment.exists():
            return
        yield segment


def _numbers_of(path: Path) -> Iterator[int]:
    """Yield the numbers of the later segments of a recording, in any order."""
    for other in path.parent.glob(f"*{path.suffix}"):
        found = _NUMBERED.fullmatch(other.stem)
        if found and found[1] == path.stem:
            yield int(found[2])
