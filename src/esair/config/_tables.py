"""The table of one component: its name, its class, and what counts when simulated."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from esair import minimal
from esair.actions import ProfiledAction
from esair.buses import Bus
from esair.config._classes import BUSES, find_class
from esair.config._draft import Draft, Variant
from esair.config._mistakes import below, dotted
from esair.config._source import Source
from esair.config._values import wanted
from esair.resources import Actuator, Sensor


def named_tables(
    source: Source, kind: str, suffix: str = ""
) -> list[tuple[str, dict[str, Any]]]:
    holder = source.data.get(kind, {})
    found: list[tuple[str, dict[str, Any]]] = []
    for name, table in list(holder.items()):
        key = dotted(kind, name)
        good = source.is_name(kind, name.removesuffix(suffix), key)
        if good and isinstance(table, dict):
            found.append((name, table))
            continue
        if good:
            source.wrong(key, f"a table [{kind}.NAME]", table)
        del holder[name]
    return found


def variant_of(
    draft: Draft, key: str, table: Mapping[str, Any], driver: str
) -> Variant:
    real = {name: value for name, value in table.items() if name != "sim"}
    keys = {name: below(key, name) for name in real}
    sim = table.get("sim")
    if "sim" in table and not isinstance(sim, dict):
        draft.source.wrong(f"{key}.sim", "a table of what replaces the real keys", sim)
    if not draft.simulated or not isinstance(sim, dict):
        return Variant(real, keys)
    inherited: frozenset[str] = frozenset()
    if driver in sim:  # another class: it has its own keys, and is on its own bus
        real.pop("bus", None)
        inherited = frozenset(real) - frozenset(sim)
    keys.update({name: below(f"{key}.sim", name) for name in sim})
    return Variant({**real, **sim}, keys, inherited, is_simulated=True)


def class_of(
    draft: Draft, key: str, variant: Variant, field: str, base: type, group: str
) -> type | None:
    """Return the class that a table names, or note why it cannot serve."""
    mistakes = draft.source.mistakes
    if field not in variant.table:
        known = ", ".join(map(repr, BUSES)) if base is Bus else "an installed name"
        mistakes.add(
            key, f"the key {field!r} is missing: expected {known} or 'module:Class'"
        )
        return None
    name = variant.table[field]
    where = variant.keys[field]
    if not isinstance(name, str):
        draft.source.wrong(where, wanted(str), name)
        return None
    found = find_class(
        name,
        where,
        mistakes,
        group=group,
        folder=draft.source.folder,
        kind=(base, _KINDS[base]),
        built_in=BUSES if base is Bus else None,
    )
    if found is None or issubclass(found, (base, _MINIMAL.get(base, base))):
        return found
    mistakes.add(where, f"expected {_KINDS[base]}, {name!r} is {_kind_of(found)}")
    return None


_KINDS: Final[Mapping[type, str]] = {
    Sensor: "a Sensor",
    Actuator: "an Actuator",
    ProfiledAction: "a Behavior or Reaction",
    Bus: "a Bus",
}
_MINIMAL: Final[Mapping[type, type]] = {
    Sensor: minimal.Sensor,
    Actuator: minimal.Actuator,
    ProfiledAction: minimal.Reaction,
}
"""What was written for a microcontroller serves too; it gets an adapter."""

_PLACES: Final[Mapping[type, str]] = {
    Sensor: "[sensor.NAME]",
    Actuator: "[actuator.NAME]",
    ProfiledAction: "[behavior.NAME]",
    Bus: "[bus.NAME]",
}


def _kind_of(cls: type) -> str:
    for base, text in _KINDS.items():
        if issubclass(cls, base):
            return f"{text}: its place is {_PLACES[base]}"
    bases = ", ".join(each.__name__ for each in cls.__bases__)
    return f"none: its bases are {bases}"
