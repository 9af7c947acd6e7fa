"""What an MCAP file consists of, read part by part: it may be cut, damaged or hostile.

One chunk is in memory at a time, within limits that no recorder reaches: neither memory
nor time depend on anything but the number of bytes that are there.
"""

from __future__ import annotations

import logging
import os
import struct
import zlib
from collections.abc import Iterator
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
            more = (
                f" and in {damaged.count - 1} more places" if damaged.count > 1 else ""
            )
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


def _text(data: memoryview, place: int) -> tuple[str, int]:
    begin = place + 4
    end = begin + _size(data, place)[0]
    if end > len(data):
        raise _DamagedError
    return str(data[begin:end], "utf-8"), end


def _table(data: memoryview, place: int) -> dict[str, str]:
    end = place + 4 + _size(data, place)[0]
    if end > len(data):
        raise _DamagedError
    place += 4
    table: dict[str, str] = {}
    while place < end:
        key, place = _text(data, place)
        table[key], place = _text(data, place)
    return table


def _start(data: memoryview) -> Start:
    return Start(_text(data, 0)[0])


def _fact(data: memoryview) -> Fact:
    name, place = _text(data, 0)
    return Fact(name, _table(data, place))


def _shown(data: memoryview) -> Shown:
    name, place = _text(data, 2)
    encoding, place = _text(data, place)
    begin = place + 4
    end = begin + _size(data, place)[0]
    return Shown(
        struct.unpack_from("<H", data)[0], name, encoding, bytes(data[begin:end])
    )


def _topic(data: memoryview) -> Topic:
    number, schema = struct.unpack_from("<HH", data)
    name, place = _text(data, 4)
    encoding, place = _text(data, place)
    return Topic(number, schema, name, encoding, _table(data, place))


def _of_message(data: memoryview) -> Message:
    channel, sequence, logged, published = _message(data)
    return Message(channel, sequence, logged, published, data[22:])


_READ: Final[dict[int, Any]] = {
    _HEADER: _start,
    _SCHEMA: _shown,
    _CHANNEL: _topic,
    _MESSAGE: _of_message,
    _CHUNK: None,
    _METADATA: _fact,
}
"""What reads each kind of part; an index and the like are passed over."""
