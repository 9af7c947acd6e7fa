"""Recordings read back: whole ones, and what a cut file still has."""

from __future__ import annotations

import itertools
import json
import logging
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from esair.exceptions import RecordingBrokenError

TURNS = "esair-turns"  # The encoding of the messages that hold the turns of a run


_log = logging.getLogger("esair")


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
    """

    number: int
    time: float
    kind: str
    component: str
    peer: str
    value: Any
    text: str


_MAGIC = b"\x89MCAP0\r\n"  # What every MCAP file begins with

_NUMBERED = re.compile(r"(.+)\.([1-9][0-9]*)")  # The stem of a later segment

_BEGUN = b"\xff" * 8
"""The length of a chunk that was begun: its writer was killed before its end."""


def records_of(path: Path) -> Iterator[Any]:
    """Yield the records of an MCAP file up to where it is cut.

    A chunk that is not what was written is left out, with a word where it is.
    """
    from mcap.exceptions import EndOfFile
    from mcap.records import Chunk
    from mcap.stream_reader import StreamReader, breakup_chunk

    with path.open("rb") as file:
        if not file.seekable():  # it is read more than once
            raise RecordingBrokenError(str(path), "it is a pipe: save it to a file")
        if file.read(len(_MAGIC)) != _MAGIC:
            return
        file.seek(0)
        records = iter(StreamReader(file, emit_chunks=True).records)
        while True:
            begin = file.tell()
            try:
                record = next(records)
                parts = [record]
                if isinstance(record, Chunk):
                    parts = breakup_chunk(record, validate_crc=True)
            except (StopIteration, EndOfFile):
                return
            except OSError:
                raise
            except Exception:  # the reader meets whatever is there
                end = file.tell()
                file.seek(begin + 1)
                if file.read(len(_BEGUN)) == _BEGUN:
                    return
                file.seek(end)
                _log.warning("%s: damaged at byte %d, left out", path, begin)
                if end == begin:
                    return
                continue
            yield from parts


def events_of(path: str | Path) -> Iterator[Recorded]:
    """Yield the events of a recording, as far as it is readable, in their order.

    Those of its later segments too.

    Raises:
        RecordingBrokenError: It is no recording of esair at all.
    """
    for segment in segments_of(Path(path)):
        for kind, found in _parts_of(segment):
            if kind == "event":
                yield found


def facts_of(path: str | Path) -> dict[str, dict[str, str]]:
    """Return the facts that a recording tells about itself, by name."""
    from mcap.records import Metadata

    return {
        record.name: dict(record.metadata)
        for record in records_of(next(segments_of(Path(path))))
        if isinstance(record, Metadata)
    }


class Contents(NamedTuple):
    """All of a recording, its later segments too.

    Attributes:
        facts: What it tells about itself, by name.
        events: What has happened.
        turns: The turns of the run, as bytes.
    """

    facts: dict[str, dict[str, str]]
    events: list[Recorded]
    turns: list[bytes]


def contents_of(path: Path) -> Contents:
    """Read all of a recording, as far as it is readable.

    Raises:
        RecordingBrokenError: It is no recording of esair at all.
    """
    contents = Contents({}, [], [])
    for segment in segments_of(path):
        for kind, found in _parts_of(segment):
            if kind == "event":
                contents.events.append(found)
            elif kind == "turns":
                contents.turns.append(found)
            else:
                contents.facts.update(found)
    return contents


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


def _parts_of(path: Path) -> Iterator[tuple[str, Any]]:
    """Yield what is in a file: events, turns as bytes, and facts."""
    from mcap.records import Channel, Header, Message, Metadata

    topics: dict[int, str] = {}
    is_ours = False
    for record in records_of(path):
        if isinstance(record, Header):
            is_ours = record.profile == "esair"
        elif isinstance(record, Channel):
            if record.message_encoding in {"json", TURNS}:
                topics[record.id] = record.message_encoding
        elif isinstance(record, Metadata):
            yield "facts", {record.name: dict(record.metadata)}
        elif isinstance(record, Message) and is_ours and record.channel_id in topics:
            if topics[record.channel_id] == TURNS:
                yield "turns", record.data
                continue
            message = json.loads(record.data)
            told = message.get("esair", message)
            yield (
                "event",
                Recorded(
                    told["number"],
                    told["time"],
                    told["kind"],
                    told["component"],
                    told["peer"],
                    told.get("value"),
                    told["text"],
                ),
            )
    if not is_ours:
        raise RecordingBrokenError(str(path), "it is no recording of esair")
