"""Classes with fields: which ones a table must fill, and of what type."""

from __future__ import annotations

import dataclasses
import inspect
import typing
from collections.abc import Callable, Mapping
from typing import Any, Final

import attrs

from esair.values import hints_of

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
