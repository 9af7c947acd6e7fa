"""Values as short texts, whatever they are and however large."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sized
from typing import Any

from esair.recording import fields_of

TEXT = 120  # How long the text of a value may be; what is longer is cut
PARTS = 6  # How many parts of a list or table are shown
NUMBERS = 4  # How many numbers of a value are told, to be drawn over time


def numbers_of(value: Any) -> dict[str, float]:
    """Return the first finite numbers in a value by the names of their fields."""
    fields = {"": value} if isinstance(value, float | int) else fields_of(value)
    found = {}
    for name, part in (fields or {}).items():
        if isinstance(part, float | int) and math.isfinite(part):
            found[name] = float(part)
        if len(found) == NUMBERS:
            break
    return found


def short(value: Any, room: int = TEXT) -> str:
    """Return a value as a text of one line; what lies in it is somebody else's.

    It costs little for a value of any size.
    """
    try:
        text = _text(value, 4)
    except Exception as error:  # somebody's __repr__ or __len__
        text = f"<{type(value).__name__}: {type(error).__name__}>"
    return text if len(text) <= room else text[: room - 1] + "…"


def _text(value: Any, depth: int) -> str:
    if value is None:
        return ""
    if isinstance(value, float):
        return f"{value:.4g}" if math.isfinite(value) else str(float(value))
    if isinstance(value, str | bytes | bytearray):
        return repr(value[:TEXT])
    fields = fields_of(value)
    if depth and fields is not None:
        inside = ", ".join(
            f"{name}={_text(part, depth - 1)}" for name, part in fields.items()
        )
        return f"{type(value).__name__}({inside})"
    if hasattr(value, "__array_interface__"):
        return f"{value.dtype} array of {' x '.join(map(str, value.shape))}"
    if depth and isinstance(value, list | tuple | dict | set | frozenset):
        return _parts(value, depth)
    return "…" if isinstance(value, Sized) else repr(value)


def _parts(value: Any, depth: int) -> str:
    found = []
    for place, part in enumerate(value):
        if place == PARTS:
            found.append(f"… {len(value) - PARTS} more")
            break
        shown = _text(part, depth - 1)
        if isinstance(value, Mapping):
            shown = f"{shown}: {_text(value[part], depth - 1)}"
        found.append(shown)
    return ", ".join(found).join("[]" if isinstance(value, list | tuple) else "{}")
