"""Bytes, frames, registers: one file for each medium.

Nothing here imports pyserial, python-can or smbus2 until a bus is opened.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from esair.buses._bus import Bus
from esair.buses._stats import BusStats

if TYPE_CHECKING:
    from esair.buses._can import CanBus, Frame, FrameLink, python_can
    from esair.buses._i2c import I2CBus, RegisterLink
    from esair.buses._inbox import Inbox
    from esair.buses._serial import SerialBus, SerialLink

__all__ = [
    "Bus",
    "BusStats",
    "CanBus",
    "Frame",
    "FrameLink",
    "I2CBus",
    "Inbox",
    "RegisterLink",
    "SerialBus",
    "SerialLink",
    "python_can",
]

_HOME = {
    "CanBus": "_can",
    "Frame": "_can",
    "FrameLink": "_can",
    "I2CBus": "_i2c",
    "Inbox": "_inbox",
    "RegisterLink": "_i2c",
    "SerialBus": "_serial",
    "SerialLink": "_serial",
    "python_can": "_can",
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
