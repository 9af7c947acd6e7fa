"""What an operator types, as an act with its fields."""

from __future__ import annotations

import json
import shlex
from typing import Any

from esair.exceptions import ConfigError, did_you_mean
from esair.seat._acts import ACTS, REQUIRED, Act


def act_of(text: str) -> tuple[Act, dict[str, Any]]:
    """Return the act that a line means, and what it is about.

    Raises:
        ConfigError: The line is not understood.
    """
    if not isinstance(text, str):
        raise ConfigError("command", "", f"expected a line of text, not {text!r:.80}")
    try:
        words = shlex.split(text)
    except ValueError as error:
        raise ConfigError("command", "", f"{error}: {text!r:.80}") from None
    if not words or words[0] not in ACTS:
        verb = words[0] if words else ""
        hint = did_you_mean(verb, ACTS) or f"; there are {', '.join(ACTS)}"
        raise ConfigError("command", f"{verb!r:.80}", f"it is not known{hint}")
    act = ACTS[words[0]]
    return act, fields_of_words(act, words[1:])


def fields_of_words(act: Act, words: list[str]) -> dict[str, Any]:
    """Return the fields of an act from the words after its name, in their order.

    A field that takes a table gets the words ``name=value`` that are left.
    """
    names = list(act.fields)
    fields: dict[str, Any] = {}
    table = next((n for n in names if act.fields[n].kind == (dict,)), None)
    if table is not None:
        pairs = [word for word in words if "=" in word]
        words = [word for word in words if "=" not in word]
        names.remove(table)
        fields[table] = {
            name: value_of(value)
            for name, _, value in (p.partition("=") for p in pairs)
        }
    required = [n for n in names if act.fields[n].default is REQUIRED]
    if not len(required) <= len(words) <= len(names):
        raise ConfigError("command", act.name, f"expected: {act.usage}")
    for name, word in zip(names, words, strict=False):
        only_text = act.fields[name].kind == (str,)
        fields[name] = word if only_text else value_of(word)
    return fields


def value_of(word: str) -> Any:
    """Return a typed word as a value: JSON if it is some, else a text."""
    try:
        return json.loads(word)
    except ValueError:
        return word
