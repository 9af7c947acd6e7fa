"""What a type asks of a TOML file, in the words of an error."""

from __future__ import annotations

import collections.abc
import enum
import inspect
import os
import types
import typing
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final

from esair.config._mistakes import show
from esair.config._records import fields_of
from esair.exceptions import did_you_mean

PATHS: Final = (Path, os.PathLike)  # Types whose values are paths

LISTS: Final[dict[type, type]] = {
    list: list,
    tuple: tuple,
    set: set,
    frozenset: frozenset,
    collections.abc.Sequence: tuple,
    collections.abc.Iterable: tuple,
    collections.abc.Collection: tuple,
}
"""What a list becomes, by the type that is asked for."""


def unknown(what: str, name: str, known: Iterable[str]) -> str:
    """Say that a name is unknown, and the nearest, or else all that are known."""
    names = sorted(known)
    hint = did_you_mean(name, names)
    if not hint:
        hint = f"; there are {', '.join(names[:12])}" if names else "; there are none"
        hint += ", ..." if len(names) > 12 else ""
    return f"there is no such {what}{hint}"


def wanted(kind: Any) -> str:
    """Say in words what a type asks of a TOML file."""
    names: dict[Any, str] = {
        float: "a number",
        int: "a whole number",
        str: "a string",
        bytes: "a string",
        bool: "true or false",
        type(None): "nothing",
        Any: "a value",
        object: "a value",
        inspect.Parameter.empty: "a value",
    }
    try:
        if kind in names:
            return names[kind]
    except TypeError:  # not hashable
        return str(kind)
    origin = typing.get_origin(kind)
    arguments = typing.get_args(kind)
    if origin in {typing.Union, types.UnionType}:
        choices = dict.fromkeys(
            wanted(each) for each in arguments if each is not type(None)
        )
        return " or ".join(choices)
    if origin is typing.Annotated:
        return wanted(arguments[0])
    if origin is typing.Literal:
        return "one of " + ", ".join(show(each) for each in arguments)
    base = origin or kind
    if not isinstance(base, type):
        return str(kind)
    if base in PATHS:
        return "a path"
    if issubclass(base, enum.Enum):
        return "one of " + ", ".join(show(member.value) for member in base)
    fields = fields_of(base)
    if fields is not None:
        return f"a table with the keys {', '.join(fields)}"
    if base is tuple and arguments and arguments[-1] is not ...:
        parts = ", ".join(wanted(each) for each in arguments)
        return f"a list of {len(arguments)} ({parts})"
    if base in LISTS:
        return f"a list, each {wanted(arguments[0])}" if arguments else "a list"
    if issubclass(base, collections.abc.Mapping) or base is collections.abc.Mapping:
        return f"a table, each {wanted(arguments[1])}" if arguments else "a table"
    article = "an" if base.__name__[0] in "AEIOU" else "a"
    return f"{article} {base.__name__}"
