"""Bytes, frames, registers: what all buses promise, and a folder for each medium.

The folder of a medium has its far end too, which a bus is given with ``wire=``: it moves
bytes as a wire does and can be pulled, stalled and disturbed. A fake is one with words
for a test; physics is in `esair.sim`.

Nothing here imports pyserial, python-can or smbus2 until a bus is opened. The names of
a medium are in its package, such as `esair.buses.can`, and the usual ones here too.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from esair.buses._bus import Bus, BusStats, LateWire, Wire, wanted
from esair.buses._exchanges import Exchange, Exchanges
from esair.buses._inbox import Inbox
from esair.buses._link_bus import LinkBus
from esair.buses._media import MEDIA, Medium
from esair.buses._opening import open_on, shut_on
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
