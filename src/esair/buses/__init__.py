"""Bytes, frames, registers: what all buses promise, and a folder for each medium.

The folder of a medium has its far end too, which a bus is given with ``wire=``: it moves
bytes as a wire does and can be pulled, stalled and disturbed. A fake is one with words
for a test; physics is in `esair.sim`.

Nothing here imports pyserial, python-can or smbus2 until a bus is opened. The names of
a medium are in its package, such as `esair.buses.can`, and the usual ones here too.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

import attrs

from esair.buses._bus import Bus, BusStats, LateWire, Wire, open_on, shut_on, wanted
from esair.buses._exchanges import Exchange, Exchanges
from esair.buses._inbox import Inbox
from esair.buses._link_bus import LinkBus
from esair.loading import late

if TYPE_CHECKING:
    from esair.buses._fakes import Awaited, Failures
    from esair.buses.can import (
        CanBus,
        CanState,
        Frame,
        FrameKind,
        FrameLink,
        python_can,
    )
    from esair.buses.i2c import I2CBus, MessageLink, RegisterLink
    from esair.buses.serial import SerialBus, SerialLink

__all__ = [
    "MEDIA",
    "Awaited",
    "Bus",
    "BusStats",
    "CanBus",
    "CanState",
    "Exchange",
    "Exchanges",
    "Failures",
    "Frame",
    "FrameKind",
    "FrameLink",
    "I2CBus",
    "Inbox",
    "LateWire",
    "LinkBus",
    "Medium",
    "MessageLink",
    "RegisterLink",
    "SerialBus",
    "SerialLink",
    "Wire",
    "open_on",
    "python_can",
    "shut_on",
    "wanted",
]


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

_late, _ = late(
    __name__,
    {
        "can": "CanBus CanState Frame FrameKind FrameLink python_can",
        "_fakes": "Awaited Failures",
        "i2c": "I2CBus MessageLink RegisterLink",
        "serial": "SerialBus SerialLink",
    },
)


def __getattr__(name: str) -> Any:
    for medium in MEDIA.values():  # the class of a medium, also of one that is new
        if medium.bus == name:
            return medium.get(name)
    return _late(name)


def __dir__() -> list[str]:
    return sorted(__all__)
