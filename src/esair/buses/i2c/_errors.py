"""What an error number of an I²C transfer means."""

from __future__ import annotations

import errno
from pathlib import Path

from esair.exceptions import (
    DeviceFaultError,
    DeviceLostError,
    DriverStuckError,
    EsairError,
    describe,
)

GONE = frozenset({errno.ENODEV, errno.EBADF, errno.ENOENT, errno.ESHUTDOWN})
"""The adapter itself is not there; some say it of a chip (see `explained`)."""

SILENT = frozenset({errno.ENXIO, errno.EREMOTEIO})
"""Nobody acknowledged."""

OCCUPIED = frozenset({errno.EAGAIN, errno.EBUSY})
"""Another master had the bus: the transfer was not made."""

ITS_CHIP = SILENT | OCCUPIED
"""What is said of a chip, or of another master, while the adapter is well."""

GOING_TIME = 0.1
"""How long the kernel takes at most to take an unplugged adapter away, in seconds."""


def explained(
    name: str,
    error: OSError,
    address: int | None,
    *,
    there: bool | None,
    seconds: float,
    owner: Path | None = None,
) -> EsairError:
    """Return what happened, with the same ``errno``; is the adapter there, or None?"""
    chip = _chip(address)
    code = error.errno
    if there is False or (there is None and code in GONE):
        return DeviceLostError(name, describe(error))
    if code == errno.ETIMEDOUT:
        return stuck_with(name, address, seconds)
    fault: DeviceFaultError
    if code in SILENT or code in GONE:
        fault = DeviceFaultError(name, f"{chip} does not answer ({describe(error)})")
    elif code == errno.EBUSY and owner is not None:
        unbind = f"echo {owner.parent.name} > {owner}/unbind"
        fault = DeviceFaultError(
            name, f"{chip} belongs to a driver of the kernel; take it back: {unbind}"
        )
    elif code == errno.EBUSY:
        fault = DeviceFaultError(
            name,
            f"{chip} belongs to a driver of the kernel (unbind that first, or use that), "
            "or another master keeps the bus",
        )
    elif code == errno.EAGAIN:
        fault = DeviceFaultError(name, f"another master keeps the bus from {chip}")
    else:
        fault = DeviceFaultError(
            name, f"transfer with {chip} failed: {describe(error)}"
        )
    fault.errno = code
    return fault


def stuck_with(name: str, address: int | None, seconds: float) -> DriverStuckError:
    """Return the error for a transfer that takes too long."""
    return DriverStuckError(name, f"a transfer with {_chip(address)}", seconds)


def _chip(address: int | None) -> str:
    return "a chip" if address is None else f"chip {address:#04x}"
