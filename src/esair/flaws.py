"""What is inside of a value: one walk finds what is no finite number, wherever it hides.

Readings, commands, results of guards, settings and parameters are looked through by it.
And whether somebody could change what is inside (`is_fixed`): then each who gets it has
one of their own (`owned`).
"""

from __future__ import annotations

import copy
import enum
import math
import numbers
import sys
import types
import typing
from collections.abc import Collection, Iterator, Mapping
from typing import Any, NamedTuple

import attrs

from esair.values import alternatives, hints_of, once_for_class

DEPTH = 8  # how deep parts of a value are looked at

NUMBER = "a number"

_ATOMS = (str, bytes, bytearray, memoryview, range, type, types.ModuleType)
"""What cannot hide a number that is not finite."""


class Flaw(NamedTuple):
    """The first part of a value that must not be there.

    Attributes:
        path: Where it is: names and places, from the outside to the inside.
        value: What is there.
        expected: What should be there.
        row: What it is in if that is of numbers: a row, or an array.
    """

    path: tuple[object, ...]
    value: Any
    expected: str
    row: str = ""

    def place(self) -> str:
        """Name where it is, as the errors of commands do."""
        return ".".join(map(str, self.path))

    def place_in(self, value: Any) -> str:
        """Name where it is, as the errors of readings do; empty for the whole."""
        place = ""
        for name in self.path[:-1] if self.row else self.path:
            names = getattr(type(value), "_fields", None)
            if names and isinstance(name, int):
                place += f".{names[name]}"
            else:
                place += f"[{name}]" if isinstance(name, int) else f".{name}"
            value = dict(parts_of(value)).get(name)
        return place.removeprefix(".")


TOO_DEEP = "no nesting as deep as this"

_FINITE = "a finite number"
_ATOM, _ENUM, _MAPPING, _OBJECT = "an atom", "a member", "a mapping", "an object"
_ARRAY, _ROW = "an array", "a row"
_BUILT_IN: dict[type, str] = {
    **dict.fromkeys((float, int, bool, complex), NUMBER),
    **dict.fromkeys((str, bytes, type(None)), _ATOM),
    **dict.fromkeys((list, tuple, set, frozenset), _ROW),
    dict: _MAPPING,
}
"""Of the classes that cannot keep what was found out about them."""

_HEAP_TYPE = 1 << 9  # a class that was made by a statement

_ROUTINES = (
    types.FunctionType,
    types.BuiltinFunctionType,
    types.MethodType,
    types.MethodDescriptorType,
    types.WrapperDescriptorType,
    types.MethodWrapperType,
)


def flaw(
    value: Any, kinds: Mapping[str, str] | None = None, *, rows: bool = False
) -> Flaw | None:
    """Return the first thing in a value that is no finite number, or too deep.

    Fields, entries and their keys, attributes and slots are looked into, of any object.

    Args:
        value: Any value at all; what its own code raises, this raises.
        kinds: What has to be where: a number, or what has numbers in it.
        rows: Whether infinity passes in a row of numbers, for "nothing in reach".
    """
    return _Walk(kinds or {}, rows=rows).find(value, ())


def unsound(value: Any) -> str:
    """Say where there is no finite number in a value; nothing if it cannot be looked through."""
    try:
        found = flaw(value)
    except ArithmeticError:  # so says the infinity of a Decimal, and its sNaN
        return f"expected {_FINITE}, not {value!r:.80}"
    except BaseException:  # it may be an object of any class
        return ""
    if found is None or found.expected == TOO_DEEP:
        return ""
    where = f" at {found.place()}" if found.path else ""
    return f"expected {found.expected}{where}, not {found.value!r:.80}"


class _Walk:
    """Looks through one value; each object in it once, however often it is there."""

    def __init__(self, kinds: Mapping[str, str], *, rows: bool) -> None:
        self._kinds = kinds
        self._rows = rows
        self._within: dict[int, Any] = {}
        self._seen: dict[int, Any] = {}

    def find(
        self, value: Any, path: tuple[object, ...], *, in_row: bool = False
    ) -> Flaw | None:
        kind = self._kinds.get(".".join(map(str, path)), "") if self._kinds else ""
        shape = _shape_of(type(value))
        if shape == NUMBER:
            if type(value) is not float:
                value = honest(value)
            if self._rows and in_row and isinstance(value, float):
                return Flaw(path, value, NUMBER) if value != value else None
            if value - value != 0:
                return Flaw(path, value, _FINITE)
            return Flaw(path, value, kind) if kind not in {"", NUMBER} else None
        if shape == _ATOM:
            return Flaw(path, value, kind) if kind else None
        if kind == NUMBER:
            return Flaw(path, value, NUMBER)
        if not self._kinds and self._is_clean(value, shape):
            return None
        if id(value) in self._seen:
            return None
        if len(path) > DEPTH or id(value) in self._within:
            return Flaw(path, value, TOO_DEEP)
        self._within[id(value)] = value
        parts = parts_of(value)
        if kind and not parts:
            return Flaw(path, value, kind)
        is_row = shape in {_ROW, _ARRAY} and not fields_of(type(value))
        for name, part in parts:
            found = self.find(part, (*path, name), in_row=is_row)
            if found is not None:
                if is_row and len(found.path) == len(path) + 1:
                    alike = all(_shape_of(type(each)) == NUMBER for _, each in parts)
                    found = found._replace(row=shape if alike else "")
                return found
        # Kept: another object could get the number of one that is gone.
        self._seen[id(value)] = self._within.pop(id(value))
        return None

    def _is_clean(self, value: Any, shape: str) -> bool:
        """Tell, at once, of a row or an array of numbers whether all of them pass."""
        if shape == _ARRAY:
            kind = getattr(getattr(value, "dtype", None), "kind", "")
            if isinstance(kind, str) and kind in {"f", "c"}:
                bad = value != value if self._rows else value - value != 0
                return not bool(bad.any())
            return isinstance(kind, str) and kind != "" and kind in "biuSUmM"
        if shape != _ROW:
            return False
        try:
            if self._rows and not hasattr(type(value), "_fields"):
                return not any(map(math.isnan, value))
            return all(map(math.isfinite, value))
        except (TypeError, ValueError):
            return False  # they are no numbers: each is looked into
        except OverflowError:  # a whole number that is too large for a computation
            if self._rows:
                raise
            return False


def honest(number: Any) -> Any:
    """Return a number as it is: a class of its own may compute and compare as it likes."""
    if not type(number).__flags__ & _HEAP_TYPE:
        return number
    if isinstance(number, float):
        return float.__float__(number)
    return int.__int__(number) if isinstance(number, int) else number


def _shape_of(cls: type) -> str:
    """What a value of a class is to the walk."""
    found = _BUILT_IN.get(cls)
    if found is None:
        found = _shape_of_class(cls)
        if not cls.__flags__ & _HEAP_TYPE:  # it is there as long as the process
            _BUILT_IN[cls] = found
    return found


@once_for_class
def _shape_of_class(cls: type) -> str:
    if issubclass(cls, numbers.Number):
        return NUMBER
    if cls is type(None) or issubclass(cls, _ATOMS) or issubclass(cls, _ROUTINES):
        return _ATOM
    if issubclass(cls, enum.Enum):
        return _ENUM
    if issubclass(cls, Mapping):
        return _MAPPING
    if hasattr(cls, "__array__"):
        return _ARRAY
    return _ROW if issubclass(cls, Collection) else _OBJECT


def parts_of(value: Any) -> list[tuple[object, Any]]:
    """The parts of a value by their names or places: fields, entries, attributes."""
    shape = _shape_of(type(value))
    if shape in {NUMBER, _ATOM}:
        return []
    if shape == _ENUM:
        return [("value", value.value)]
    if shape == _MAPPING:
        return [*value.items(), *enumerate(value)]
    if shape == _ARRAY:
        return list(enumerate(value.ravel().tolist()))
    parts: dict[object, Any] = dict(enumerate(value)) if shape == _ROW else {}
    for name in slots_of(type(value)):
        if hasattr(value, name):
            parts[name] = getattr(value, name)
    parts.update(getattr(value, "__dict__", {}))
    return list(parts.items())


@once_for_class
def slots_of(cls: type) -> tuple[str, ...]:
    """The attributes of objects of a class that are slots."""
    return tuple(
        name
        for each in cls.__mro__
        for name, slot in vars(each).items()
        if isinstance(slot, types.MemberDescriptorType)
    )


@once_for_class
def fields_of(cls: type) -> tuple[str, ...]:
    """The fields of a structured value: attrs, a dataclass, or a named tuple."""
    if attrs.has(cls):
        return tuple(field.name for field in attrs.fields(cls))
    return tuple(
        getattr(cls, "__dataclass_fields__", ()) or getattr(cls, "_fields", ())
    )


# Whether it can be changed.

_PLAIN = frozenset({float, int, bool, complex, str, bytes, type(None)})


def is_fixed(kind: Any, depth: int = DEPTH) -> bool:
    """Tell whether nobody can change a value of a declared type, nor a part of it."""
    if isinstance(kind, type) and kind in _PLAIN:
        return True
    options = alternatives(kind)
    if len(options) > 1:
        return all(is_fixed(each, depth) for each in options)
    cls, inner = typing.get_origin(kind) or kind, typing.get_args(kind)
    if kind is None or cls is typing.Literal:
        return True
    if not (isinstance(cls, type) and depth) or cls is Any:
        return False
    if cls is tuple or cls is frozenset:
        parts = [each for each in inner if each is not ...]
        return bool(inner) and all(is_fixed(each, depth - 1) for each in parts)
    if _shape_of(cls) in {NUMBER, _ATOM, _ENUM}:
        return not issubclass(cls, bytearray | memoryview)
    if not (fields_of(cls) and is_frozen(cls)):
        return False
    hints = hints_of(cls)
    return all(is_fixed(hints.get(name, Any), depth - 1) for name in fields_of(cls))


def is_frozen(cls: type) -> bool:
    """Tell whether the fields of objects of a class cannot be set."""
    options = getattr(cls, "__dataclass_params__", None)
    if options is not None:
        return bool(options.frozen)
    # A frozen class of attrs, which has no other way to say so.
    frozen = getattr(cls.__setattr__, "__name__", "") == "_frozen_setattrs"
    return frozen or issubclass(cls, tuple)


@once_for_class
def _is_fixed_class(cls: type) -> bool:
    return is_fixed(cls)


def read_only(value: Any) -> Any:
    """Return an array that nobody can write to, a copy if need be; else what it is."""
    numpy = sys.modules.get("numpy")
    if numpy is not None and isinstance(value, numpy.ndarray):
        owners = value.flags, getattr(value.base, "flags", None)
        if any(getattr(each, "writeable", False) for each in owners):
            value = copy.deepcopy(value)
            value.setflags(write=False)
    return value


def owned(value: Any) -> Any:
    """Return a value that its owner may change, which nobody else sees.

    An array that cannot be written to, and what cannot be copied, is returned as it is.
    """
    cls = type(value)
    if cls in _PLAIN or _is_fixed_class(cls):
        return value
    if cls is list or cls is tuple:  # of plain values: much quicker
        if _PLAIN.issuperset(map(type, value)):
            return value[:]
    elif cls is dict:
        if _PLAIN.issuperset(map(type, value.values())):
            return dict(value)
    elif not getattr(getattr(value, "flags", None), "writeable", True):
        return value
    try:
        if _shape_of(cls) == _OBJECT and not parts_of(value):
            return value  # there is nothing to change: it stands for itself
        try:
            return copy.deepcopy(value)
        except TypeError:  # it knows of no views: they are copied before
            views = _views(value, {})
            return copy.deepcopy(value, {id(each): _own_view(each) for each in views})
    except Exception:  # it may be an object of any class
        return value


def _views(value: Any, seen: dict[int, Any]) -> Iterator[memoryview]:
    """Yield the memoryviews in a value."""
    if type(value) is memoryview:
        yield value
    elif id(value) not in seen:
        seen[id(value)] = value
        for _, part in parts_of(value):
            yield from _views(part, seen)


def _own_view(view: memoryview) -> memoryview:
    if type(view.obj) is bytes or not view.nbytes:
        return view
    return memoryview(view.tobytes()).cast(view.format, view.shape)  # type: ignore[call-overload,no-any-return]
