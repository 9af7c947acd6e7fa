"""A driver that is opened by hand, and whose bus was forgotten, says so."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import typing
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import esair.drivers
from esair.exceptions import ConfigError
from esair.resources import Actuator, Resource, Sensor, bus_kind

pytestmark = pytest.mark.virtual_clock

HERE = Path(__file__).parent
GIVEN: dict[str, Any] = {
    "attribute": "value",
    "channel": 0,
    "channels": {"a": 1},
    "database": HERE / "rover.dbc",
    "eds": HERE / "motor.eds",
    "identifier": 1,
    "library": lambda _bus: None,
    "message": "WheelCommand",
    "node": 5,
    "object": "Position actual value",
    "register": 1,
    "safe": 0,
    "topic": "a",
    "value": "value",
}
"""What they ask for, beside a bus."""

OTHERWISE: dict[str, dict[str, Any]] = {
    "RcOverride": {"safe": {"a": 0.0}},
    "CanopenActuator": {"object": "Target velocity"},
    "DbcActuator": {"safe": {"left": 0.0, "right": 0.0, "gear": 0, "count": 0}},
}


def shipped() -> Iterator[type[Resource]]:
    """Return each driver for a part on a bus."""
    for module in pkgutil.walk_packages(esair.drivers.__path__, "esair.drivers."):
        try:
            found = importlib.import_module(module.name)
        except ModuleNotFoundError:  # of an extra that is not installed
            continue
        for cls in vars(found).values():
            if (
                isinstance(cls, type)
                and issubclass(cls, (Sensor, Actuator))
                and cls.__module__ == module.name
                and bus_kind(cls) is not Any
                and not cls.__name__.startswith("_")
            ):
                yield cls


SHIPPED = tuple(shipped())
assert len(SHIPPED) >= 20


def made(cls: type[Resource]) -> Resource:
    needed = {
        name
        for each in cls.__mro__
        if "__init__" in vars(each)
        for name, parameter in inspect.signature(each).parameters.items()
        if parameter.default is parameter.empty and name in GIVEN
    }
    given = {name: GIVEN[name] for name in needed}
    return cls(name="part", **{**given, **OTHERWISE.get(cls.__name__, {})})


async def awaited(opened: Any) -> None:
    assert opened is None or await opened is None


@pytest.mark.parametrize("cls", SHIPPED, ids=lambda cls: cls.__name__)
async def test_a_bus_that_was_forgotten_is_named(cls: type[Resource]) -> None:
    """As soon as the device is made, or as it is opened; never an AttributeError."""
    kinds = typing.get_args(bus_kind(cls)) or (bus_kind(cls),)
    names = " or ".join(each.__name__ for each in kinds)
    wanted = rf"part: bus: expected an? {names}\b.*"
    with pytest.raises(ConfigError, match=wanted + "bus="):
        await awaited(made(cls).open())


class Plain(esair.Sensor[float]):
    """Opens in a thread, or as whoever calls it."""

    bus: esair.buses.I2CBus

    def open(self) -> None:
        self.opened = self.bus.name

    async def read(self) -> float:
        return 1.0


class Reader(esair.Sensor[float]):
    """Has nothing to do at an opening."""

    bus: esair.buses.I2CBus

    async def read(self) -> float:
        return float(self.bus.timeout)


@pytest.mark.parametrize("cls", [Plain, Reader])
async def test_so_does_a_driver_of_the_users_own(cls: type[Resource]) -> None:
    """Whatever kind of opening it has."""
    with pytest.raises(ConfigError, match="part: bus: expected an I2CBus"):
        await awaited(cls(name="part").open())
