"""Why a port cannot be opened, and who has it. Looks into ``/proc``; blocks."""

from __future__ import annotations

import contextlib
import errno
import os
import stat
from pathlib import Path

from esair.exceptions import describe

_TAKEN = frozenset({errno.EAGAIN, errno.EBUSY})
"""What the kernel says about a port that somebody else has."""


def explain(path: str, error: BaseException) -> str:
    """Say why a port cannot be opened, and whose it is if somebody has it."""
    code = getattr(error, "errno", None)
    if code in _TAKEN:
        return f"{path} belongs to {_owner(path)}: a port has one user"
    if code == errno.EACCES:
        with contextlib.suppress(OSError, KeyError):
            return f"{path} may be opened by the group {Path(path).group()!r} only"
    why = os.strerror(code) if isinstance(code, int) else describe(error)
    return f"{path} cannot be opened: {why}"


def _owner(path: str) -> str:
    """Name the process that has a port open, as far as this user may know."""
    try:
        wanted = os.stat(path)
    except OSError:
        return "somebody else"
    pid = _lock_holder(wanted) or _opener(wanted)
    if pid is None:
        return "another process"
    if pid == os.getpid():
        return f"this process ({pid}) already"
    with contextlib.suppress(OSError):
        return f"process {pid} ({Path(f'/proc/{pid}/comm').read_text().strip()})"
    return f"process {pid}"


def _lock_holder(wanted: os.stat_result) -> int | None:
    node = (
        f"{os.major(wanted.st_dev):02x}:{os.minor(wanted.st_dev):02x}:{wanted.st_ino}"
    )
    # A line: number, FLOCK, ADVISORY, WRITE, pid, device and inode, 0, EOF.
    with contextlib.suppress(OSError):
        for line in Path("/proc/locks").read_text().splitlines():
            fields = line.split()
            if fields[1] == "FLOCK" and fields[5] == node and int(fields[4]) > 0:
                return int(fields[4])
    return None


def _opener(wanted: os.stat_result) -> int | None:
    for link in Path("/proc").glob("[0-9]*/fd/*"):
        with contextlib.suppress(OSError):  # another user's, or closed meanwhile
            found = link.stat()
            if found.st_rdev == wanted.st_rdev and stat.S_ISCHR(found.st_mode):
                return int(link.parts[2])
    return None
