"""Recordings read back: whole ones, and what a file still has that is cut or damaged.

It may be hostile, too. One chunk is in memory at a time, within limits that no recorder
reaches: neither memory nor time depend on anything but the number of bytes that are there.
"""

from __future__ import annotations

import itertools
import json
import logging
import os
import re
import struct
import zlib
from collections.abc import Callable, Generator, Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO, Final, NamedTuple

from esair.exceptions import RecordingBrokenError

MAGIC: Final = b"\x89MCAP0\r\n"
"""What every MCAP file begins and ends with."""

CHUNK: Final = 33 << 20
"""The greatest chunk that is read, in bytes; one of a recorder has 1 MiB and a message."""

PART: Final = 4 << 20
"""The greatest part that is no chunk: facts, a topic."""

ALWAYS: Final = 64
"""How many messages a chunk may have whatever its size."""

PACKED: Final = 2
"""How many bytes of a packed chunk each further message takes at least."""

_BEGUN: Final = (1 << 64) - 1
"""The length of a chunk that was begun: its writer was killed before its end."""

_HEADER, _FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _METADATA = 1, 2, 3, 4, 5, 6, 12
_head = struct.Struct("<BQ").unpack_from
_chunk = struct.Struct("<QQQI").unpack_from
_message = struct.Struct("<HIQQ").unpack_from
_size = struct.Struct("<I").unpack_from

_log = logging.getLogger("esair")


class Start(NamedTuple):
    """The beginning of a file: who has written it, by which rules."""

    profile: str


class Fact(NamedTuple):
    """What a file tells about itself."""

    name: str
    told: dict[str, str]


class Shown(NamedTuple):
    """What the messages of a topic look like."""

    number: int
    name: str
    encoding: str
    data: bytes


class Topic(NamedTuple):
    """Where messages belong."""

    number: int
    schema: int
    name: str
    encoding: str
    facts: dict[str, str]


class Message(NamedTuple):
    """One message; its data is a view of its chunk."""

    channel: int
    sequence: int
    logged: int
    published: int
    data: memoryview


class End(NamedTuple):
    """The end of a file, all of which is as it was written."""


Part = Start | Fact | Shown | Topic | Message | End


class _DamagedError(Exception):
    """A part is not what was written."""


def need_unpackers() -> None:
    """Import what unpacks a recording: the package that writes one does without, silently."""
    import lz4.frame  # type: ignore[import-untyped]  # noqa: F401
    import zstandard  # noqa: F401


def parts_of(path: Path, *, skip_messages: bool = False) -> Iterator[Part]:
    """Yield the parts of an MCAP file up to where it is cut.

    What is not what was written is left out, with one line that says where.

    Args:
        path: The file.
        skip_messages: Whether chunks are passed over, unread.
    """
    need_unpackers()  # so that no file decides what is imported
    damaged = _Damaged()
    try:
        with path.open("rb") as file:
            if not file.seekable():  # it is read more than once
                told = "it is a pipe: save it to a file"
                raise RecordingBrokenError(str(path), told)
            if file.read(len(MAGIC)) == MAGIC:
                yield from _parts_of(file, damaged, skip_messages=skip_messages)
    finally:
        if damaged.count and damaged.begun and not skip_messages:
            others = damaged.count - 1
            more = f" and in {others} more places" if others else ""
            _log.warning(
                "%s: damaged at byte %d%s, left out", path, damaged.first, more
            )


class _Damaged:
    """Where a file is not what was written."""

    first = count = 0
    begun = False  # Else it is no such file, and that is told

    def note(self, place: int) -> None:
        self.first = self.first or place
        self.count += 1


def _parts_of(
    file: BinaryIO, damaged: _Damaged, *, skip_messages: bool
) -> Iterator[Part]:
    begin, end = file.tell(), os.fstat(file.fileno()).st_size
    while len(head := file.read(9)) == 9:
        kind, length = _head(head)
        following = begin + 9 + length
        if kind == _FOOTER and following + len(MAGIC) == end and not damaged.count:
            yield End()
        if kind == _FOOTER or length == _BEGUN or following > end:
            return
        limit = CHUNK if kind == _CHUNK else PART
        if kind in _READ and not (kind == _CHUNK and skip_messages):
            try:
                if length > limit:
                    raise _DamagedError
                data = memoryview(file.read(length))
                if kind == _CHUNK:
                    yield from _of_chunk(data)
                else:
                    part = _READ[kind](data)
                    damaged.begun = damaged.begun or kind == _HEADER
                    yield part
            except (_DamagedError, ValueError, struct.error, IndexError):
                damaged.note(begin)
        begin = following
        file.seek(begin)


def _of_chunk(data: memoryview) -> Iterator[Part]:
    """Yield what a chunk holds."""
    _, _, size, checksum = _chunk(data)
    place = 28
    packing, place = _text(data, place)
    length = struct.unpack_from("<Q", data, place)[0]
    packed = data[place + 8 : place + 8 + length]
    if size > CHUNK:
        raise _DamagedError
    whole = memoryview(_unpacked(packing, packed, size))
    if len(whole) != size or (checksum and zlib.crc32(whole) != checksum):
        raise _DamagedError
    most = ALWAYS + len(packed) // PACKED
    place = 0
    while place < size:
        kind, length = _head(whole, place)
        begin, place = place + 9, place + 9 + length
        if place > size:
            raise _DamagedError
        most -= 1
        if most < 0:  # nothing that a recorder writes is as much alike
            raise _DamagedError
        if kind in _READ and kind != _CHUNK:
            yield _READ[kind](whole[begin:place])


def _unpacked(packing: str, packed: memoryview, size: int) -> Any:
    if not packing:
        return packed
    if packing == "zstd":
        import zstandard

        try:
            about = zstandard.get_frame_parameters(packed)
            unknown = about.content_size >= zstandard.CONTENTSIZE_ERROR
            if about.window_size > CHUNK or not (unknown or about.content_size <= size):
                raise _DamagedError
            return zstandard.ZstdDecompressor().decompress(packed, max_output_size=size)
        except zstandard.ZstdError:
            raise _DamagedError from None
    if packing == "lz4":
        import lz4.frame

        try:
            return lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=size)
        except RuntimeError:
            raise _DamagedError from None
    raise _DamagedError


def _blob(data: memoryview, place: int) -> tuple[bytes, int]:
    begin = place + 4
    end = begin + _size(data, place)[0]
    if end > len(data):
        raise _DamagedError
    return bytes(data[begin:end]), end


def _text(data: memoryview, place: int) -> tuple[str, int]:
    found, end = _blob(data, place)
    return str(found, "utf-8"), end


def _table(data: memoryview, place: int) -> tuple[dict[str, str], int]:
    end = place + 4 + _size(data, place)[0]
    if end > len(data):
        raise _DamagedError
    place += 4
    table: dict[str, str] = {}
    while place < end:
        key, place = _text(data, place)
        table[key], place = _text(data, place)
    return table, place


def _number_at(data: memoryview, place: int) -> tuple[int, int]:
    return struct.unpack_from("<H", data, place)[0], place + 2


def _made_of(made: Callable[..., Part], *fields: Any) -> Callable[[memoryview], Part]:
    """Return what reads a part of which nothing but these fields is asked for."""

    def read(data: memoryview) -> Part:
        values, place = [], 0
        for each in fields:
            value, place = each(data, place)
            values.append(value)
        return made(*values)

    return read


def _of_message(data: memoryview) -> Message:
    channel, sequence, logged, published = _message(data)
    return Message(channel, sequence, logged, published, data[22:])


_READ: Final[dict[int, Any]] = {
    _HEADER: _made_of(Start, _text),
    _SCHEMA: _made_of(Shown, _number_at, _text, _text, _blob),
    _CHANNEL: _made_of(Topic, _number_at, _number_at, _text, _text, _table),
    _MESSAGE: _of_message,
    _CHUNK: None,
    _METADATA: _made_of(Fact, _text, _table),
}
"""What reads each kind of part; an index and the like are passed over."""


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
    name means the oldest that is left. What another run has made ends it: people number
    their runs, too.
    """
    stem, number = path.stem, 1
    if not path.exists():
        number = min(numbers_of(path), default=1)
    elif (found := _NUMBERED.fullmatch(stem)) and not any(numbers_of(path)):
        stem, number = found[1], int(found[2])
    first = path if number == 1 else path.with_stem(f"{stem}.{number}")
    yield first
    run: dict[str, str] = {}  # of which all are: of the first one that tells it
    later = (path.with_stem(f"{stem}.{each}") for each in itertools.count(number + 1))
    for segment in itertools.takewhile(Path.exists, later):
        run = run or _run_of(first) or _run_of(segment)
        if _run_of(segment) not in ({}, run):
            return
        yield segment


def _run_of(path: Path) -> dict[str, str]:
    """Return what no two runs have alike; empty of a file that was cut before it."""
    facts = (part for part in parts_of(path, skip_messages=True) if type(part) is Fact)
    return next((fact.told for fact in facts if fact.name == "clock"), {})


def numbers_of(path: Path) -> Iterator[int]:
    """Yield the numbers of the later segments of a recording, in any order."""
    for other in path.parent.glob(f"*{path.suffix}"):
        found = _NUMBERED.fullmatch(other.stem)
        if found and found[1] == path.stem:
            yield int(found[2])
