"""From the tables of buses, sensors and actuators to their objects."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from esair.buses import Bus
from esair.config._construct import construct
from esair.config._draft import Draft
from esair.config._mistakes import show
from esair.config._records import hints_of
from esair.config._tables import Variant, class_of, variant_of
from esair.config._values import INVALID, convert
from esair.config._words import unknown, wanted
from esair.connections import check_declaration
from esair.resources import Actuator, Resource, adapt_resource
from esair.values import value_type


def make_bus(draft: Draft, name: str, table: Mapping[str, Any]) -> Bus | None:
    key = f"bus.{name}"
    variant = variant_of(draft, key, table, "type")
    cls = class_of(draft, key, variant, "type", Bus, "esair.buses")
    if cls is None:
        return None
    made: Bus | None = construct(
        cls,
        name,
        variant.table,
        variant.keys,
        key,
        draft.source.mistakes,
        draft.source.folder,
        inherited=variant.inherited,
        later=frozenset({"type"}),
    )
    return made


def make_device(
    draft: Draft, key: str, name: str, table: Mapping[str, Any], base: type[Resource]
) -> Resource | None:
    variant = variant_of(draft, key, table, "driver")
    cls = class_of(draft, key, variant, "driver", base, "esair.drivers")
    given: dict[str, Any] = {}
    has_bus = _find_bus(draft, key, name, variant, cls, given)
    _needs_simulation(draft, key, name, variant)
    if cls is None:
        return None
    made: Resource | None = construct(
        cls,
        name,
        variant.table,
        variant.keys,
        key,
        draft.source.mistakes,
        draft.source.folder,
        given=given,
        kinds={"safe": _command_type(cls)} if base is Actuator else {},
        inherited=variant.inherited,
        later=frozenset({"driver", "bus"}),
        make=has_bus,
    )
    made = adapt_resource(made)
    if isinstance(made, Actuator) and not _is_sound(draft, made, key):
        return None
    return made


def _find_bus(
    draft: Draft,
    key: str,
    name: str,
    variant: Variant,
    cls: type | None,
    given: dict[str, Any],
) -> bool:
    """Put the bus of a device into what is given to it; false if that fails."""
    mistakes = draft.source.mistakes
    kind = Any if cls is None else hints_of(cls).get("bus", Any)
    if "bus" not in variant.table:
        if _fits(None, kind, draft):
            return True
        mistakes.add(
            key, f"the key 'bus' is missing: expected the name of {wanted(kind)}"
        )
        return False
    bus_name, where = variant.table["bus"], variant.keys["bus"]
    if not isinstance(bus_name, str):
        mistakes.add(where, f"expected the name of a bus, not {show(bus_name)}")
        return False
    if bus_name not in draft.buses:
        mistakes.add(
            where, f"{bus_name!r:.80}: {unknown('bus', bus_name, draft.buses)}"
        )
        return False
    draft.bus_of[name] = bus_name
    bus = given["bus"] = draft.buses[bus_name]
    if bus is not None and not _fits(bus, kind, draft):
        has = type(bus).__name__
        mistakes.add(where, f"expected {wanted(kind)}, but {bus_name!r} is a {has}")
    return bus is not None


def _fits(bus: Bus | None, kind: Any, draft: Draft) -> bool:
    """Tell whether a driver that asks for a kind of bus can do with this one."""
    found = convert(bus, kind, "", lambda *_: None, draft.source.folder)
    return found is not INVALID


def _needs_simulation(draft: Draft, key: str, name: str, variant: Variant) -> None:
    """See to it that a simulated robot opens nothing real by an omission."""
    if not draft.simulated:
        return
    bus_name = draft.bus_of.get(name)
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


def _is_sound(draft: Draft, actuator: Actuator[Any], key: str) -> bool:
    """Check what an actuator declares; one that only lacks a safe command is shown."""
    errors = check_declaration(actuator)
    for error in errors:
        draft.source.mistakes.caught(key, error, "its declaration")
    return not errors or (len(errors) == 1 and not hasattr(actuator, "safe"))
