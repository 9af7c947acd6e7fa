"""What an error number of an I²C transfer means."""

from __future__ import annotations

import errno
from pathlib import Path

from esair.buses._link_bus import GONE
from esair.exceptions import describe

SILENT = frozenset({errno.ENXIO, errno.EREMOTEIO})
"""Nobody acknowledged."""

OCCUPIED = frozenset({errno.EAGAIN, errno.EBUSY})
"""Another master had the bus: the transfer was not made."""

ITS_CHIP = SILENT | OCCUPIED
"""What is said of a chip, or of another master, while the adapter is well."""

GOING_TIME = 0.1
"""How long the kernel takes at most to take an unplugged adapter away, in seconds."""


def fault_text(chip: str, error: OSError, owner: Path | None) -> str:
    """Return what a transfer failed with; the chip may be of a driver of the kernel."""
    match error.errno:
        case code if code in SILENT or code in GONE:
            return f"{chip} does not answer ({describe(error)})"
        case errno.EBUSY if owner is not None:
            unbind = f"echo {owner.parent.name} > {owner}/unbind"
            return f"{chip} belongs to a driver of the kernel; take it back: {unbind}"
        case errno.EBUSY:
            return (
                f"{chip} belongs to a driver of the kernel (unbind that first, or use "
                "that), or another master keeps the bus"
            )
        case errno.EAGAIN:
            return f"another master keeps the bus from {chip}"
    return f"transfer with {chip} failed: {describe(error)}"
