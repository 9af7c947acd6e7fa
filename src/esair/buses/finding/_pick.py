"""Which of the devices that are there somebody means."""

from __future__ import annotations

from collections.abc import Sequence

from esair.buses.finding._device import Device
from esair.buses.finding._usb import parse_identity


def pick(wanted: str, there: Sequence[Device], noun: str) -> str:
    """Return the path of a device.

    Args:
        wanted: A path, ``usb:VID:PID[:SERIAL]``, the beginning of its name, or nothing
            for the only one that is there.
        there: Those that are there; nobody looks whether a path is one of theirs.
        noun: What they are called, for the error.

    Raises:
        FileNotFoundError: It is not there, or several are.
    """
    if wanted.startswith("/"):
        return wanted
    if wanted.startswith("usb:"):
        identity = parse_identity(wanted)
        fitting = [
            each
            for each in there
            if each.identity and identity.fits(parse_identity(each.identity))
        ]
    else:
        fitting = [each for each in there if each.description.startswith(wanted)]
    if len(fitting) == 1:
        return fitting[0].path
    known = ", ".join(f"{each.description!r} ({each.path})" for each in there) or "none"
    count = f"several {noun}s are" if fitting else f"no {noun} is"
    raise FileNotFoundError(f"{count} {wanted or 'there'!r}; there is {known}")
