"""The tables ``[access.RESOURCE]``: who may do what; ``[access.behaviors]``: who manages."""

from __future__ import annotations

import functools
import operator
from collections.abc import Mapping
from typing import Any, Final, Literal

from esair.config._mistakes import below, dotted, show
from esair.config._source import Source
from esair.config._values import INVALID, Invalid
from esair.exceptions import did_you_mean
from esair.messages import Access, BehaviorsPolicy, Policy

BEHAVIORS: Final = "behaviors"
"""The table of those who may manage others; no resource's."""

_RIGHTS: Final = {
    "read": Access.READ,
    "write": Access.WRITE,
    "configure": Access.CONFIGURE,
    "guard": Access.GUARD,
    "none": Access(0),
}


def read_policies(source: Source) -> dict[str, Policy | BehaviorsPolicy]:
    """Return the rules of a file, by the name of the resource."""
    tables = source.data.get("access", {})
    policies: dict[str, Policy | BehaviorsPolicy] = {}
    for name, table in tables.items():
        key = dotted("access", name)
        if not isinstance(table, dict):
            source.wrong(key, 'a table such as { wander = "write" }', table)
        else:
            read = _managers if name == BEHAVIORS else _policy
            policies[name] = read(source, key, name, table)
    return policies


def _managers(
    source: Source, key: str, name: str, table: dict[str, Any]
) -> BehaviorsPolicy:
    return BehaviorsPolicy(_by_behavior(source, key, table, Literal["manage"]))


def _policy(source: Source, key: str, name: str, table: dict[str, Any]) -> Policy:
    rest = dict(table)
    exclusive = rest.pop("exclusive", False)
    levels = rest.pop("max_priority", {})
    if not isinstance(levels, dict):
        source.wrong(
            below(key, "max_priority"), "a table such as { wander = 5 }", levels
        )
        levels = {}
    return Policy(
        name,
        allow=_by_behavior(source, key, rest, Access),
        exclusive=source.convert(exclusive, bool, below(key, "exclusive")) is True,
        max_priority=_by_behavior(source, below(key, "max_priority"), levels, int),
    )


def _by_behavior(
    source: Source, key: str, table: Mapping[str, object], kind: Any
) -> dict[str, Any]:
    """Return what a table says of each behavior, and of all others by ``*``."""
    found: dict[str, Any] = {}
    for behavior, value in table.items():
        where = below(key, behavior)
        if behavior != "*" and not source.is_name("behavior", behavior, where):
            continue
        result = (
            _access(source, where, value)
            if kind is Access
            else source.convert(value, kind, where)
        )
        if result is not INVALID:
            found[behavior] = result
    return found


def _access(source: Source, key: str, value: object) -> Access | Invalid:
    if not isinstance(value, str):
        source.wrong(key, 'rights such as "read, write"', value)
        return INVALID
    words = [word.strip() for word in value.split(",")]
    for word in words:
        if word not in _RIGHTS:
            told = f"expected some of {', '.join(_RIGHTS)}, with commas between them, "
            told += f"not {show(word)}{did_you_mean(word, _RIGHTS)}"
            source.mistakes.add(key, told)
            return INVALID
    return functools.reduce(operator.or_, (_RIGHTS[word] for word in words))
