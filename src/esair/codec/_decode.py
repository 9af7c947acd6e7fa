"""Bytes as plain data: nothing is imported, nothing of anybody's code is called."""

from __future__ import annotations

import collections
import datetime
import decimal
import enum
import fractions
import math
import re
import struct
import sys
from collections.abc import Callable
from typing import Any, Final

from esair.codec._encode import VERSION
from esair.codec._kinds import (
    DEPTH,
    DIGITS,
    ITEMS,
    LIMIT,
    PACKED,
    SMALLEST,
    STRANGERS,
    CodecError,
    Form,
    Kinds,
    Shape,
)

_number = struct.Struct("<q").unpack_from
_float = struct.Struct("<d").unpack_from
_complex = struct.Struct("<dd").unpack_from
_size = struct.Struct("<I").unpack_from
_short = struct.Struct("<H").unpack_from

Defined = tuple[str, Any, Shape | None, Any]
"""What a class is: its name, itself if it is known, and the names of its fields."""

ALIKE: Final = 64
"""How many keys of a table may have the same hash: more take it far too long."""

_MISSING: Final = object()  # what a field is that was not set


def decode(data: bytes, kinds: Kinds, limit: int = LIMIT) -> Any:
    """Return the value of which `encode` has made bytes.

    Args:
        data: The bytes; they may be anybody's.
        kinds: The classes that may come back.
        limit: How many bytes it may have.

    Raises:
        CodecError: It is nothing that `encode` makes of these classes, or too large.
    """
    if len(data) > limit:
        raise CodecError(f"it has {len(data)} bytes, at most {limit} are read")
    if data[:1] != VERSION:
        raise CodecError("it is not in this version's coding")
    reader = _Reader(data, kinds, limit)
    try:
        value = reader.take(DEPTH)
        reader.end()
    except CodecError:
        raise
    except Exception as error:  # whatever such bytes lead to
        told = f"damaged at byte {reader.place} ({type(error).__name__})"
        raise CodecError(told) from None
    return value


class _Reader:
    __slots__ = ("classes", "data", "errors", "items", "kinds", "place")

    def __init__(self, data: bytes, kinds: Kinds, limit: int) -> None:
        self.data = data
        self.kinds = kinds
        self.place = 1
        self.items = min(limit // SMALLEST, ITEMS)
        self.classes: list[Defined] = []
        self.errors: list[BaseException] = []

    def take(self, depth: int) -> Any:
        data, place = self.data, self.place
        tag = data[place]
        if tag == 0x66:  # f
            self.place = place + 9
            return _float(data, place + 1)[0]
        if tag == 0x73:  # s
            begin = place + 2
            self.place = end = begin + data[place + 1]
            return self.text(begin, end)
        self.place = place + 1
        if tag == 0x74 or tag == 0x6C:  # t, l
            values = self.row(depth)
            return tuple(values) if tag == 0x74 else values
        if tag == 0x69:  # i
            self.place = place + 9
            return _number(data, place + 1)[0]
        return _TAKE[tag](self, depth)

    def end(self) -> None:
        if self.place != len(self.data):
            raise CodecError(f"damaged at byte {self.place} (it goes on)")

    def text(self, begin: int, end: int) -> str:
        if end > len(self.data):
            raise IndexError
        return self.data[begin:end].decode("utf-8", "surrogatepass")

    def blob(self) -> bytes:
        begin = self.place + 4
        end = begin + _size(self.data, self.place)[0]
        if end > len(self.data):
            raise IndexError
        self.place = end
        return self.data[begin:end]

    def count(self, items: int) -> None:
        self.items -= items
        if self.items < 0:
            raise CodecError("it has too many items")

    def head(self, depth: int, weight: int = 1) -> int:
        if depth <= 0:
            raise CodecError(f"it is nested deeper than {DEPTH}")
        size: int = _size(self.data, self.place)[0]
        self.place += 4
        self.count(weight + size)
        return size

    def row(self, depth: int) -> list[Any]:
        size = self.head(depth)
        take, depth = self.take, depth - 1
        return [take(depth) for _ in range(size)]

    def packed(self, depth: int) -> Any:
        is_tuple = self.data[self.place] == 0x74
        size = _size(self.data, self.place + 1)[0]
        self.count(1 + size // PACKED)
        begin = self.place + 5
        values = struct.unpack_from(f"<{size}d", self.data, begin)
        self.place = begin + 8 * size
        return values if is_tuple else list(values)

    def pairs(self, depth: int) -> dict[Any, Any]:
        size = self.head(depth, 2)
        self.count(size)
        take, depth = self.take, depth - 1
        keys, values = [], []
        for _ in range(size):
            keys.append(take(depth))
            values.append(take(depth))
        _check_spread(keys)
        return dict(zip(keys, values, strict=True))

    def many(self, depth: int, weight: int = 4) -> list[Any]:
        size = self.head(depth, weight)
        take, depth = self.take, depth - 1
        values = [take(depth) for _ in range(size)]
        _check_spread(values)
        return values

    def parts(self, count: int, depth: int) -> list[Any]:
        if depth <= 0:
            raise CodecError(f"it is nested deeper than {DEPTH}")
        self.count(1)
        return [self.take(depth - 1) for _ in range(count)]

    def deque(self, depth: int) -> Any:
        (longest,) = self.parts(1, depth)
        if self.data[self.place] != 0x51:  # Q
            raise IndexError
        self.place += 1
        size = self.head(depth, 16)
        values = [self.take(depth - 1) for _ in range(size)]
        return collections.deque(values, longest)

    def whole(self, depth: int) -> int:
        data = self.blob()
        if len(data) > DIGITS // 3:
            raise CodecError(f"it has more than {DIGITS} digits")
        return int.from_bytes(data, "little", signed=True)

    def of_class(self, form: Form) -> Defined:
        """Take the number of a class, the first time what it is too."""
        number = _short(self.data, self.place)[0]
        self.place += 2
        if number == len(self.classes):
            begin = self.place + 2
            self.place = end = begin + _short(self.data, self.place)[0]
            known, definition = self.kinds.known, (form, self.data[begin:end])
            found: Defined | None = known.get(definition)
            if found is None:
                found = self.defined(form, definition[1])
                if len(known) < STRANGERS:
                    known[definition] = found
            self.classes.append(found)
        known_before: Defined = self.classes[number]
        return known_before

    def defined(self, form: Form, definition: bytes) -> Defined:
        """Return what the definition of a class says, as far as it is known here."""
        name, about = decode(definition, self.kinds, 0xFFFF)
        if type(name) is not str:
            raise IndexError
        found = self.kinds.find(name)
        if found is not None and found[1].form is form:
            return name, *found, about
        if form is Form.ERROR:
            return name, self.kinds.error(name, about), Shape(Form.ERROR), about
        if self.kinds.strangers:
            return name, None, None, about
        told = name.replace(":", ".")[:120]
        raise CodecError(f"it holds a {told!r}, which the robot does not declare")

    def fields(self, depth: int, about: Any) -> dict[str, Any]:
        """Take the fields of an object by their names when it was sent."""
        if depth <= 0:
            raise CodecError(f"it is nested deeper than {DEPTH}")
        if type(about) is not tuple or not all(type(each) is str for each in about):
            raise IndexError
        self.count(3 + len(about))
        found: dict[str, Any] = {}
        for name in about:
            if self.data[self.place] == 0x2D:  # -
                self.place += 1
                found[name] = _MISSING
            else:
                found[name] = self.take(depth - 1)
        return found

    def check_fields(self, name: str, shape: Shape, found: dict[str, Any]) -> None:
        """Compare the fields with those that the class has now."""
        if tuple(found) == shape.fields:
            return
        wanted = set(shape.fields)
        for each in found.keys() ^ wanted:
            if each in shape.defaults and each in wanted:
                found[each] = shape.defaults[each]
                continue
            told = "has a field" if each in wanted else "has no field"
            raise CodecError(
                f"{name.replace(':', '.')} {told} {each!r:.40} now, which was otherwise "
                "when it was sent"
            )

    def more(self, depth: int, name: str, shape: Shape | None) -> dict[str, Any]:
        """Take the attributes that an object had beside its fields."""
        found = self.take(depth - 1)
        if found is None:
            return {}
        if type(found) is not dict or not all(type(each) is str for each in found):
            raise IndexError
        if shape is not None and not shape.has_more:
            told = f"{name.replace(':', '.')} has no room for {[*found][:3]!r:.80} now"
            raise CodecError(told)
        return found

    def record(self, depth: int) -> Any:
        name, kind, shape, about = self.of_class(Form.RECORD)
        found = self.fields(depth, about)
        more = self.more(depth, name, shape)
        if shape is None:
            return {**found, **more}
        self.check_fields(name, shape, found)
        made = object.__new__(kind)
        slots = shape.slots
        for each, value in found.items():
            if value is _MISSING:
                continue
            if each in slots:
                slots[each].__set__(made, value)
            else:
                more[each] = value
        if more:
            made.__dict__.update(more)
        return made

    def named(self, depth: int) -> Any:
        name, kind, shape, about = self.of_class(Form.TUPLE)
        found = self.fields(depth, about)
        more = self.more(depth, name, shape)
        if shape is None:
            return {**found, **more}
        self.check_fields(name, shape, found)
        made = tuple.__new__(kind, [found[each] for each in shape.fields])
        if more:
            made.__dict__.update(more)
        return made

    def member(self, depth: int) -> Any:
        name, kind, shape, _ = self.of_class(Form.ENUM)
        if depth <= 0:
            raise CodecError(f"it is nested deeper than {DEPTH}")
        self.count(1)
        wanted = self.take(depth - 1)
        if shape is None:
            return wanted
        if type(wanted) is str:
            members = vars(kind)["_member_map_"]
            if wanted in members:
                return members[wanted]
        elif type(wanted) is int and issubclass(kind, enum.Flag):
            return _flags(kind, wanted)
        raise CodecError(f"{name.replace(':', '.')} has no {wanted!r:.40} now")

    def error(self, depth: int) -> BaseException:
        _, kind, _, _ = self.of_class(Form.ERROR)
        if depth <= 0:
            raise CodecError(f"it is nested deeper than {DEPTH}")
        self.count(8)
        args = self.take(depth - 1)
        if type(args) is not tuple:
            raise IndexError
        made = _new_error(kind, args)
        self.errors.append(made)
        files = self.take(depth - 1)
        if files and isinstance(made, OSError):
            made.filename = files[0]
            if files[1] is not None:
                made.filename2 = files[1]
        fields = self.take(depth - 1)
        if type(fields) is not dict or not all(type(each) is str for each in fields):
            raise IndexError
        made.__dict__.update(fields)
        cause = self.take(depth - 1)
        if cause is not None:
            made.__cause__ = cause
        return made

    def known_error(self, depth: int) -> BaseException:
        number = _short(self.data, self.place)[0]
        self.place += 2
        error: BaseException = self.errors[number]
        return error

    def array(self, depth: int) -> Any:
        token, shape, data = self.take(10), self.take(4), self.take(1)
        numpy: Any = sys.modules.get("numpy")
        if numpy is None:
            raise CodecError("it holds an array, and NumPy is not loaded")
        dtype = _dtype(numpy, token)
        if dtype.hasobject or not dtype.itemsize:
            raise CodecError("it holds an array of objects")
        if shape is None:
            return numpy.frombuffer(data, dtype)[0]
        if not all(type(each) is int and each >= 0 for each in shape):
            raise IndexError
        if math.prod(shape) * dtype.itemsize != len(data):
            raise CodecError("it holds an array of another size")
        return numpy.frombuffer(bytearray(data), dtype).reshape(shape)


_SCALAR: Final = re.compile(
    r"[<>|=][?biufcSUMmV][0-9]{0,9}(\[[0-9]{0,6}[a-zA-Z]{1,2}\])?"
)


def _dtype(numpy: Any, token: Any, depth: int = 4) -> Any:
    """Return the type of an array's items, made of what was checked."""
    if type(token) is str:
        if not _SCALAR.fullmatch(token):
            raise CodecError(f"it holds an array of {token!r:.40}")
        return numpy.dtype(token)
    if type(token) is not tuple or not depth or type(token[0]) is not int:
        raise CodecError("it holds an array of something else")
    names, formats, offsets = [], [], []
    for name, part, offset, shape in token[1:]:
        if type(name) is not str or type(offset) is not int or type(shape) is not tuple:
            raise CodecError("it holds an array of something else")
        inner = _dtype(numpy, part, depth - 1)
        if not all(type(each) is int and 0 <= each < 1 << 20 for each in shape):
            raise CodecError("it holds an array of something else")
        if math.prod(shape) * inner.itemsize > token[0]:
            raise CodecError("it holds an array of something else")
        names.append(name)
        formats.append((inner, shape) if shape else inner)
        offsets.append(offset)
    wanted = {"names": names, "formats": formats, "offsets": offsets}
    return numpy.dtype({**wanted, "itemsize": token[0]})


def _new_error(kind: Any, args: tuple[Any, ...]) -> BaseException:
    """Make an error by what Python itself makes it with, never by its own code."""
    base = next(each for each in kind.__mro__ if each.__module__ == "builtins")
    made: BaseException = base.__new__(kind, *args)
    base.__init__(made, *args)  # of a class that is Python's own
    made.args = args
    return made


def _flags(kind: Any, value: int) -> Any:
    known = vars(kind)["_value2member_map_"].get(value)
    if known is not None:
        return known
    if value.bit_length() > 64:
        raise IndexError
    missing: Any = vars(enum.Flag)["_missing_"]  # Python's own, not that of the class
    return missing.__func__(kind, value)


def _check_spread(keys: list[Any]) -> None:
    """Refuse keys that were chosen so that a table of them takes forever."""
    if len(keys) <= ALIKE or all(type(each) is str for each in keys):
        return
    hashes = sorted(map(hash, keys))
    if any(one == other for one, other in zip(hashes, hashes[ALIKE:], strict=False)):
        raise CodecError("it has too many keys that are alike")


def _made(count: int, make: Callable[..., Any]) -> Callable[[_Reader, int], Any]:
    """Return what makes a value of a built-in class of its parts."""
    return lambda reader, depth: make(*reader.parts(count, depth))


def _decimal(text: str) -> decimal.Decimal:
    if type(text) is not str or len(text) > DIGITS:
        raise CodecError(f"it has more than {DIGITS} digits")
    return decimal.Decimal(text)


def _moment(parts: Any, zone: Any) -> datetime.datetime:
    *day_and_time, fold = parts
    moment = datetime.datetime(*day_and_time, fold=fold)  # noqa: DTZ001 - its own follows
    return moment.replace(tzinfo=_zone_of(zone))


def _time(parts: Any, zone: Any) -> datetime.time:
    *time, fold = parts
    return datetime.time(*time, fold=fold).replace(tzinfo=_zone_of(zone))


def _zone(offset: Any, name: Any) -> datetime.timezone:
    if type(offset) is not datetime.timedelta:
        raise IndexError
    made = datetime.timezone
    return made(offset) if name is None else made(offset, name)


def _fraction(one: Any, other: Any) -> fractions.Fraction:
    if type(one) is not int or type(other) is not int:
        raise IndexError
    return fractions.Fraction(one, other)


def _zone_of(zone: Any) -> datetime.timezone | None:
    if zone is not None and type(zone) is not datetime.timezone:
        raise IndexError
    return zone


def _next_complex(reader: _Reader, _: int) -> complex:
    place, reader.place = reader.place, reader.place + 16
    return complex(*_complex(reader.data, place))


def _long_text(reader: _Reader, _: int) -> str:
    return reader.blob().decode("utf-8", "surrogatepass")


_TAKE: Final[dict[int, Callable[[_Reader, int], Any]]] = {
    ord(tag): take
    for tag, take in {
        "N": lambda _reader, _: None,
        "T": lambda _reader, _: True,
        "F": lambda _reader, _: False,
        "I": _Reader.whole,
        "S": _long_text,
        "b": lambda reader, _: reader.blob(),
        "B": lambda reader, _: bytearray(reader.blob()),
        "c": _next_complex,
        "d": _Reader.packed,
        "m": _Reader.pairs,
        "O": lambda reader, depth: collections.OrderedDict(reader.pairs(depth)),
        "u": lambda reader, depth: set(reader.many(depth)),
        "v": lambda reader, depth: frozenset(reader.many(depth)),
        "q": _Reader.deque,
        "r": _made(3, range),
        "w": _made(3, slice),
        "D": _made(1, datetime.date.fromordinal),
        "h": _made(2, _time),
        "M": _made(2, _moment),
        "E": _made(3, datetime.timedelta),
        "U": lambda _reader, _: datetime.UTC,
        "z": _made(2, _zone),
        "C": _made(1, _decimal),
        "R": _made(2, _fraction),
        "o": _Reader.record,
        "n": _Reader.named,
        "e": _Reader.member,
        "X": _Reader.error,
        "x": _Reader.known_error,
        "a": _Reader.array,
    }.items()
}
