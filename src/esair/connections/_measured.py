"""When a value was measured, if the driver knows it."""

from __future__ import annotations

import math
from typing import Any

from esair.messages import Stamped

AHEAD = 0.01
"""How far in the future a device may say that it has measured, in seconds."""


def measured_at(stamped: Stamped[Any], now: float) -> float | str:
    """Return when a value was measured, or say what is wrong with its stamp."""
    try:
        at = now - stamped.age if stamped.time is None else stamped.time
        if math.isfinite(at) and at <= now + AHEAD:
            return min(at, now)
    except TypeError:
        pass
    return f"expected a time of measurement until now ({now:.3f} s), it gave {stamped!r:.120}"
