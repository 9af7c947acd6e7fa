"""One component by its class and the values of its keys: what somebody has typed."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from esair import minimal
from esair.actions import Behavior, ProfiledAction, Reaction
from esair.buses import Bus
from esair.config._classes import find_class
from esair.config._components import make_behavior, make_device
from esair.config._draft import Draft, Part
from esair.config._mistakes import Lines, Mistakes
from esair.config._source import Source
from esair.exceptions import ConfigError
from esair.resources import Actuator, Resource, Sensor
from esair.values import check_name, snake_case

_KINDS = (
    ("sensor", (Sensor, minimal.Sensor)),
    ("actuator", (Actuator, minimal.Actuator)),
    ("behavior", (ProfiledAction, minimal.Reaction)),
)


def is_imported(driver: str) -> bool:
    """Tell whether the module of a class is there."""
    return driver.partition(":")[0] in sys.modules


def find_module(driver: str, folder: Path) -> None:
    """Import the module of a class; if it cannot be, `make_component` tells why."""
    find_class(
        driver, "", Mistakes("", Lines("")), group="esair.drivers", folder=folder
    )


def make_component(
    driver: str, values: Mapping[str, Any], buses: Iterable[Bus], folder: Path
) -> Resource | Behavior | Reaction:
    """Make a component as a table of a file would.

    Args:
        driver: Its class, ``module:Class``.
        values: The values of its keys; ``name`` is its name, that of the class unless
            given.
        buses: The buses that it may be on, by their names.
        folder: Where its module is found, beside those that are installed.

    Raises:
        ConfigError: There is no such class, or a key is wrong.
        ExceptionGroup: Several are.
    """
    mistakes = Mistakes(driver, Lines(""))
    cls = find_class(driver, "", mistakes, group="esair.drivers", folder=folder)
    kind = next((k for k, bases in _KINDS if cls and issubclass(cls, bases)), None)
    if cls is not None and kind is None:
        mistakes.add("", "expected a Sensor, an Actuator, a Behavior or a Reaction")
    made: Resource | Behavior | Reaction | None = None
    if cls is not None and kind is not None:
        table = {"driver": driver, **values}
        name = check_name(kind, table.pop("name", snake_case(cls.__name__)))
        source = Source(folder / "typed", "", "", {kind: {name: table}}, mistakes)
        draft = Draft(source, simulated=False)
        draft.parts += [Part("bus", each.name, each) for each in buses]
        if kind == "behavior":
            made = make_behavior(draft, name, table)
        else:
            base = Sensor if kind == "sensor" else Actuator
            made = make_device(draft, f"{kind}.{name}", name, table, base).made
    if len(mistakes.errors) == 1:
        raise mistakes.errors[0]
    mistakes.raise_all()
    if made is None:
        raise ConfigError(driver, "", "it cannot be made")
    return made
