"""CAN buses: the bus, its frames and errors, the interfaces, the far end, the fake.

Only ``_python_can.py`` and its two nodes know python-can; it is imported when an
interface is opened.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from esair.loading import late

if TYPE_CHECKING:
    from esair.buses.can._bus import CanBus
    from esair.buses.can._fake import FakeCan
    from esair.buses.can._far_end import MemoryCan
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

__getattr__, __dir__ = late(
    __name__,
    {
        "_frame": "FD_SIZES CanWire Frame FrameKind FrameLink CanState ALL Filter Ids Mask",
        "_bus": "CanBus",
        "_fake": "FakeCan",
        "_far_end": "MemoryCan",
        "_interfaces": "devices toml",
        "_python_can": "python_can",
    },
)
