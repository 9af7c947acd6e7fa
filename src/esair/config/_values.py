"""From the values of a TOML file to the types that Python code asks for.

Nothing is guessed: ``"3"`` is no number, ``true`` is no ``1``, and a table becomes
an attrs class, dataclass, named tuple or typed dictionary only if every key of it
is a field, and every field without a default is there.
"""

from __future__ import annotations

import collections.abc
import dataclasses
import enum
import inspect
import os
import types
import typing
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

import attrs

from esair.config._mistakes import below, reason_of, show, unknown
from esair.values import hints_of

Report = Callable[[str, str], None]
"""Called with a key and with what is wrong there."""


class Invalid(enum.Enum):
    """Stands for a value that could not be had."""

    INVALID = "invalid"


INVALID: Final = Invalid.INVALID

_WRONG: Any = object()  # A value that is not of a form; nothing was reported

_PATHS: Final = (Path, os.PathLike)  # Types whose values are paths

_LISTS: Final[dict[type, type]] = {
    list: list,
    tuple: tuple,
    set: set,
    frozenset: frozenset,
    collections.abc.Sequence: tuple,
    collections.abc.Iterable: tuple,
    collections.abc.Collection: tuple,
}
"""What a list becomes, by the type that is asked for."""

_TABLES: Final = (dict, collections.abc.Mapping, collections.abc.MutableMapping)

_NUMBERS_AND_TEXTS: Final = {
    float: "a number",
    int: "a whole number",
    str: "a string",
    bool: "true or false",
}


@attrs.frozen
class Converter:
    """Makes values of a TOML file into what types ask for.

    Attributes:
        report: Is told what is wrong, once for each mistake.
        folder: Where relative paths begin.
    """

    report: Report
    folder: Path

    def convert(self, value: Any, kind: Any, key: str) -> Any:
        """Return a value as a type, or `INVALID` if something was reported."""
        if value is INVALID:
            return value
        form = form_of(kind)
        found = form.take(value, key, self)
        if found is not _WRONG:
            return found
        self.report(key, f"expected {form.words}, not {show(value)}")
        return INVALID


Take = Callable[[Any, str, Converter], Any]
"""Returns what becomes of a value at a key: `INVALID` if it told why not, `_WRONG` if
it is not of the form."""


@attrs.frozen
class Form:
    """What a type asks of a TOML file."""

    words: str
    take: Take
    shape: type = object  # ``dict`` for a table, ``list`` for a list


def convert(value: object, kind: Any, key: str, report: Report, folder: Path) -> Any:
    """Return a value of a TOML file as the type that is asked for.

    Args:
        value: What the file says.
        kind: The type: a class, a generic, a union, a literal.
        key: The key of the value, as a dotted path.
        report: Is told what is wrong, once for each mistake.
        folder: Where relative paths begin, for values of type `pathlib.Path`.

    Returns:
        The value, or `INVALID` if something was reported.
    """
    return Converter(report, folder).convert(value, kind, key)


def wanted(kind: Any) -> str:
    """Say in words what a type asks of a TOML file."""
    return form_of(kind).words


def form_of(kind: Any) -> Form:
    """Return what a type asks of a TOML file."""
    loose = kind is Any or kind is object or kind is inspect.Parameter.empty
    if loose or isinstance(kind, typing.TypeVar):
        return Form("a value", lambda value, _key, _to: value)
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if origin in {typing.Union, types.UnionType}:
        return _one_of(arguments)
    if origin is typing.Annotated:
        return form_of(arguments[0])
    if origin is typing.Literal:
        return _choice({each: each for each in arguments})
    base = origin or kind
    if not isinstance(base, type):
        supertype = getattr(kind, "__supertype__", Any)  # typing.NewType
        return form_of(supertype)
    if base in _NUMBERS_AND_TEXTS:
        return Form(_NUMBERS_AND_TEXTS[base], _exactly(base))
    if base is bytes:
        return Form("a string", lambda v, *_: v.encode() if type(v) is str else _WRONG)
    if base in _PATHS:
        return Form("a path", _path)
    if issubclass(base, enum.Enum):
        return _choice({each.value: each for each in base})
    if (fields := fields_of(base)) is not None:
        words = f"a table with the keys {', '.join(fields)}"
        return Form(words, _record(base, fields), dict)
    if base in _LISTS:
        return _list(base, arguments)
    if issubclass(base, collections.abc.Mapping):
        return _table(base, arguments)
    if base is types.NoneType:
        return Form("nothing", _instance(base))
    article = "an" if base.__name__[0] in "AEIOU" else "a"
    return Form(f"{article} {base.__name__}", _instance(base))


def _exactly(base: type) -> Take:
    def take(value: Any, _key: str, _to: Converter) -> Any:
        if base is float and type(value) is int:
            return float(value)
        return value if type(value) is base else _WRONG

    return take


def _instance(base: type) -> Take:
    return lambda value, _key, _to: value if isinstance(value, base) else _WRONG


def _path(value: Any, _key: str, to: Converter) -> Any:
    good = isinstance(value, str) and value and "\0" not in value
    return to.folder / value if good else _WRONG


def _choice(choices: Mapping[Any, Any]) -> Form:
    def take(value: Any, _key: str, _to: Converter) -> Any:
        for known, found in choices.items():
            if type(known) is type(value) and known == value:
                return found
            name = getattr(found, "name", None)  # of a member
            if name and isinstance(value, str) and value.lower() == name.lower():
                return found
        return _WRONG

    words = ", ".join(map(show, choices))
    return Form(f"one of {words}" if len(choices) > 1 else words, take)


def _one_of(kinds: tuple[Any, ...]) -> Form:
    # A path is a better reading of a string than the string itself.
    forms = [(each, form_of(each)) for each in sorted(kinds, key=_is_no_path)]

    def take(value: Any, key: str, to: Converter) -> Any:
        meant: list[list[tuple[str, str]]] = []
        for kind, form in forms:
            problems: list[tuple[str, str]] = []

            def note(*told: str, to: list[Any] = problems) -> None:
                to.append(told)

            found = Converter(note, to.folder).convert(value, kind, key)
            if found is not INVALID:
                return found
            if type(value) is form.shape:
                meant.append(problems)
        if len(meant) != 1:
            return _WRONG
        for problem in meant[0]:
            to.report(*problem)
        return INVALID

    words = [form_of(each).words for each in kinds if each is not types.NoneType]
    return Form(" or ".join(dict.fromkeys(words)), take)


def _is_no_path(kind: Any) -> bool:
    return kind not in _PATHS


def _table(base: type, arguments: tuple[Any, ...]) -> Form:
    kind = (arguments or (Any, Any))[1]

    def take(value: Any, key: str, to: Converter) -> Any:
        if not isinstance(value, dict) or base not in _TABLES:
            return _instance(base)(value, key, to)
        items = {
            name: to.convert(item, kind, below(key, name))
            for name, item in value.items()
        }
        return INVALID if any(each is INVALID for each in items.values()) else items

    each = f", each {wanted(kind)}" if arguments else ""
    return Form(f"a table{each}", take, dict)


def _list(base: type, arguments: tuple[Any, ...]) -> Form:
    fixed = base is tuple and bool(arguments) and arguments[-1] is not ...
    words = f"a list, each {wanted(arguments[0])}" if arguments else "a list"
    if fixed:
        parts = ", ".join(map(wanted, arguments))
        words = f"a list of {len(arguments)} ({parts})"

    def take(value: Any, key: str, to: Converter) -> Any:
        if not isinstance(value, list):
            return _instance(base)(value, key, to)
        kinds = arguments if fixed else (arguments or (Any,))[:1] * len(value)
        if len(kinds) != len(value):
            return _WRONG
        items = [
            to.convert(item, kind, f"{key}.{index}")
            for index, (item, kind) in enumerate(zip(value, kinds, strict=True))
        ]
        if any(item is INVALID for item in items):
            return INVALID
        try:
            return _LISTS[base](items)
        except TypeError:  # a table in a set
            return _WRONG

    return Form(words, take, list)


def _record(base: type, fields: Mapping[str, Field]) -> Take:
    def take(value: Any, key: str, to: Converter) -> Any:
        if not isinstance(value, dict):
            return _WRONG
        found: dict[str, Any] = {}
        sound = True
        for name, item in value.items():
            if name in fields:
                found[name] = to.convert(item, fields[name].kind, below(key, name))
                sound = sound and found[name] is not INVALID
            else:
                to.report(below(key, name), unknown("key", name, fields))
                sound = False
        for name, field in fields.items():
            if field.required and name not in value:
                words = field.words or wanted(field.kind)
                to.report(key, f"{name!r} is missing: expected {words}")
                sound = False

        def refused(error: BaseException) -> None:
            where = getattr(error, "field", "")
            to.report(f"{key}.{where}" if where in fields else key, reason_of(error))

        good = {name: item for name, item in found.items() if item is not INVALID}
        made = make_of(base, good, refused, sound=sound)
        return INVALID if made is None else made

    return take


WORDS: Final = "words"
"""The key in the metadata of an attrs field that says what it is, for who left it out."""


@attrs.frozen
class Field:
    """One field of a record, or one keyword of a constructor."""

    kind: Any
    required: bool  # Whether it has no default
    words: str = ""  # What it is, if its type does not tell enough


def fields_of(kind: type) -> Mapping[str, Field] | None:
    """Return the fields of a class that a table can be turned into, or None."""
    if typing.is_typeddict(kind):
        required = typing.cast("frozenset[str]", kind.__required_keys__)  # type: ignore[attr-defined]
        return {
            name: Field(hint, name in required) for name, hint in hints_of(kind).items()
        }
    is_tuple = issubclass(kind, tuple) and hasattr(kind, "_fields")
    if not (attrs.has(kind) or dataclasses.is_dataclass(kind) or is_tuple):
        return None
    hints = hints_of(kind)
    words: dict[str, str] = {}
    if attrs.has(kind):
        hints |= {f.alias: hints.get(f.name, Any) for f in attrs.fields(kind)}
        words = {f.alias: f.metadata.get(WORDS, "") for f in attrs.fields(kind)}
    return {
        each.name: Field(
            hints.get(each.name, Any),
            each.default is each.empty,
            words.get(each.name, ""),
        )
        for each in inspect.signature(kind).parameters.values()
        if each.kind in {each.POSITIONAL_OR_KEYWORD, each.KEYWORD_ONLY}
    }


def make_of(
    cls: Callable[..., Any],
    values: Mapping[str, Any],
    refused: Callable[[BaseException], None],
    *,
    sound: bool = True,
) -> Any:
    """Make an object of its keywords, or tell of each why it is refused.

    What a class refuses by name is left out, and it is asked again: its check of one
    keyword ends before that of the next.

    Args:
        cls: The class.
        values: Its keywords; those that something is wrong with are not among them.
        refused: Is told each refusal.
        sound: Whether nothing is wrong yet. Else nothing is made, and what is refused
            for lack of something is not told.

    Returns:
        The object, or None.
    """
    left = dict(values)
    while True:
        try:
            made = cls(**left)
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # the user's code may do anything
            about = (str(getattr(error, each, "")) for each in ("field", "component"))
            named = [each for word in about if (each := word.partition(".")[0]) in left]
            if sound or named:
                refused(error)
            sound = False
            if not named:
                return None
            del left[named[0]]
        else:
            return made if sound else None
