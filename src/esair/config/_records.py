"""Classes with fields: which ones a table must fill, and of what type."""

from __future__ import annotations

import dataclasses
import inspect
import typing
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import attrs

_KNOWN: Final = {"Path": Path}
"""What many import for type checkers only, and is a path here all the same."""


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


def hints_of(something: Any) -> dict[str, Any]:
    """Return type hints; what cannot be resolved at run time is `typing.Any`."""
    try:
        return typing.get_type_hints(something)
    except Exception:  # a name imported for type checkers only, or nonsense
        holders = [something]
    if inspect.isclass(something):
        holders = list(reversed(something.__mro__))
    return {
        name: _resolved(hint, holder)
        for holder in holders
        for name, hint in inspect.get_annotations(holder).items()
    }


def _resolved(hint: object, holder: object) -> Any:
    if not isinstance(hint, str):
        return hint
    try:
        return eval(hint, {**_KNOWN, **vars(inspect.getmodule(holder))})
    except Exception:  # as above, but for this name only
        return Any
