"""The check of a number of seconds that somebody hands to a connection."""

from __future__ import annotations

import math
from typing import cast

from esair.exceptions import BadValueError


def check_duration(component: str, field: str, value: object) -> float:
    """Return a positive, finite number of seconds.

    Raises:
        BadValueError: It is something else.
    """
    if type(value) in {int, float} and 0 < cast("float", value) < math.inf:
        return cast("float", value)
    raise BadValueError(component, field, f"expected seconds > 0, not {value!r:.80}")
