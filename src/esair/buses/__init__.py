"""Bytes, frames, registers: one file for each medium.

Nothing here imports pyserial, python-can or smbus2 until a bus is opened.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from esair.buses._bus import Bus
from esair.buses._stats import BusStats

if TYPE_CHECKING:
    from esair.buses._can import CanBus
    from esair.buses._can_errors import CanState
    from esair.buses._can_frame import Frame, FrameKind, FrameLink
    from esair.buses._i2c import I2CBus
    from esair.buses._i2c_link import MessageLink, RegisterLink
    from esair.buses._inbox import Inbox
    from esair.buses._python_can import python_can
    from esair.buses._serial import SerialBus
    from esair.buses._serial_line import SerialLink

__all__ = [
    "Bus",
    "BusStats",
    "CanBus",
    "CanState",
    "Frame",
    "FrameKind",
    "FrameLink",
    "I2CBus",
    "Inbox",
    "MessageLink",
    "RegisterLink",
    "SerialBus",
    "SerialLink",
    "python_can",
]

_HOME = {
    "CanBus": "_can",
    "CanState": "_can_errors",
    "Frame": "_can_frame",
    "FrameKind": "_can_frame",
    "FrameLink": "_can_frame",
    "I2CBus": "_i2c",
    "Inbox": "_inbox",
    "MessageLink": "_i2c_link",
    "RegisterLink": "_i2c_link",
    "SerialBus": "_serial",
    "SerialLink": "_serial_line",
    "python_can": "_python_can",
}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    import importlib

    found = getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted(__all__)
