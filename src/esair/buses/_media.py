"""The table of media: a row for each folder, read by all who list or name them."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Final

import attrs


@attrs.frozen
class Medium:
    """A medium, and where everything of it is.

    Its package has the two classes, and two functions: ``devices(root)`` returns what
    is plugged in as `Device` objects whose ``kind`` is the name of the medium;
    ``toml(device, name)`` returns the lines of a robot.toml for one of them.

    Attributes:
        package: The package.
        bus: The name of its class of buses.
        fake: The name of the fake of it.
    """

    package: str
    bus: str
    fake: str

    def get(self, name: str) -> Any:
        """Return something of the package by its name; imports what is needed for it."""
        return getattr(importlib.import_module(self.package), name)


MEDIA: Final[Mapping[str, Medium]] = MappingProxyType(
    {
        "serial": Medium("esair.buses.serial", bus="SerialBus", fake="FakeSerial"),
        "can": Medium("esair.buses.can", bus="CanBus", fake="FakeCan"),
        "i2c": Medium("esair.buses.i2c", bus="I2CBus", fake="FakeI2c"),
        "spi": Medium("esair.buses.spi", bus="SpiBus", fake="FakeSpi"),
        "mqtt": Medium("esair.buses.mqtt", bus="MqttBus", fake="FakeMqtt"),
    }
)
"""The media by what a robot.toml calls them: ``[bus.x] type = "serial"``."""
