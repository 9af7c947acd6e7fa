"""From the tables of behaviors and reactions to their objects."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from esair.actions import Behavior, ProfiledAction, Reaction, adapt_action
from esair.config._construct import construct
from esair.config._draft import Draft
from esair.config._mistakes import below
from esair.config._profiles import FLOWS, set_profile
from esair.config._tables import Variant, class_of


def make_behavior(
    draft: Draft, name: str, table: Mapping[str, Any]
) -> Behavior | Reaction | None:
    key = f"behavior.{name}"
    keys = {field: below(key, field) for field in table}
    variant = Variant(dict(table), keys)
    cls = class_of(draft, key, variant, "driver", ProfiledAction, "esair.drivers")
    if cls is None:
        return None
    source = draft.source
    made: Behavior | Reaction | None = construct(
        cls,
        name,
        variant.table,
        keys,
        key,
        source.mistakes,
        source.folder,
        later=frozenset({"driver", *FLOWS}),
    )
    if made is None:
        return None
    made = adapt_action(made)
    if not table.keys().isdisjoint(FLOWS):
        set_profile(made, table, keys, source)
    return made
