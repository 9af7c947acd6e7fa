"""Plain data as bytes, and back: a tag for each value, then what it consists of.

Reading imports nothing, and calls nothing of anybody's code.
"""

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
from operator import attrgetter
from typing import Any, Final

from esair.codec._kinds import (
    DEPTH,
    LIMIT,
    STRANGERS,
    CodecError,
    Form,
    Kinds,
    Shape,
    name_of,
)

VERSION: Final = b"\x01"

ITEMS: Final = 500_000
"""How many items a message may have in all, whatever its size."""

SMALLEST: Final = 8
"""One item for so many bytes that a message may have: memory follows from its size."""

PACKED: Final = 4
"""How many numbers of a row count as one item, and from how many on it is packed."""

DIGITS: Final = 10_000
"""How many digits a whole or decimal number may have."""

ALIKE: Final = 64
"""How many keys of a table may have the same hash: more take it far too long."""

_NUMBER: Final = struct.Struct("<q")
_FLOAT: Final = struct.Struct("<d")
_COMPLEX: Final = struct.Struct("<dd")
_SIZE: Final = struct.Struct("<I")
_SHORT: Final = struct.Struct("<H")
_put_number = struct.Struct("<cq").pack
_put_float = struct.Struct("<cd").pack
_put_size = struct.Struct("<cI").pack
_FLOAT_ALONE: Final = struct.Struct("<ccd")
_NONE_ALONE: Final = VERSION + b"N"
_LENGTH: Final = [bytes((each,)) for each in range(256)]
_LONG: Final = 1 << 63
_FLOATS: Final = {float}
_MISSING: Final = object()

Defined = tuple[str, Any, Shape | None, Any]
"""What a class is: its name, itself if it is known, and the names of its fields."""


def encode(value: Any, kinds: Kinds, limit: int = LIMIT, items: int = ITEMS) -> bytes:
    """Return a value as bytes.

    Args:
        value: The value.
        kinds: The classes that may cross.
        limit: How many bytes it may have.
        items: How many items it may have.

    Raises:
        CodecError: It cannot cross: which part of it, and why.
    """
    if type(value) is float:
        return _FLOAT_ALONE.pack(VERSION, b"f", value)
    if value is None:
        return _NONE_ALONE
    writer = _Writer(kinds, limit, items)
    try:
        writer.put(value, DEPTH)
        writer.check_size()
    except CodecError:
        raise
    except RecursionError:
        raise CodecError("it is nested too deep") from None
    except Exception as error:  # a property or a descriptor of anybody's class
        raise CodecError(f"{type(error).__name__} while it was read") from error
    return bytes(writer.out)


def decode(data: bytes, kinds: Kinds, limit: int = LIMIT, items: int = ITEMS) -> Any:
    """Return the value of which `encode` has made bytes.

    Args:
        data: The bytes; they may be anybody's.
        kinds: The classes that may come back.
        limit: How many bytes it may have.
        items: How many items it may have: how long it takes follows from that.

    Raises:
        CodecError: It is nothing that `encode` makes of these classes, or too large.
    """
    if len(data) > limit:
        raise CodecError(f"it has {len(data)} bytes, at most {limit} are read")
    if data[:1] != VERSION:
        raise CodecError("it is not in this version's coding")
    if len(data) == _FLOAT_ALONE.size and data[1] == 0x66:  # f
        return _FLOAT.unpack_from(data, 2)[0]
    reader = _Reader(data, kinds, limit, items)
    try:
        value = reader.take(DEPTH)
        if reader.place != len(data):
            raise CodecError(f"damaged at byte {reader.place} (it goes on)")
    except CodecError:
        raise
    except Exception as error:  # whatever such bytes lead to
        told = f"damaged at byte {reader.place} ({type(error).__name__})"
        raise CodecError(told) from None
    return value


class _Walk:
    """What is counted on the way through a value, in both directions."""

    __slots__ = ("items", "kinds")
    items: int
    kinds: Kinds

    def count(self, items: int) -> None:
        self.items -= items
        if self.items < 0:
            raise CodecError("it has too many items")

    def nest(self, depth: int, items: int) -> int:
        """Go into something of so many items; return how deep it may still go."""
        self.items -= items
        if depth <= 0:
            raise CodecError(f"it is nested deeper than {DEPTH}")
        if self.items < 0:  # hot: as `count`
            self.count(0)
        return depth - 1


class _Writer(_Walk):
    __slots__ = ("classes", "errors", "limit", "out")

    def __init__(self, kinds: Kinds, limit: int, items: int) -> None:
        self.kinds = kinds
        self.items = min(limit // SMALLEST, items)
        self.limit = limit
        self.out = bytearray(VERSION)
        self.classes: dict[type, int] = {}
        self.errors: dict[int, tuple[int, BaseException]] = {}

    def put(self, value: Any, depth: int) -> None:
        kind = type(value)
        out = self.out
        if kind is float:
            out += _put_float(b"f", value)
        elif kind is str:
            data = value.encode("utf-8", "surrogatepass")
            size = len(data)
            out += b"s" + _LENGTH[size] if size < 256 else _put_size(b"S", size)
            out += data
        elif value is None:
            out += b"N"
        elif kind is tuple:
            self.row(b"t", value, depth)
        elif kind is int:
            if -_LONG <= value < _LONG:
                out += _put_number(b"i", value)
            else:
                self.long(value)
        elif kind is bool:
            out += b"T" if value else b"F"
        elif kind is list:
            self.row(b"l", value, depth)
        elif (put := _PUT.get(kind)) is not None:
            put(self, value, depth)
        else:
            self.put_other(kind, value, depth)

    def check_size(self, more: int = 0) -> None:
        if len(self.out) + more > self.limit:
            raise CodecError(f"it has more than {self.limit} bytes")

    def head(self, tag: bytes, size: int, depth: int, weight: int = 1) -> int:
        depth = self.nest(depth, weight + size)
        if len(self.out) > self.limit:  # hot: as `check_size`
            self.check_size()
        self.out += _put_size(tag, size)
        return depth

    def row(self, tag: bytes, values: Any, depth: int) -> None:
        """Put a list or tuple; one of floats alone is packed."""
        size = len(values)
        if (
            size >= PACKED
            and type(values[0]) is float
            and set(map(type, values)) == _FLOATS
        ):
            self.count(1 + size // PACKED)
            self.check_size(8 * size)
            self.out += b"d" + _put_size(tag, size) + struct.pack(f"<{size}d", *values)
            return
        depth = self.head(tag, size, depth)
        put, out = self.put, self.out
        try:
            for place, each in enumerate(values):  # noqa: B007 - told if it fails
                if type(each) is float:  # hot
                    out += _put_float(b"f", each)
                elif each is None:
                    out += b"N"
                else:
                    put(each, depth)
        except CodecError as error:
            raise error.below(f"[{place}]") from None

    def long(self, value: int) -> None:
        data = value.to_bytes(value.bit_length() // 8 + 1, "little", signed=True)
        if len(data) > DIGITS // 3:
            raise CodecError(f"it has more than {DIGITS} digits")
        self.blob(data, b"I")

    def blob(self, value: Any, tag: bytes) -> None:
        self.check_size(len(value))
        self.out += _put_size(tag, len(value)) + value

    def pairs(self, value: Any, depth: int, tag: bytes = b"m") -> None:
        depth = self.head(tag, len(value), depth, 2 + len(value))
        for key, each in value.items():
            try:
                self.put(key, depth)
                self.put(each, depth)
            except CodecError as error:
                name = f".{key}" if type(key) is str else f"[{key!r:.40}]"
                raise error.below(name) from None

    def many(self, value: Any, depth: int, tag: bytes, weight: int = 4) -> None:
        depth = self.head(tag, len(value), depth, weight)
        for each in value:
            self.put(each, depth)

    def parts(self, tag: bytes, values: tuple[Any, ...], depth: int) -> None:
        """Put what a value of a built-in class is made of."""
        depth = self.nest(depth, 1)
        self.out += tag
        for each in values:
            self.put(each, depth)

    def zone(self, value: datetime.timezone, depth: int) -> None:
        if value is datetime.UTC:
            self.out += b"U"
            return
        offset, name = value.utcoffset(None), value.tzname(None)
        is_named = name != datetime.timezone(offset).tzname(None)
        self.parts(b"z", (offset, name if is_named else None), depth)

    def deque(self, value: collections.deque[Any], depth: int) -> None:
        self.parts(b"q", (value.maxlen,), depth)
        self.many(value, depth, b"Q", 16)

    def put_other(self, kind: type, value: Any, depth: int) -> None:
        numpy = sys.modules.get("numpy")
        if numpy is not None and (
            kind is numpy.ndarray or issubclass(kind, numpy.generic)
        ):
            self.check_size(value.nbytes)
            token = _token(value.dtype)
            self.out += b"a"
            self.put(token, DEPTH)
            shape = tuple(map(int, value.shape)) if kind is numpy.ndarray else None
            self.put(shape, DEPTH)
            self.blob(value.tobytes(), b"b")
            return
        found = self.kinds.shape(kind)
        depth = self.nest(depth, 3 + len(found.fields))
        _OF_FORM[found.form](self, kind, found, value, depth)

    def of_class(self, kind: type, shape: Shape) -> None:
        """Put the number of a class, the first time what it is too."""
        number = self.classes.get(kind)
        if number is not None:
            self.out += shape.form._value_ + _SHORT.pack(number)
            return
        self.classes[kind] = number = len(self.classes)
        definition = self.kinds.definitions.get(kind)
        if definition is None:
            about: Any = shape.fields
            if shape.form is Form.ERROR:
                about = self.kinds.base_of(kind)
            definition = encode((name_of(kind), about), self.kinds, 0xFFFF)
            if len(self.kinds.definitions) < STRANGERS:
                self.kinds.definitions[kind] = definition
        self.out += shape.form._value_ + _SHORT.pack(number)
        self.out += _SHORT.pack(len(definition)) + definition

    def fields(self, kind: type, shape: Shape, value: Any, depth: int) -> None:
        """Put an object by its fields, and what it has beside them."""
        self.of_class(kind, shape)
        names = shape.fields
        parts = value
        if shape.form is Form.RECORD:
            parts = [getattr(value, name, _MISSING) for name in names]
        if self.kinds.fits is not None:
            self.kinds.check(kind, zip(names, parts, strict=False))
        put, out = self.put, self.out
        try:
            for name, part in zip(names, parts, strict=True):  # noqa: B007 - as above
                if type(part) is float:
                    out += _put_float(b"f", part)
                elif part is None:
                    out += b"N"
                elif part is _MISSING:
                    out += b"-"
                else:
                    put(part, depth)
        except CodecError as error:
            raise error.below(f".{name}") from None
        if shape.has_more:
            own = vars(value)
            more = {each: own[each] for each in own if each not in names}
            if more:
                self.pairs(more, depth)
                return
        out += b"N"

    def member(self, kind: type, shape: Shape, value: Any, depth: int) -> None:
        self.of_class(kind, shape)
        # One of flags that are set together has no name of its own.
        names = vars(kind)["_member_map_"]
        name = value._name_
        self.put(name if names.get(name) is value else value._value_, depth)

    def error(self, kind: type, shape: Shape, value: Any, depth: int) -> None:
        known = self.errors.get(id(value))
        if known is not None:  # two errors may be each other's cause
            self.out += b"x" + _SHORT.pack(known[0])
            return
        if len(self.errors) >= 1 << 16:
            raise CodecError("it has too many errors")
        self.of_class(kind, shape)
        try:
            self.put(value.args, depth)
            self.errors[id(value)] = len(self.errors), value
            files: tuple[Any, ...] = ()
            if isinstance(value, OSError) and value.filename is not None:
                files = value.filename, value.filename2
            self.put(files, depth)
            self.pairs(vars(value), depth)
        except CodecError as error:
            raise error.below(f".{kind.__name__}") from None
        self.put(value.__cause__, depth)


def _token(dtype: Any) -> Any:
    """Return what the items of an array are, as texts and numbers."""
    if dtype.hasobject or not dtype.itemsize:
        raise CodecError(f"an array of {dtype} is no plain data")
    if dtype.names is None:
        return dtype.str
    if dtype.subdtype is not None or dtype.isalignedstruct or dtype.metadata:
        raise CodecError(f"an array of {dtype} is not supported")
    parts = []
    for name in dtype.names:
        part, offset = dtype.fields[name][:2]
        shape: tuple[int, ...] = ()
        if part.subdtype is not None:
            part, shape = part.subdtype
        parts.append((name, _token(part), offset, shape))
    return (dtype.itemsize, *parts)


class _Reader(_Walk):
    __slots__ = ("classes", "data", "errors", "place")

    def __init__(self, data: bytes, kinds: Kinds, limit: int, items: int) -> None:
        self.kinds = kinds
        self.items = min(limit // SMALLEST, items)
        self.data = data
        self.place = 1
        self.classes: list[Defined] = []
        self.errors: list[BaseException] = []

    def take(self, depth: int) -> Any:
        data, place = self.data, self.place
        tag = data[place]
        if tag == 0x66:  # f
            self.place = place + 9
            return _FLOAT.unpack_from(data, place + 1)[0]
        if tag == 0x73:  # s
            self.place = place + 2
            return self.slice(data[place + 1]).decode("utf-8", "surrogatepass")
        self.place = place + 1
        if tag == 0x4E:  # N
            return None
        if tag == 0x74:  # t
            return tuple(self.row(depth))
        if tag == 0x69:  # i
            self.place = place + 9
            return _NUMBER.unpack_from(data, place + 1)[0]
        return _TAKE[tag](self, depth)

    def next(self, form: struct.Struct) -> Any:
        """Take what has the form of a number, or of some."""
        place = self.place
        self.place = place + form.size
        return form.unpack_from(self.data, place)

    def slice(self, size: int) -> bytes:
        begin = self.place
        self.place = end = begin + size
        if end > len(self.data):
            raise IndexError
        return self.data[begin:end]

    def blob(self) -> bytes:
        return self.slice(*self.next(_SIZE))

    def head(self, depth: int, weight: int = 1, each: int = 1) -> tuple[int, int]:
        place = self.place
        self.place = place + 4
        size = _SIZE.unpack_from(self.data, place)[0]
        return size, self.nest(depth, weight + each * size)

    def row(self, depth: int, weight: int = 1) -> list[Any]:
        size, depth = self.head(depth, weight)
        take = self.take
        return [take(depth) for _ in range(size)]

    def packed(self) -> Any:
        is_tuple = self.slice(1) == b"t"
        (size,) = self.next(_SIZE)
        self.count(1 + size // PACKED)
        values = struct.unpack(f"<{size}d", self.slice(8 * size))
        return values if is_tuple else list(values)

    def pairs(self, depth: int) -> dict[Any, Any]:
        size, depth = self.head(depth, 2, 2)
        take = self.take
        pairs = [(take(depth), take(depth)) for _ in range(size)]
        _check_spread([key for key, _ in pairs])
        return dict(pairs)

    def many(self, depth: int) -> list[Any]:
        values = self.row(depth, 4)
        _check_spread(values)
        return values

    def parts(self, count: int, depth: int) -> list[Any]:
        depth = self.nest(depth, 1)
        return [self.take(depth) for _ in range(count)]

    def deque(self, depth: int) -> Any:
        (longest,) = self.parts(1, depth)
        if self.slice(1) != b"Q":
            raise IndexError
        return collections.deque(self.row(depth, 16), longest)

    def whole(self) -> int:
        data = self.blob()
        if len(data) > DIGITS // 3:
            raise CodecError(f"it has more than {DIGITS} digits")
        return int.from_bytes(data, "little", signed=True)

    def of_class(self, form: Form) -> Defined:
        """Take the number of a class, the first time what it is too."""
        (number,) = self.next(_SHORT)
        if number == len(self.classes):
            known = self.kinds.known
            definition = form, self.slice(*self.next(_SHORT))
            found: Defined | None = known.get(definition)
            if found is None:
                found = self.defined(*definition)
                if len(known) < STRANGERS:
                    known[definition] = found
            self.classes.append(found)
        before: Defined = self.classes[number]
        return before

    def defined(self, form: Form, definition: bytes) -> Defined:
        """Return what the definition of a class says, as far as it is known here."""
        name, about = decode(definition, self.kinds, 0xFFFF)
        texts = [about] if form is Form.ERROR else [*about]
        if not all(type(each) is str for each in (name, *texts)):
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

    def fields(self, depth: int, form: Form) -> Any:
        """Take an object by the names that its fields had when it was sent."""
        name, kind, shape, about = self.of_class(form)
        depth = self.nest(depth, 3 + len(about))
        found: dict[str, Any] = {}
        data = self.data
        for each in about:
            if data[self.place] == 0x2D:  # -
                self.place += 1
            else:
                found[each] = self.take(depth)
        more = self.take(depth)
        if more is None:
            more = {}
        elif type(more) is not dict or not all(type(each) is str for each in more):
            raise IndexError
        if shape is None:
            return {**found, **more}
        if about != shape.fields:
            _catch_up(name, shape, about, found)
        if self.kinds.fits is not None:
            parts = ((each, found.get(each, _MISSING)) for each in shape.fields)
            self.kinds.check(kind, parts)
        if more and not shape.has_more:
            told = f"{name.replace(':', '.')} has no room for {[*more][:3]!r:.80} now"
            raise CodecError(told)
        if form is Form.TUPLE:
            made = tuple.__new__(kind, [found[each] for each in shape.fields])
        else:
            made = object.__new__(kind)
            slots = shape.slots
            for each, value in found.items():
                if each in slots:
                    slots[each].__set__(made, value)
                else:
                    more[each] = value
        if more:
            made.__dict__.update(more)
        return made

    def member(self, depth: int) -> Any:
        name, kind, shape, _ = self.of_class(Form.ENUM)
        wanted = self.take(self.nest(depth, 1))
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
        depth = self.nest(depth, 8)
        args = self.take(depth)
        if type(args) is not tuple:
            raise IndexError
        # Made by what Python itself makes it with, never by its own code.
        base: Any = next(each for each in kind.__mro__ if each.__module__ == "builtins")
        made: BaseException = base.__new__(kind, *args)
        base.__init__(made, *args)
        made.args = args
        self.errors.append(made)
        files = self.take(depth)
        if files and isinstance(made, OSError):
            made.filename = files[0]
            if files[1] is not None:
                made.filename2 = files[1]
        fields = self.take(depth)
        if type(fields) is not dict or not all(type(each) is str for each in fields):
            raise IndexError
        made.__dict__.update(fields)
        cause = self.take(depth)
        if cause is not None:
            made.__cause__ = cause
        return made

    def array(self) -> Any:
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


def _catch_up(
    name: str, shape: Shape, about: tuple[str, ...], found: dict[str, Any]
) -> None:
    """Compare the fields of an object with those that its class has now."""
    for each in set(shape.fields) ^ set(about):
        if each in shape.fields and each in shape.defaults:
            found[each] = shape.defaults[each]
            continue
        told = "has a field" if each in shape.fields else "has no field"
        raise CodecError(
            f"{name.replace(':', '.')} {told} {each!r:.40} now, which was otherwise "
            "when it was sent"
        )


_SCALAR: Final = re.compile(
    r"[<>|=][?biufcSUMmV][0-9]{0,9}(\[[0-9]{0,6}[a-zA-Z]{1,2}\])?"
)


def _dtype(numpy: Any, token: Any, depth: int = 4) -> Any:
    """Return the type of an array's items, made of what was checked."""
    if type(token) is str:
        if not _SCALAR.fullmatch(token):
            raise CodecError(f"it holds an array of {token!r:.40}")
        return numpy.dtype(token)
    wanted: dict[str, Any] = {"names": [], "formats": [], "offsets": []}
    match token:
        case (int() as size, *parts) if type(token) is tuple and depth:
            wanted["itemsize"] = size
        case _:
            raise CodecError("it holds an array of something else")
    for part in parts:
        match part:
            case (str() as name, of, int() as offset, tuple() as shape) if all(
                type(each) is int and 0 <= each < 1 << 20 for each in shape
            ):
                inner = _dtype(numpy, of, depth - 1)
                if math.prod(shape) * inner.itemsize <= size:
                    wanted["names"].append(name)
                    wanted["formats"].append((inner, shape) if shape else inner)
                    wanted["offsets"].append(offset)
                    continue
        raise CodecError("it holds an array of something else")
    return numpy.dtype(wanted)


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


def _checked(value: Any, kind: type) -> Any:
    """Return what is of this class itself, which reads nothing but what it should."""
    if type(value) is not kind:
        raise IndexError
    return value


def _digits(text: Any) -> str:
    if len(_checked(text, str)) > DIGITS:
        raise CodecError(f"it has more than {DIGITS} digits")
    return str(text)


def _in_zone(moment: Any, zone: Any) -> Any:
    wanted = None if zone is None else _checked(zone, datetime.timezone)
    return moment.replace(tzinfo=wanted)


def _zone(offset: Any, name: Any) -> datetime.timezone:
    args = (_checked(offset, datetime.timedelta), name)
    return datetime.timezone(*args[: 1 if name is None else 2])


_CLOCK: Final = ("hour", "minute", "second", "microsecond", "fold")
_time_of = attrgetter(*_CLOCK)
_moment_of = attrgetter("year", "month", "day", *_CLOCK)

_MADE_OF: Final[list[tuple[bytes, type, int, Callable[[Any], Any], Any]]] = [
    (b"r", range, 3, attrgetter("start", "stop", "step"), range),
    (b"w", slice, 3, attrgetter("start", "stop", "step"), slice),
    (b"E", datetime.timedelta, 3, attrgetter("days", "seconds", "microseconds"),
     datetime.timedelta),
    (b"D", datetime.date, 1, lambda v: (v.toordinal(),), datetime.date.fromordinal),
    (b"h", datetime.time, 2, lambda v: (_time_of(v), v.tzinfo),
     lambda parts, zone: _in_zone(
         datetime.time(*parts[:-1], fold=parts[-1]), zone)),
    (b"M", datetime.datetime, 2, lambda v: (_moment_of(v), v.tzinfo),
     lambda parts, zone: _in_zone(
         datetime.datetime(*parts[:-1], fold=parts[-1]), zone)),  # noqa: DTZ001
    (b"C", decimal.Decimal, 1, lambda v: (_digits(str(v)),),
     lambda text: decimal.Decimal(_digits(text))),
    (b"R", fractions.Fraction, 2, attrgetter("numerator", "denominator"),
     lambda *parts: fractions.Fraction(*[_checked(each, int) for each in parts])),
]  # fmt: skip
"""Python's own classes that consist of parts: tag, class, how many, which, made of them."""


def _apart(
    tag: bytes, parts_of: Callable[[Any], Any]
) -> Callable[[_Writer, Any, int], None]:
    return lambda writer, value, depth: writer.parts(tag, parts_of(value), depth)


def _made(count: int, make: Callable[..., Any]) -> Callable[[_Reader, int], Any]:
    return lambda reader, depth: make(*reader.parts(count, depth))


_PUT: Final[dict[type, Callable[[Any, Any, int], None]]] = {
    bytes: lambda writer, value, _: writer.blob(value, b"b"),
    bytearray: lambda writer, value, _: writer.blob(value, b"B"),
    complex: lambda writer, value, _: writer.out.extend(
        b"c" + _COMPLEX.pack(value.real, value.imag)
    ),
    dict: _Writer.pairs,
    collections.OrderedDict: lambda w, value, depth: w.pairs(value, depth, b"O"),
    set: lambda writer, value, depth: writer.many(value, depth, b"u"),
    frozenset: lambda writer, value, depth: writer.many(value, depth, b"v"),
    collections.deque: _Writer.deque,
    datetime.timezone: _Writer.zone,
    **{kind: _apart(tag, parts_of) for tag, kind, _, parts_of, _ in _MADE_OF},
}

_OF_FORM: Final[dict[Form, Callable[[_Writer, type, Shape, Any, int], None]]] = {
    Form.RECORD: _Writer.fields,
    Form.TUPLE: _Writer.fields,
    Form.ENUM: _Writer.member,
    Form.ERROR: _Writer.error,
}

_TAKE: Final[dict[int, Callable[[_Reader, int], Any]]] = {
    ord(tag): take
    for tag, take in {
        b"T": lambda _reader, _: True,
        b"F": lambda _reader, _: False,
        b"I": lambda reader, _: reader.whole(),
        b"S": lambda reader, _: reader.blob().decode("utf-8", "surrogatepass"),
        b"b": lambda reader, _: reader.blob(),
        b"B": lambda reader, _: bytearray(reader.blob()),
        b"c": lambda reader, _: complex(*reader.next(_COMPLEX)),
        b"d": lambda reader, _: reader.packed(),
        b"l": _Reader.row,
        b"m": _Reader.pairs,
        b"O": lambda reader, depth: collections.OrderedDict(reader.pairs(depth)),
        b"u": lambda reader, depth: set(reader.many(depth)),
        b"v": lambda reader, depth: frozenset(reader.many(depth)),
        b"q": _Reader.deque,
        b"U": lambda _reader, _: datetime.UTC,
        b"z": _made(2, _zone),
        b"o": lambda reader, depth: reader.fields(depth, Form.RECORD),
        b"n": lambda reader, depth: reader.fields(depth, Form.TUPLE),
        b"e": _Reader.member,
        b"X": _Reader.error,
        b"x": lambda reader, _: reader.errors[reader.next(_SHORT)[0]],
        b"a": lambda reader, _: reader.array(),
        **{tag: _made(count, make) for tag, _, count, _, make in _MADE_OF},
    }.items()
}
