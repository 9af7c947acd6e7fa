"""Groups of processes to which the kernel gives so much memory, and no more."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

_FILES = {  # of the second version and of the first: the limit, that of swap, the kills
    "cgroup2": ("memory.max", "memory.swap.max", "memory.events"),
    "cgroup": (
        "memory.limit_in_bytes",
        "memory.memsw.limit_in_bytes",
        "memory.oom_control",
    ),
}


@contextlib.contextmanager
def cgroup_of(size: int) -> Iterator[Path]:
    """Make a group of processes that may have so many bytes; skip where that is not allowed."""
    group = None
    for kind, parent in _parents():
        group = parent / f"esair-{os.getpid()}"
        limit, swap, _ = _FILES[kind]
        try:
            group.mkdir()
            (group / limit).write_text(str(size), "ascii")
            if (group / swap).exists():
                (group / swap).write_text("0" if kind == "cgroup2" else str(size))
            break
        except OSError:  # not ours, or it hands no memory on
            _remove(group)
            group = None
    if group is None:
        pytest.skip(
            "no cgroup with a limit of memory may be made here: be root, or own one"
        )
    try:
        yield group
    finally:
        _remove(group)


def killed_in(group: Path) -> int:
    """Return how many processes of a group the kernel has killed for their memory."""
    for _, _, events in _FILES.values():
        with contextlib.suppress(OSError):
            lines = (group / events).read_text("ascii").splitlines()
            return int(dict(line.split() for line in lines)["oom_kill"])
    raise AssertionError(f"{group} does not count them")


def _parents() -> Iterator[tuple[str, Path]]:
    """Find where a group may be made: beside or above that of this process."""
    mine = {}
    for line in Path("/proc/self/cgroup").read_text("ascii").splitlines():
        _, controllers, path = line.split(":", 2)
        if not controllers or "memory" in controllers.split(","):
            mine["cgroup" if controllers else "cgroup2"] = path.lstrip("/")
    for line in Path("/proc/self/mounts").read_text("ascii").splitlines():
        _, place, kind, options, *_ = line.split()
        if kind in mine and (kind == "cgroup2" or "memory" in options.split(",")):
            here = Path(place, mine[kind])
            for parent in (here, *here.parents):
                if parent.is_relative_to(place) and parent.is_dir():
                    yield kind, parent


def _remove(group: Path) -> None:
    """Remove it, when those that were killed in it have gone."""
    end = time.monotonic() + 2.0
    while group.exists():
        try:
            group.rmdir()
        except OSError:
            if time.monotonic() > end:
                raise
            time.sleep(0.01)
