"""One thing that is plugged in: whether it may be opened, and which one is meant."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path

import attrs

from esair.buses.finding._usb import parse_identity

_GROUP_MAY = 0o060
"""The group may read and write."""


@attrs.frozen
class Device:
    """One thing that is plugged in, as far as it can be known without opening it.

    Attributes:
        kind: The medium, such as ``"serial"`` or ``"can"``; or ``"gpio"``.
        path: Where it is now: a device file, or the name of a CAN interface.
        address: What a robot.toml calls it, so that it is found again after it was
            plugged in elsewhere; the path if nothing better is known.
        description: What it says about itself, in words.
        identity: ``usb:VID:PID`` or ``usb:VID:PID:SERIAL``; None if it is no USB device.
        by_id: Its link in ``/dev/serial/by-id``; None if it has none.
        state: What is known about its state, in words, such as ``"up, 500 kbit/s"`` or
            ``"no permission: join the group dialout"``.
        bitrate: Bits per second of a CAN interface; None if it is not known.
        lines: How many lines a GPIO chip has; None if it is not known.
    """

    kind: str
    path: str
    address: str
    description: str = ""
    identity: str | None = None
    by_id: str | None = None
    state: str = ""
    bitrate: int | None = None
    lines: int | None = None

    @property
    def key(self) -> tuple[str, str, str | None]:
        """What tells it from another device, and from itself elsewhere."""
        return self.kind, self.path, self.identity


def quoted(text: str) -> str:
    """Return a text as TOML writes it."""
    return json.dumps(text, ensure_ascii=False)


def permission(file: Path) -> str:
    """Return in words that this user may not open a device file; empty if he may."""
    if os.access(file, os.R_OK | os.W_OK):
        return ""
    try:
        state = file.stat()
    except OSError:  # it is just being unplugged
        return ""
    return who_may(state.st_mode, state.st_gid)


def who_may(mode: int, group: int) -> str:
    """Return in words who may open it, by its mode and its group's number."""
    if mode & _GROUP_MAY != _GROUP_MAY or group == 0:
        return "no permission"
    return f"no permission: join the group {_name(group)}"


def _name(group: int) -> str:
    try:
        import grp

        return grp.getgrgid(group).gr_name
    except (ImportError, KeyError):  # another system, or a group without a name
        return str(group)


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
