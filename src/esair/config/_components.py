"""From the tables of buses, devices and behaviors to their objects."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import attrs

from esair.actions import (
    Behavior,
    Derived,
    Guards,
    Need,
    ProfiledAction,
    Reaction,
    Reads,
    Writes,
    adapt_action,
)
from esair.buses import Bus
from esair.config._construct import construct
from esair.config._draft import Draft, Part, Variant
from esair.config._mistakes import below, unknown
from esair.config._records import fields_of
from esair.config._source import Source
from esair.config._tables import class_of, variant_of
from esair.config._values import INVALID, wanted
from esair.resources import APPLIED, Actuator, Resource, adapt_resource, wrong_bus
from esair.values import hints_of, value_type

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


def make_bus(draft: Draft, name: str, table: Mapping[str, Any]) -> Bus | None:
    key = f"bus.{name}"
    variant = variant_of(draft, key, table, "type")
    cls = class_of(draft, key, variant, "type", Bus, "esair.buses")
    if cls is None:
        return None
    later = frozenset({"type"})
    made: Bus | None = construct(draft.source, cls, name, key, variant, later=later)
    return made


def make_behavior(
    draft: Draft, name: str, table: Mapping[str, Any]
) -> Behavior | Reaction | None:
    key = f"behavior.{name}"
    variant = Variant(dict(table), {field: below(key, field) for field in table})
    cls = class_of(draft, key, variant, "driver", ProfiledAction, "esair.drivers")
    if cls is None:
        return None
    later = frozenset({"driver", *FLOWS})
    made = construct(draft.source, cls, name, key, variant, later=later)
    if made is None:
        return None
    action: Behavior | Reaction = adapt_action(made)
    if not table.keys().isdisjoint(FLOWS):
        set_profile(action, table, variant.keys, draft.source)
    return action


def make_device(
    draft: Draft, key: str, name: str, table: Mapping[str, Any], base: type[Resource]
) -> Part:
    variant = variant_of(draft, key, table, "driver")
    cls = class_of(draft, key, variant, "driver", base, "esair.drivers")
    given: dict[str, Any] = {}
    before = len(draft.source.mistakes.errors)
    bus = _find_bus(draft, key, variant, cls, given)
    has_bus = len(draft.source.mistakes.errors) == before and None not in given.values()
    derived = cls is not None and issubclass(cls, Derived)
    if not derived:  # what is computed is the same in a simulation
        _needs_simulation(draft, key, bus, variant)
    if cls is None:
        return Part(base.__name__.lower(), name, None, bus)
    made: Resource | None = construct(
        draft.source,
        cls,
        name,
        key,
        variant,
        given=given,
        kinds={"safe": _command_type(cls)} if base is Actuator else {},
        later=frozenset({"driver", "bus", "reads"} if derived else {"driver", "bus"}),
        make=has_bus,
    )
    if isinstance(made, Derived):
        set_profile(made, variant.table, variant.keys, draft.source)
    return Part(base.__name__.lower(), name, adapt_resource(made), bus)


def _find_bus(
    draft: Draft, key: str, variant: Variant, cls: type | None, given: dict[str, Any]
) -> str | None:
    """Put the bus of a device into what is given to it; return the bus's name."""
    mistakes = draft.source.mistakes
    kind = cls if cls is not None and issubclass(cls, Resource) else None
    if "bus" not in variant.table:
        if kind is not None and wrong_bus(kind, None):
            needed = wanted(hints_of(kind).get("bus", Any))
            told = f"the key 'bus' is missing: expected the name of {needed}"
            mistakes.add(key, told)
        return None
    name, where = variant.table["bus"], variant.keys["bus"]
    buses = draft.buses
    if not isinstance(name, str):
        draft.source.wrong(where, "the name of a bus", name)
    elif name not in buses:
        mistakes.add(where, f"{name!r:.80}: {unknown('bus', name, buses)}")
    else:
        bus = given["bus"] = buses[name]
        if bus is not None and kind is not None and (wrong := wrong_bus(kind, bus)):
            if draft.simulated and not variant.is_simulated:
                wrong += ": give the device sim = { driver = ... } too"
            mistakes.add(where, wrong)
        return str(name)
    return None


def _needs_simulation(
    draft: Draft, key: str, bus_name: str | None, variant: Variant
) -> None:
    """See to it that a simulated robot opens nothing real by an omission."""
    if not draft.simulated:
        return
    if bus_name is not None:
        tables = draft.source.data.get("bus", {})
        if "sim" not in tables.get(bus_name, {}):
            draft.source.mistakes.add(
                f"bus.{bus_name}",
                "nothing stands for this bus in the simulation: expected sim = { ... } "
                "with what replaces the real one (sim = {} if it is harmless as it is)",
            )
    elif not variant.is_simulated:
        draft.source.mistakes.add(
            key,
            "nothing stands for this device in the simulation: expected sim = { driver "
            "= ... } (sim = {} if it is harmless as it is)",
        )


def _command_type(cls: type) -> Any:
    declared = value_type(cls, Actuator)
    if declared is Any and hasattr(cls, "safe"):
        return type(cls.safe)
    return declared
