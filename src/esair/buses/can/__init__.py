"""CAN buses: the bus, its frames and errors, the interfaces, the far end, the fake.

Only ``_python_can.py`` knows python-can, and imports it when an interface is opened.
"""

from esair.buses.can._bus import CanBus
from esair.buses.can._fake import FakeCan, MemoryCan
from esair.buses.can._frame import (
    ALL,
    FD_SIZES,
    CanState,
    CanWire,
    Filter,
    Frame,
    FrameKind,
    FrameLink,
    Ids,
    Mask,
)
from esair.buses.can._interfaces import devices, toml
from esair.buses.can._python_can import python_can

__all__ = [
    "ALL",
    "FD_SIZES",
    "CanBus",
    "CanState",
    "CanWire",
    "FakeCan",
    "Filter",
    "Frame",
    "FrameKind",
    "FrameLink",
    "Ids",
    "Mask",
    "MemoryCan",
    "devices",
    "python_can",
    "toml",
]
