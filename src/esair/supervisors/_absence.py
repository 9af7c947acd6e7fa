"""Which errors say that something is not there (yet), rather than that it is broken."""

from __future__ import annotations

import errno
from collections.abc import Callable

from esair.actions import Behavior, Reaction
from esair.exceptions import (
    DeviceFaultError,
    DeviceLostError,
    DriverStuckError,
    EsairError,
    ResourceRemovedError,
    UnknownNameError,
)

_SILENT = frozenset({errno.EREMOTEIO, errno.ENXIO, errno.ETIMEDOUT, errno.EHOSTDOWN})
"""What the system says of a part that does not answer: nobody acknowledges, say."""


class AnotherDeviceError(DeviceFaultError):
    """Where the device was is another one now; waiting for the right one may help."""


def is_silence(error: BaseException) -> bool:
    """Tell whether a device has said nothing, or is not the right one: no wrong answer.

    It has no power yet, or it is still starting: it is waited for, for ever.
    """
    if isinstance(error, TimeoutError | AnotherDeviceError):
        return True
    chain: list[BaseException] = []
    cause: BaseException | None = error
    while cause is not None and all(each is not cause for each in chain):
        if isinstance(cause, OSError) and cause.errno in _SILENT:
            return True
        chain.append(cause)
        cause = cause.__cause__  # a driver may have made a circle of them
    return False


def is_absence(error: BaseException | None) -> bool:
    """Tell whether a device could not be opened because it cannot be had now.

    It is in use, its node has other rights, or nobody answers yet: the operating
    system says all of this by an OSError, and waiting may help. A fault that the device
    itself shows has no ``errno``.
    """
    return isinstance(error, OSError) and (
        error.errno is not None or not isinstance(error, EsairError)
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
    if isinstance(error, BaseExceptionGroup):  # of a behavior with tasks of its own
        each_misses = [absent_for(each, action, is_ready) for each in error.exceptions]
        return each_misses[0] if all(each_misses) else []
    if not isinstance(error, _ABSENCE):
        return []
    missing = absent(action, is_ready)
    named = error.name if isinstance(error, UnknownNameError) else error.resource
    is_there = named in {need.resource for need in action.needs.values()}
    return [] if is_there and named not in missing else missing
