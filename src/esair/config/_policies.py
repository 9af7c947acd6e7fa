"""The tables ``[access.RESOURCE]``: who may do what; ``[access.behaviors]``: who manages."""

from __future__ import annotations

from typing import Any, Final, Literal

from esair.config._mistakes import below, dotted, show
from esair.config._source import Source
from esair.exceptions import ConfigError, did_you_mean
from esair.messages import Access, BehaviorsPolicy, Policy
from esair.values import check_name

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
    allow: dict[str, Literal["manage"]] = {}
    for behavior, value in table.items():
        where = below(key, behavior)
        if not _is_name(source, where, behavior):
            continue
        if value == "manage":
            allow[behavior] = "manage"
        else:
            right = '"manage", the right to add, remove, replace and restart behaviors'
            source.wrong(where, right, value)
    return BehaviorsPolicy(allow)


def _policy(source: Source, key: str, name: str, table: dict[str, Any]) -> Policy:
    allow: Any = {}
    levels: Any = {}
    exclusive = False
    for behavior, value in table.items():
        where = below(key, behavior)
        if behavior == "exclusive":
            exclusive = source.convert(value, bool, where) is True
        elif behavior == "max_priority":
            levels = _levels(source, where, value)
        elif _is_name(source, where, behavior):
            access = _access(source, where, value)
            if access is not None:
                allow[behavior] = access
    return Policy(name, allow=allow, exclusive=exclusive, max_priority=levels)


def _levels(source: Source, key: str, value: object) -> dict[str, int]:
    if not isinstance(value, dict):
        source.wrong(key, "a table such as { wander = 5 }", value)
        return {}
    levels: dict[str, int] = {}
    for behavior, level in value.items():
        where = below(key, behavior)
        if not _is_name(source, where, behavior):
            continue
        if type(level) is int:
            levels[behavior] = level
        else:
            source.wrong(where, "a whole number", level)
    return levels


def _is_name(source: Source, key: str, behavior: str) -> bool:
    if behavior == "*":
        return True
    try:
        check_name("behavior", behavior)
    except ConfigError:
        source.mistakes.add(
            key, "expected the name of a behavior, or '*' for all others"
        )
        return False
    return True


def _access(source: Source, key: str, value: object) -> Access | None:
    if not isinstance(value, str):
        source.wrong(key, 'rights such as "read, write"', value)
        return None
    access = Access(0)
    sound = True
    for word in value.split(","):
        right = word.strip()
        if right in _RIGHTS:
            access |= _RIGHTS[right]
        else:
            source.mistakes.add(
                key,
                f"expected some of {', '.join(_RIGHTS)}, with commas between them, "
                f"not {show(right)}{did_you_mean(right, _RIGHTS)}",
            )
            sound = False
    return access if sound else None
