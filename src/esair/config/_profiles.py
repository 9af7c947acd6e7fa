"""Profiles in the file: what an action reads and writes, changed without its class."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import attrs

from esair.actions import Derived, Guards, Need, ProfiledAction, Reads, Writes
from esair.config._mistakes import below, unknown
from esair.config._records import fields_of
from esair.config._source import Source
from esair.config._values import INVALID, wanted
from esair.resources import APPLIED

FLOWS: Final = ("reads", "writes", "guards")
"""The keys that change the profile of a behavior or reaction."""

_KINDS: Final[Mapping[str, type[Need]]] = {
    "reads": Reads,
    "writes": Writes,
    "guards": Guards,
}


def set_profile(
    action: ProfiledAction | Derived[Any],
    table: Mapping[str, object],
    keys: Mapping[str, str],
    source: Source,
) -> None:
    """Change what an action reads, writes or guards as the file says, or note why not."""
    before = len(source.mistakes.errors)
    given: dict[str, dict[str, Any]] = {flow: {} for flow in FLOWS}
    needs: Mapping[str, Need]
    needs = action.inputs if isinstance(action, Derived) else action.needs
    for attribute, need in needs.items():
        given[_flow_of(need)][attribute] = need
    for flow in FLOWS[:1] if isinstance(action, Derived) else FLOWS:
        if flow not in table:
            continue
        ports = table[flow]
        if not isinstance(ports, dict):
            source.wrong(keys[flow], "a table with a key for each port", ports)
            continue
        for attribute, changes in ports.items():
            where = below(keys[flow], attribute)
            declared = needs.get(attribute)
            if declared is not None and _flow_of(declared) != flow:
                doing = _flow_of(declared)
                told = f"its class declares {attribute!r} the other way round: it {doing} it"
                source.mistakes.add(where, told)
                continue
            changed = _changed(flow, given[flow].get(attribute), changes, where, source)
            if changed is not None:
                given[flow][attribute] = changed
    if len(source.mistakes.errors) > before:
        return
    if isinstance(action, Derived):
        action.set_reads(given["reads"])
    else:
        # Again, and not through the class: its own constructor may not hand them on.
        ProfiledAction.__init__(action, name=action.name, **given)


def _flow_of(need: Need) -> str:
    return next(flow for flow, kind in _KINDS.items() if isinstance(need, kind))


def _changed(
    flow: str, declared: Any, changes: object, key: str, source: Source
) -> Need | None:
    if isinstance(changes, str):
        changes = {"name": changes}
    if not isinstance(changes, dict):
        source.wrong(key, "the name of a resource, or a table", changes)
        return None
    known = fields_of(_KINDS[flow]) or {}
    fields = {n: f.kind for n, f in known.items() if n not in {"type", "attribute"}}
    values: dict[str, Any] = {}
    for field, value in changes.items():
        where = below(key, field)
        if field not in fields:
            source.mistakes.add(where, unknown("key", field, fields))
            continue
        result = source.convert(value, fields[field], where)
        if result is INVALID:
            continue
        if field in {"max_age", "hold"} and not result > 0:
            source.wrong(where, f"{wanted(float)} > 0, in seconds", value)
            continue
        if field == "name":
            resource = result.removesuffix(APPLIED)
            if not source.is_name("resource", resource, where):
                continue
        values[field] = result
    if declared is not None:
        changed: Need = attrs.evolve(declared, **values)
        return changed
    return _KINDS[flow](Any, **values)
