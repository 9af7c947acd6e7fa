"""Whether a behavior has failed because something that it uses is not there."""

from __future__ import annotations

from collections.abc import Callable

from esair.actions import Behavior, Reaction
from esair.exceptions import (
    DeviceFaultError,
    DeviceLostError,
    DriverStuckError,
    ResourceRemovedError,
    UnknownNameError,
)

_ABSENCE = (
    DeviceFaultError,
    DeviceLostError,
    DriverStuckError,
    ResourceRemovedError,
    UnknownNameError,
)
"""What a behavior meets where a resource that it uses is not there, or not ready."""


def absent(action: Behavior | Reaction, is_ready: Callable[[str], bool]) -> list[str]:
    """Return what a behavior declares to use, and is not there or not ready."""
    if isinstance(action, Reaction):
        return []  # it is parked meanwhile, and never raises for it
    return [
        each.resource for each in action.needs.values() if not is_ready(each.provider)
    ]


def absent_for(
    error: BaseException, action: Behavior | Reaction, is_ready: Callable[[str], bool]
) -> list[str]:
    """Return what is not there, if an error may come from that."""
    if not isinstance(error, _ABSENCE):
        return []
    missing = absent(action, is_ready)
    named = error.name if isinstance(error, UnknownNameError) else error.resource
    is_there = named in {need.resource for need in action.needs.values()}
    return [] if is_there and named not in missing else missing
