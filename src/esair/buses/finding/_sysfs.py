"""Reading ``/sys``: short texts that a device may have written, or may be gone."""

from __future__ import annotations

from pathlib import Path

ROOT = Path("/")
"""Where ``/sys`` and ``/dev`` are."""

LONGEST = 120
"""How much of a text is taken, in characters."""


def read(path: Path) -> str:
    """Return a text in one line without control characters; empty if there is none.

    A device chooses its own strings; none of them may move the cursor of a terminal.
    """
    try:
        text = path.read_bytes().decode("utf-8", errors="replace").strip()
    except OSError:
        return ""
    return "".join(
        each if each.isprintable() and each != "\N{REPLACEMENT CHARACTER}" else "?"
        for each in text[:LONGEST]
    )


def entries(directory: Path) -> list[Path]:
    """Return what a directory has, by name and number; nothing if it is not there."""
    try:
        found = list(directory.iterdir())
    except OSError:
        return []
    return sorted(found, key=natural)


def natural(path: Path) -> tuple[str, int]:
    """Return a key that sorts ttyUSB10 behind ttyUSB9."""
    letters = path.name.rstrip("0123456789")
    return letters, int(path.name[len(letters) :] or -1)
