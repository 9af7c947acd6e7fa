"""Plain data as bytes: a tag for each value, then what it consists of."""

from __future__ import annotations

import collections
import datetime
import decimal
import fractions
import struct
import sys
from collections.abc import Callable
from typing import Any, Final

from esair.codec._kinds import (
    DEPTH,
    DIGITS,
    ITEMS,
    LIMIT,
    PACKED,
    SMALLEST,
    CodecError,
    Form,
    Kinds,
    Shape,
    name_of,
)

VERSION: Final = b"\x01"

NONE, TRUE, FALSE = b"N", b"T", b"F"
_number = struct.Struct("<cq").pack
_float = struct.Struct("<cd").pack
_complex = struct.Struct("<cdd").pack
_short = struct.Struct("<cH").pack
_defined = struct.Struct("<cHH").pack
_head = struct.Struct("<cI").pack
_FLOAT_ALONE: Final = struct.Struct("<ccd").pack
_NONE_ALONE: Final = VERSION + NONE
_SHORT: Final = [bytes((each,)) for each in range(256)]
_LONG: Final = 1 << 63
_MISSING: Final = object()

ROW: Final = 4
"""From how many numbers on a row of them is packed."""


def encode(value: Any, kinds: Kinds, limit: int = LIMIT) -> bytes:
    """Return a value as bytes.

    Args:
        value: The value.
        kinds: The classes that may cross.
        limit: How many bytes it may have.

    Raises:
        CodecError: It cannot cross: which part of it, and why.
    """
    if type(value) is float:
        return _FLOAT_ALONE(VERSION, b"f", value)
    if value is None:
        return _NONE_ALONE
    writer = _Writer(kinds, limit)
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


class _Writer:
    __slots__ = ("classes", "errors", "items", "kinds", "limit", "out")

    def __init__(self, kinds: Kinds, limit: int) -> None:
        self.kinds = kinds
        self.limit = limit
        self.items = min(limit // SMALLEST, ITEMS)
        self.out = bytearray(VERSION)
        self.classes: dict[type, int] = {}
        self.errors: dict[int, tuple[int, BaseException]] = {}

    def put(self, value: Any, depth: int) -> None:
        kind = type(value)
        out = self.out
        if kind is float:
            out += _float(b"f", value)
        elif kind is str:
            data = value.encode("utf-8", "surrogatepass")
            size = len(data)
            out += b"s" + _SHORT[size] if size < 256 else _head(b"S", size)
            out += data
        elif value is None:
            out += NONE
        elif kind is tuple:
            self.row(b"t", value, depth)
        elif kind is int:
            if -_LONG <= value < _LONG:
                out += _number(b"i", value)
            else:
                self.long(value)
        elif kind is bool:
            out += TRUE if value else FALSE
        elif kind is list:
            self.row(b"l", value, depth)
        else:
            put = _PUT.get(kind)
            if put is not None:
                put(self, value, depth)
            else:
                self.put_other(kind, value, depth)

    def count(self, items: int) -> None:
        self.items -= items
        if self.items < 0:
            raise CodecError(f"it has too many items for {self.limit} bytes")
        if len(self.out) > self.limit:
            raise CodecError(f"it has more than {self.limit} bytes")

    def check_size(self) -> None:
        if len(self.out) > self.limit:
            raise CodecError(f"it has more than {self.limit} bytes")

    def row(self, tag: bytes, values: Any, depth: int) -> None:
        """Put a list or tuple; one of floats alone is packed."""
        size = len(values)
        if (
            size >= ROW
            and type(values[0]) is float
            and set(map(type, values)) == _FLOAT
        ):
            self.count(1 + size // PACKED)
            self.out += b"d" + _head(tag, size) + struct.pack(f"<{size}d", *values)
            return
        if depth <= 0:
            raise CodecError(f"it is nested deeper than {DEPTH}")
        self.count(1 + size)
        self.out += _head(tag, size)
        put, depth = self.put, depth - 1
        done = 0
        try:
            for each in values:
                put(each, depth)
                done += 1
        except CodecError as error:
            raise error.below(f"[{done}]") from None

    def head(self, tag: bytes, size: int, depth: int, weight: int = 1) -> None:
        if depth <= 0:
            raise CodecError(f"it is nested deeper than {DEPTH}")
        self.count(weight + size)
        self.out += _head(tag, size)

    def long(self, value: int) -> None:
        data = value.to_bytes(value.bit_length() // 8 + 1, "little", signed=True)
        if len(data) > DIGITS // 3:
            raise CodecError(f"it has more than {DIGITS} digits")
        self.out += _head(b"I", len(data)) + data

    def blob(self, value: Any, tag: bytes) -> None:
        if len(self.out) + len(value) > self.limit:
            raise CodecError(f"it has more than {self.limit} bytes")
        self.out += _head(tag, len(value)) + value

    def pairs(self, value: Any, depth: int, tag: bytes = b"m") -> None:
        self.head(tag, len(value), depth, 2)
        self.count(len(value))
        depth -= 1
        for key, each in value.items():
            try:
                self.put(key, depth)
                self.put(each, depth)
            except CodecError as error:
                name = f".{key}" if type(key) is str else f"[{key!r:.40}]"
                raise error.below(name) from None

    def many(self, value: Any, depth: int, tag: bytes, weight: int) -> None:
        self.head(tag, len(value), depth, weight)
        for each in value:
            self.put(each, depth - 1)

    def parts(self, tag: bytes, values: tuple[Any, ...], depth: int) -> None:
        """Put what a value of a built-in class is made of."""
        if depth <= 0:
            raise CodecError(f"it is nested deeper than {DEPTH}")
        self.out += tag
        for each in values:
            self.put(each, depth - 1)

    def put_other(self, kind: type, value: Any, depth: int) -> None:
        numpy = sys.modules.get("numpy")
        if numpy is not None and (
            kind is numpy.ndarray or issubclass(kind, numpy.generic)
        ):
            self.array(numpy, kind is numpy.ndarray, value)
            return
        shape = self.kinds.shape(kind)
        if depth <= 0:
            raise CodecError(f"it is nested deeper than {DEPTH}")
        self.count(3 + len(shape.fields))
        _OF_FORM[shape.form](self, kind, shape, value, depth - 1)

    def of_class(self, tag: bytes, kind: type, shape: Shape) -> None:
        """Put a tag with the number of a class, the first time what it is too."""
        number = self.classes.get(kind)
        if number is not None:
            self.out += _short(tag, number)
            return
        self.classes[kind] = number = len(self.classes)
        definition = self.kinds.definitions.get(kind)
        if definition is None:
            about: Any = shape.fields
            if shape.form is Form.ERROR:
                about = self.kinds.base_of(kind)
            definition = encode((name_of(kind), about), self.kinds, 0xFFFF)
            self.kinds.remember(kind, definition)
        self.out += _defined(tag, number, len(definition)) + definition

    def record(self, kind: type, shape: Shape, value: Any, depth: int) -> None:
        self.of_class(b"o", kind, shape)
        put, out = self.put, self.out
        name = ""
        try:
            for name in shape.fields:
                part = getattr(value, name, _MISSING)
                if type(part) is float:
                    out += _float(b"f", part)
                elif part is _MISSING:
                    out += b"-"
                else:
                    put(part, depth)
        except CodecError as error:
            raise error.below(f".{name}") from None
        self.more(shape, value, depth)

    def more(self, shape: Shape, value: Any, depth: int) -> None:
        """Put the attributes that an object has beside its fields."""
        if shape.has_more:
            own = vars(value)
            more = {each: own[each] for each in own if each not in shape.fields}
            if more:
                self.pairs(more, depth)
                return
        self.out += NONE

    def named(self, kind: type, shape: Shape, value: Any, depth: int) -> None:
        self.of_class(b"n", kind, shape)
        done = 0
        try:
            for part in value:
                self.put(part, depth)
                done += 1
        except CodecError as error:
            raise error.below(f".{shape.fields[done]}") from None
        self.more(shape, value, depth)

    def member(self, kind: type, shape: Shape, value: Any, depth: int) -> None:
        self.of_class(b"e", kind, shape)
        # One of flags that are set together has no name of its own.
        names = vars(kind)["_member_map_"]
        name = value._name_
        self.put(name if names.get(name) is value else value._value_, depth)

    def error(self, kind: type, shape: Shape, value: Any, depth: int) -> None:
        known = self.errors.get(id(value))
        if known is not None:  # two errors may be each other's cause
            self.out += _short(b"x", known[0])
            return
        if len(self.errors) >= 1 << 16:
            raise CodecError("it has too many errors")
        self.of_class(b"X", kind, shape)
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

    def array(self, numpy: Any, is_array: bool, value: Any) -> None:
        token = _token(value.dtype)
        if value.nbytes + len(self.out) > self.limit:
            raise CodecError(f"it has more than {self.limit} bytes")
        self.out += b"a"
        self.put(token, DEPTH)
        self.put(tuple(map(int, value.shape)) if is_array else None, DEPTH)
        self.blob(value.tobytes(), b"b")


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


def _deque(writer: _Writer, value: collections.deque[Any], depth: int) -> None:
    writer.parts(b"q", (value.maxlen,), depth)
    writer.many(value, depth, b"Q", 16)


def _date(writer: _Writer, value: datetime.date, depth: int) -> None:
    writer.parts(b"D", (value.toordinal(),), depth)


def _time(writer: _Writer, value: datetime.time, depth: int) -> None:
    parts = value.hour, value.minute, value.second, value.microsecond, value.fold
    writer.parts(b"h", (parts, value.tzinfo), depth)


def _datetime(writer: _Writer, value: datetime.datetime, depth: int) -> None:
    day = value.year, value.month, value.day
    time = value.hour, value.minute, value.second, value.microsecond
    writer.parts(b"M", ((*day, *time, value.fold), value.tzinfo), depth)


def _delta(writer: _Writer, value: datetime.timedelta, depth: int) -> None:
    writer.parts(b"E", (value.days, value.seconds, value.microseconds), depth)


def _zone(writer: _Writer, value: datetime.timezone, depth: int) -> None:
    if value is datetime.UTC:
        writer.out += b"U"
        return
    offset, name = value.utcoffset(None), value.tzname(None)
    is_named = name != datetime.timezone(offset).tzname(None)
    writer.parts(b"z", (offset, name if is_named else None), depth)


def _decimal(writer: _Writer, value: decimal.Decimal, depth: int) -> None:
    text = str(value)
    if len(text) > DIGITS:
        raise CodecError(f"it has more than {DIGITS} digits")
    writer.parts(b"C", (text,), depth)


_FLOAT: Final = {float}

_PUT: Final[dict[type, Callable[[_Writer, Any, int], None]]] = {
    bytes: lambda writer, value, _: writer.blob(value, b"b"),
    bytearray: lambda writer, value, _: writer.blob(value, b"B"),
    complex: lambda w, value, _: w.out.extend(_complex(b"c", value.real, value.imag)),
    dict: _Writer.pairs,
    collections.OrderedDict: lambda w, value, depth: w.pairs(value, depth, b"O"),
    set: lambda writer, value, depth: writer.many(value, depth, b"u", 4),
    frozenset: lambda writer, value, depth: writer.many(value, depth, b"v", 4),
    collections.deque: _deque,
    range: lambda w, value, d: w.parts(b"r", (value.start, value.stop, value.step), d),
    slice: lambda w, value, d: w.parts(b"w", (value.start, value.stop, value.step), d),
    datetime.date: _date,
    datetime.time: _time,
    datetime.datetime: _datetime,
    datetime.timedelta: _delta,
    datetime.timezone: _zone,
    decimal.Decimal: _decimal,
    fractions.Fraction: lambda writer, value, depth: writer.parts(
        b"R", (value.numerator, value.denominator), depth
    ),
}

_OF_FORM: Final[dict[Form, Callable[[_Writer, type, Shape, Any, int], None]]] = {
    Form.RECORD: _Writer.record,
    Form.TUPLE: _Writer.named,
    Form.ENUM: _Writer.member,
    Form.ERROR: _Writer.error,
}
