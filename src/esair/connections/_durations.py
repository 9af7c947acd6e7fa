"""The check of a number of seconds that somebody hands to a connection."""

from __future__ import annotations

from typing import cast

from esair.exceptions import BadValueError
from esair.messages import is_positive


def check_duration(component: str, field: str, value: object) -> float:
    """Return a positive, finite number of seconds.

    Raises:
        BadValueError: It is something else.
    """
    if is_positive(value):
        return cast("float", value)
    raise BadValueError(component, field, f"expected seconds > 0, not {value!r:.80}")
