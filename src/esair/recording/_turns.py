"""The turns of a run in its recording: all that an exact replay needs.

Each item has a small frame of its own: the moment of a turn, or whose call has begun or
ended. What a driver has given is coded by `esair.codec`, and decoded only in the turn in
which it takes effect again: then its class is there, and memory holds one turn.
"""

from __future__ import annotations

import collections
import logging
import struct
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, Final

from esair.codec import CodecError, Kinds, decode, encode
from esair.exceptions import RecordingBrokenError
from esair.loop import SPOILED, CallRefused, First, Tag, TapeWriter
from esair.messages import OpenReading, Reading, Stamped, StampedReading
from esair.recording._reading import MESSAGE

TOPIC = "/esair/journal"  # The topic of the turns
AT_ONCE = 64  # How many items are encoded at once: it holds up the loop meanwhile

LIMIT = 500_000
"""How many items may wait to be written; then the turns are kept no longer."""

HELD = 128 << 20
"""How many bytes of large values may wait: a slow disk must not take the memory."""

ROOM: Final = 1 << 16
"""How many bytes of a message are left for all but one value."""

LONGEST: Final = 4e9
"""For how long a computer has been on at most, in seconds: timers count twice as far."""

_MOMENT, _CAME, _FIRST, _WAITS, _SPOILED = b"MAFWX"
_moment = struct.Struct("<Bd")
_came = struct.Struct("<BHII")
_first = struct.Struct("<BHI")
_waits = struct.Struct("<BH")
_number = struct.Struct("<I")

GIVEN: Final = (Reading, StampedReading, OpenReading, Stamped, CallRefused)
"""The classes of what comes in whatever a robot's components declare."""

_WAITED: Final = First(waits=True, value=None, error=None)

_log = logging.getLogger("esair")


class Turns:
    """Takes the turns of a run in the loop, and gives them to the recorder's thread."""

    def __init__(self, kinds: Kinds) -> None:
        self._kinds = kinds
        self._waiting: collections.deque[Any] = collections.deque()
        self.chunks: int = 0
        """How many were given."""
        self._came = self._went = 0  # Bytes: one thread adds to each
        self.tape = TapeWriter(self._put)  # What the loop writes on
        self.spoiled: str | None = None
        """Why nothing more is kept; None as long as all is."""

    def _put(self, item: Any) -> None:
        """Keep an item, in the loop: the thread that writes may be stuck in the disk."""
        self._came += _bulk_of_item(item)
        if len(self._waiting) < LIMIT and self._came - self._went <= HELD:
            self._waiting.append(item)
        else:
            self.tape.close()
            why = "it could not be written fast enough"
            self._waiting.append((SPOILED, 0, why))

    def chunk(self) -> bytes:
        """Return the next items as bytes; empty if there are none."""
        waiting = self._waiting
        if not waiting:
            return b""
        out = bytearray(_number.pack(self.chunks))
        self.chunks += 1
        tags: dict[Tag, int] = {}
        for _ in range(min(AT_ONCE, len(waiting))):
            if len(out) > ROOM:
                break
            item = waiting.popleft()
            self._went += _bulk_of_item(item)
            if self.spoiled is None:
                self._write(item, out, tags)
        return bytes(out)

    def _write(self, item: Any, out: bytearray, tags: dict[Tag, int]) -> None:
        if type(item) is float:
            out += _moment.pack(_MOMENT, item)
            return
        tag, brought = item[0], item[-1]
        if tag == SPOILED:
            self._spoil(brought, out)
            return
        waits = type(brought) is First and brought.waits
        try:
            if type(brought) is First:
                brought = tuple(brought)
            data = b"" if waits else encode(brought, self._kinds, MESSAGE - 2 * ROOM)
        except CodecError as error:
            what = CodecError(error.reason, error.path.partition("]")[2])
            self._spoil(f"what {' '.join(tag)} gave cannot be kept: {what}", out)
            return
        is_new = tag not in tags
        number = tags.setdefault(tag, len(tags))
        if waits:
            out += _waits.pack(_WAITS, number)
        elif len(item) == 2:
            out += _first.pack(_FIRST, number, len(data))
        else:
            out += _came.pack(_CAME, number, item[1], len(data))
        if is_new:
            words = [each.encode() for each in tag]
            out += bytes((len(words),))
            for word in words:
                out += bytes((min(len(word), 255),)) + word[:255]
        out += data

    def _spoil(self, why: str, out: bytearray) -> None:
        """Keep no more, and say why: in the recording, and once in the log."""
        self.spoiled = why
        text = why.encode("utf-8", "replace")[:1000]
        out += _number.pack(len(text)).join([bytes((_SPOILED,)), text])
        _log.warning("recording: this run cannot be repeated from here on: %s", why)


def bulk_of(value: Any) -> int:
    """Return about how many bytes a value takes that is large, as a picture is.

    It is asked in the loop for each value: nothing of the value's own code runs.
    """
    kind = type(value)
    if kind is float:
        return 0
    if kind is tuple or kind is list:
        return 32 * len(value)
    if kind is bytes or kind is bytearray:
        return len(value)
    is_array = kind is memoryview or kind.__module__ == "numpy"
    return getattr(value, "nbytes", 0) if is_array else 0


def _bulk_of_item(item: Any) -> int:
    """Return that of what an item of the tape has brought: with an error, or alone."""
    if type(item) is float:  # the moment of a turn
        return 0
    brought = item[-1]
    is_end = type(brought) is First or (type(brought) is tuple and len(brought) == 2)
    return bulk_of(brought[-2] if is_end else brought)


class Kept:
    """The turns that a recording holds, read once, in their order.

    Args:
        path: The recording, for messages.
        chunks: What `chunks_of` finds there.
        kinds: The classes that may come back.
        whole: Whether the recording was ended; else its last turn may be a part of one.
        count: How many chunks there were, where the end of the recording tells.

    Attributes:
        spoiled: Why the run cannot be repeated to its end; None if it can, or if that
            is further on.
    """

    def __init__(
        self,
        path: Path,
        chunks: Iterable[bytes],
        kinds: Kinds,
        *,
        whole: bool = True,
        count: int = 0,
    ) -> None:
        self._path = path
        self._chunks = chunks
        self._kinds = kinds
        self._whole = whole
        self._count = count
        self._is_found = False  # a whole turn
        self.spoiled: str | None = None

    def __iter__(self) -> Iterator[Any]:
        """Yield what a `TapeWriter` has put, up to the end of the last whole turn.

        A part of a turn is none: what it lacks, the robot would miss in that turn. What
        came in is still to be read. Of the first turn there is its moment in any case.

        Raises:
            RecordingBrokenError: There are none, or not their beginning, or they are
                not what `Turns` has written.
        """
        turn = list[Any]()
        for item in self._items():
            if type(item) is float and turn:
                yield from turn
                turn.clear()
                self._is_found = True
            turn.append(item)
        if self._whole and self.spoiled is None:
            yield from turn
        elif not self._is_found:
            yield from turn[:1]

    def _items(self) -> Iterator[Any]:
        found = False
        now = 0.0
        for expected, data in enumerate(self._chunks):
            try:
                (number,) = _number.unpack_from(data)
                if number == expected:
                    for item in _items_of(data):
                        found = True
                        if type(item) is float:
                            if not now <= item < LONGEST:  # no clock goes back
                                raise ValueError
                            now = item
                        elif type(item) is str:
                            self.spoiled = item
                            return
                        yield item
            except (struct.error, IndexError, ValueError):
                raise self._broken("its turns are damaged") from None
            if number != expected:
                if not found:
                    raise self._broken(
                        "its beginning is not there (an old segment was deleted): a run "
                        "is repeated from its start"
                    )
                break
        if not found:
            raise self._broken(
                "it holds no turns: only runs of 'esair run', 'esair sim' and "
                "esair.run() with their own event loop can be repeated"
            )
        if number != expected or expected + 1 < self._count:
            self.spoiled = "a part of it is missing"

    def read(self, kept: Any) -> Any:
        """Return what came in.

        Raises:
            RecordingBrokenError: It holds what the robot does not declare.
        """
        if type(kept) is not bytes:
            return kept
        try:
            return decode(kept, self._kinds, MESSAGE)
        except CodecError as error:
            raise self._broken(str(error)) from None

    def _broken(self, why: str) -> RecordingBrokenError:
        return RecordingBrokenError(str(self._path), why)


def _items_of(data: bytes) -> Iterator[Any]:
    """Yield the items of a chunk; a text says why there are no more."""
    tags: list[Tag] = []
    place = _number.size
    while place < len(data):
        kind = data[place]
        if kind == _MOMENT:
            yield _moment.unpack_from(data, place)[1]
            place += _moment.size
            continue
        if kind == _SPOILED:
            begin = place + 1 + _number.size
            size = _number.unpack_from(data, place + 1)[0]
            yield data[begin : begin + size].decode("utf-8", "replace")
            return
        form = _FORMS[kind]
        _, number, *rest = form.unpack_from(data, place)
        place += form.size
        if number == len(tags):
            tag, place = _tag_of(data, place)
            tags.append(tag)
        if kind == _WAITS:
            yield tags[number], _WAITED
            continue
        begin, place = place, place + rest[-1]
        if place > len(data):
            raise IndexError
        yield (tags[number], *rest[:-1], data[begin:place])


_FORMS: Final = {_CAME: _came, _FIRST: _first, _WAITS: _waits}


def _tag_of(data: bytes, place: int) -> tuple[Tag, int]:
    words = []
    count, place = data[place], place + 1
    for _ in range(count):
        begin = place + 1
        place = begin + data[place]
        words.append(data[begin:place].decode())
    if not words or place > len(data):
        raise IndexError
    return tuple(words), place
