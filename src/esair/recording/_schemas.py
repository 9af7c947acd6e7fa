"""Kinds of values that viewers know: how they are written so that they can be seen."""

from __future__ import annotations

import functools
import math
from typing import Any

LEVELS = {"debug": 1, "info": 2, "warning": 3, "error": 4, "critical": 5}


def known(value: Any, seconds: float) -> tuple[str, dict[str, Any]] | None:
    """Return the name of a viewer's schema with the value's fields in it.

    It goes by what a value has: a place on earth, a turn of a laser, a picture. None
    if it is of no kind that viewers know.
    """
    kind: object = type(value)
    form = _form(kind)
    if form is None:
        return None
    stamp = {"sec": int(seconds), "nsec": int(seconds % 1 * 1e9)}
    if form == "place":
        return "foxglove.LocationFix", {
            "timestamp": stamp,
            "frame_id": "earth",
            "latitude": value.latitude_deg,
            "longitude": value.longitude_deg,
            "altitude": getattr(value, "altitude", None) or 0.0,
        }
    if form == "scan" and len(value.angles) > 1:
        order = sorted(range(len(value.angles)), key=value.angles.__getitem__)
        return "foxglove.LaserScan", {
            "timestamp": stamp,
            "frame_id": "laser",
            "start_angle": value.angles[order[0]],
            "end_angle": value.angles[order[-1]],
            "ranges": [min(value.ranges[place], 1e6) for place in order],
            "intensities": [],
        }
    if form == "pose":
        half = value.heading / 2
        return "foxglove.PoseInFrame", {
            "timestamp": stamp,
            "frame_id": "world",
            "pose": {
                "position": {"x": value.x, "y": value.y, "z": 0.0},
                "orientation": {
                    "x": 0,
                    "y": 0,
                    "z": math.sin(half),
                    "w": math.cos(half),
                },
            },
        }
    return None


_FORMS = {
    "place": ("latitude_deg", "longitude_deg"),
    "scan": ("angles", "ranges"),
    "pose": ("x", "y", "heading"),
}
"""What the values of a class have of which viewers know what it is."""


@functools.lru_cache(maxsize=1024)
def _form(kind: Any) -> str | None:
    has = (f for f, names in _FORMS.items() if all(hasattr(kind, n) for n in names))
    return next(has, None)


def log_line(name: str, level: str, text: str, seconds: float) -> dict[str, Any]:
    """Return a line of the log as viewers know it (``foxglove.Log``)."""
    return {
        "timestamp": {"sec": int(seconds), "nsec": int(seconds % 1 * 1e9)},
        "level": LEVELS.get(level, 0),
        "message": text,
        "name": name,
        "file": "",
        "line": 0,
    }
