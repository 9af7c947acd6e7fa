"""Whether a device file may be opened by whoever asks."""

from __future__ import annotations

import os
from pathlib import Path

_GROUP_MAY = 0o060
"""The group may read and write."""


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
