"""The turns of a run in its recording: all that an exact replay needs.

They are pickled, because a driver may give any value; what is read back may only make
plain objects (see `_Unpickler`), so that a recording of somebody else runs no code.
"""

from __future__ import annotations

import collections
import dataclasses
import enum
import io
import itertools
import pickle
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import attrs

from esair.exceptions import RecordingBrokenError, describe
from esair.loop import SPOILED, First, TapeWriter

TOPIC = "/esair/journal"  # The topic of the turns
AT_ONCE = 64  # How many items are encoded at once: it holds up the loop meanwhile

LIMIT = 500_000
"""How many items may wait to be written; then the turns are kept no longer."""

HELD = 128 << 20
"""How many bytes of large values may wait: a slow disk must not take the memory."""


class Turns:
    """Takes the turns of a run in the loop, and gives them to the recorder's thread."""

    def __init__(self) -> None:
        self._waiting: collections.deque[Any] = collections.deque()
        self._numbers = itertools.count()
        self._came = self._went = 0  # Bytes: one thread adds to each
        self.tape = TapeWriter(self._put)  # What the loop writes on

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
        count = min(AT_ONCE, len(waiting))
        items = [waiting.popleft() for _ in range(count)]
        self._went += sum(map(_bulk_of_item, items))
        number = next(self._numbers)
        try:
            return _pickled((number, items))
        except Exception:  # a value may be an object of any class
            return _pickled((number, [each for it in items for each in _kept(it)]))


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


def _kept(item: Any) -> Iterator[Any]:
    """Yield an item, or one in its place if it cannot be kept."""
    try:
        _pickled(item)
    except Exception as error:
        tag, rest = item[0], item[1:]
        yield (
            SPOILED,
            0,
            f"what {' '.join(tag)} gave cannot be kept: {describe(error)}",
        )
        yield (
            (tag, First(waits=False, value=None, error=None))
            if len(rest) == 1
            else (tag, rest[0], (None, None))
        )
    else:
        yield item


class Kept(NamedTuple):
    """The turns that a recording holds.

    Attributes:
        items: What a `TapeWriter` has put, in its order.
        spoiled: Why the run cannot be repeated to its end; None if it can.
    """

    items: list[Any]
    spoiled: str | None


def turns_of(path: Path, chunks: list[bytes], programs: Sequence[str] = ()) -> Kept:
    """Return the turns of a recording.

    Args:
        path: The recording, for messages.
        chunks: What `contents_of` has found there.
        programs: The modules that may have been the program which was recorded.

    Raises:
        RecordingBrokenError: It holds none, or not the beginning; or they hold what is
            no plain data.
    """
    items: list[Any] = []
    spoiled: str | None = None
    for expected, data in enumerate(chunks):
        try:
            number, more = _Unpickler(io.BytesIO(data), programs).load()
        except pickle.UnpicklingError as error:
            raise RecordingBrokenError(str(path), str(error)) from error
        except Exception as error:
            raise RecordingBrokenError(
                str(path), f"its turns cannot be read: {describe(error)}"
            ) from error
        if number != expected:
            if not items:
                raise RecordingBrokenError(
                    str(path),
                    "its beginning is not there (an old segment was deleted): a run is "
                    "repeated from its start",
                )
            spoiled = "a part of it is missing"
            break
        items += more
    if not items:
        raise RecordingBrokenError(
            str(path),
            "it holds no turns: only runs of 'esair run', 'esair sim' and esair.run() "
            "with their own event loop can be repeated",
        )
    for place, item in enumerate(items):
        if type(item) is not float and item[0] == SPOILED:
            spoiled = item[2]
            del items[place:]
            break
    return Kept(items, spoiled)


# Bytes.


def _pickled(value: Any) -> bytes:
    out = io.BytesIO()
    _Pickler(out, protocol=5).dump(value)
    return out.getvalue()


class _Pickler(pickle.Pickler):
    """Writes errors by their class, arguments and cause: many cannot be made anew."""

    def reducer_override(self, value: Any) -> Any:
        if isinstance(value, BaseException):
            # What it refers to comes after it: two errors may be each other's cause.
            state = dict(vars(value)), value.__cause__
            made = new_error, (type(value), value.args)
            return (*made, state, None, None, fill_error)
        return NotImplemented


def new_error(kind: type[BaseException], args: tuple[Any, ...]) -> BaseException:
    """Make an error without its constructor."""
    error = kind.__new__(kind, *args)
    error.args = args
    return error


def fill_error(
    error: BaseException, state: tuple[dict[str, Any], BaseException | None]
) -> None:
    """Give an error its attributes and its cause back."""
    fields, error.__cause__ = state
    vars(error).update(fields)


_PLAIN = {
    ("builtins", name)
    for name in (
        "bytearray", "bytes", "complex", "dict", "float", "frozenset", "int", "list",
        "object", "range", "set", "slice", "str", "tuple",
    )
} | {
    ("collections", "OrderedDict"),
    ("collections", "deque"),
    ("copyreg", "_reconstructor"),
    ("datetime", "date"),
    ("datetime", "datetime"),
    ("datetime", "time"),
    ("datetime", "timedelta"),
    ("datetime", "timezone"),
    ("decimal", "Decimal"),
    ("fractions", "Fraction"),
    (new_error.__module__, new_error.__qualname__),
    (fill_error.__module__, fill_error.__qualname__),
}  # fmt: skip
"""What values are made of, beside plain classes."""

_ARRAYS = frozenset({"_reconstruct", "_frombuffer", "scalar", "dtype", "ndarray"})
"""What NumPy makes arrays with."""


class _Unpickler(pickle.Unpickler):
    """Makes plain data only: attrs and data classes, named tuples, enums, errors."""

    def __init__(self, data: io.BytesIO, programs: Sequence[str]) -> None:
        super().__init__(data)
        self._programs = programs

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) in _PLAIN or (
            module.partition(".")[0] == "numpy" and name in _ARRAYS
        ):
            return super().find_class(module, name)
        if module == "__main__":  # the program then; now it may be a module
            has = (it for it in self._programs if hasattr(sys.modules.get(it), name))
            module = next(has, module)
        found = super().find_class(module, name)
        if isinstance(found, type) and (
            attrs.has(found)
            or dataclasses.is_dataclass(found)
            or issubclass(found, enum.Enum | BaseException)
            or (issubclass(found, tuple) and hasattr(found, "_fields"))
            or module.startswith("numpy.dtypes")
        ):
            return found
        raise pickle.UnpicklingError(
            f"it holds a {module}.{name}, which is no plain data: what drivers give "
            "should be an attrs class, a data class, a named tuple or plain values"
        )
