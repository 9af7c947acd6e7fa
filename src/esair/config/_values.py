"""From the values of a TOML file to the types that Python code asks for.

Nothing is guessed: ``"3"`` is no number, ``true`` is no ``1``, and a table becomes
an attrs class, dataclass, named tuple or typed dictionary only if every key of it
is a field, and every field without a default is there.
"""

from __future__ import annotations

import collections.abc
import enum
import types
import typing
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

from esair.config._mistakes import below, reason_of, show
from esair.config._records import fields_of
from esair.config._words import LISTS, PATHS, unknown, wanted

Report = Callable[[str, str], None]
"""Called with a key and with what is wrong there."""


class Invalid(enum.Enum):
    """Stands for a value that could not be had."""

    INVALID = "invalid"


INVALID: Final = Invalid.INVALID


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
    loose = kind is Any or kind is object or isinstance(kind, typing.TypeVar)
    if loose or value is INVALID:
        return value
    origin = typing.get_origin(kind)
    if origin in {typing.Union, types.UnionType}:
        return _one_of(value, kind, key, report, folder)
    if origin is typing.Annotated:
        return convert(value, typing.get_args(kind)[0], key, report, folder)
    if origin is typing.Literal:
        for choice in typing.get_args(kind):
            if type(choice) is type(value) and choice == value:
                return value
        return _wrong(value, kind, key, report)
    if isinstance(origin or kind, type):
        return _convert_class(value, kind, origin or kind, key, report, folder)
    supertype = getattr(kind, "__supertype__", None)  # typing.NewType
    return (
        value if supertype is None else convert(value, supertype, key, report, folder)
    )


def _convert_class(
    value: object, kind: Any, base: type, key: str, report: Report, folder: Path
) -> Any:
    if base is float and type(value) in {int, float}:
        return float(typing.cast("float", value))
    if base in {int, bool, str, float}:
        return value if type(value) is base else _wrong(value, kind, key, report)
    if base is bytes and isinstance(value, str):
        return value.encode()
    if base in PATHS:
        if not isinstance(value, str) or not value or "\0" in value:
            return _wrong(value, kind, key, report)
        return folder / value
    if issubclass(base, enum.Enum):
        return _member(value, base, key, report)
    if fields_of(base) is not None:
        return make_record(value, kind, key, report, folder)
    if isinstance(value, dict):
        return _convert_table(value, kind, base, key, report, folder)
    if isinstance(value, list):
        return _convert_list(value, kind, base, key, report, folder)
    return value if isinstance(value, base) else _wrong(value, kind, key, report)


def _one_of(value: object, kind: Any, key: str, report: Report, folder: Path) -> Any:
    failures: list[tuple[Any, list[tuple[str, str]]]] = []
    # A path is a better reading of a string than the string itself.
    for choice in sorted(typing.get_args(kind), key=lambda each: each not in PATHS):
        problems: list[tuple[str, str]] = []

        def note(where: str, reason: str, to: list[tuple[str, str]] = problems) -> None:
            to.append((where, reason))

        result = convert(value, choice, key, note, folder)
        if result is not INVALID:
            return result
        failures.append((choice, problems))
    meant = [problems for choice, problems in failures if _is_meant(value, choice)]
    if len(meant) == 1:
        for problem in meant[0]:
            report(*problem)
        return INVALID
    return _wrong(value, kind, key, report)


def _is_meant(value: object, kind: Any) -> bool:
    """Tell whether a table or list has the form of a type, if not its parts."""
    base = typing.get_origin(kind) or kind
    if not isinstance(base, type):
        return False
    if isinstance(value, dict):
        return fields_of(base) is not None or issubclass(base, Mapping)
    return isinstance(value, list) and base in LISTS


def _member(value: object, base: type[enum.Enum], key: str, report: Report) -> Any:
    for member in base:
        if value == member.value and type(value) is type(member.value):
            return member
        if isinstance(value, str) and value.lower() == (member.name or "").lower():
            return member
    return _wrong(value, base, key, report)


def _convert_table(
    value: dict[str, Any], kind: Any, base: type, key: str, report: Report, folder: Path
) -> Any:
    if base not in {dict, collections.abc.Mapping, collections.abc.MutableMapping}:
        return value if isinstance(value, base) else _wrong(value, kind, key, report)
    item_kind = (typing.get_args(kind) or (Any, Any))[1]
    items = {
        name: convert(item, item_kind, below(key, name), report, folder)
        for name, item in value.items()
    }
    return INVALID if INVALID in items.values() else items


def _convert_list(
    value: list[Any], kind: Any, base: type, key: str, report: Report, folder: Path
) -> Any:
    if base not in LISTS:
        return value if isinstance(value, base) else _wrong(value, kind, key, report)
    arguments = typing.get_args(kind) or (Any, ...)
    if base is tuple and arguments[-1] is not ...:
        if len(arguments) != len(value):
            return _wrong(value, kind, key, report)
        kinds: list[Any] = list(arguments)
    else:
        kinds = [arguments[0]] * len(value)
    items = [
        convert(item, item_kind, f"{key}.{index}", report, folder)
        for index, (item, item_kind) in enumerate(zip(value, kinds, strict=True))
    ]
    if any(item is INVALID for item in items):
        return INVALID
    try:
        return LISTS[base](items)
    except TypeError:  # a table in a set
        return _wrong(value, kind, key, report)


def make_record(
    value: object, kind: Any, key: str, report: Report, folder: Path
) -> Any:
    """Return a table as an object of a class with fields; see `convert`."""
    base: type = typing.get_origin(kind) or kind
    fields = fields_of(base)
    if fields is None or not isinstance(value, dict):
        return _wrong(value, kind, key, report)
    sound = True
    arguments: dict[str, Any] = {}
    for name, item in value.items():
        if name not in fields:
            report(below(key, name), unknown("key", name, fields))
            sound = False
            continue
        result = convert(item, fields[name].kind, below(key, name), report, folder)
        sound = sound and result is not INVALID
        arguments[name] = result
    for name, field in fields.items():
        if field.required and name not in value:
            report(key, f"{name!r} is missing: expected {wanted(field.kind)}")
            sound = False
    if not sound:
        return INVALID
    try:
        return base(**arguments)
    except Exception as error:  # a validator of the user's class may raise anything
        where = getattr(error, "field", "")
        report(f"{key}.{where}" if where in fields else key, reason_of(error))
        return INVALID


def _wrong(value: object, kind: Any, key: str, report: Report) -> Invalid:
    report(key, f"expected {wanted(kind)}, not {show(value)}")
    return INVALID
