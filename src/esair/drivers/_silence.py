"""Parts that speak by themselves, and are lost when they do not."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator
from typing import TypeVar

from esair.buses import Inbox
from esair.exceptions import DeviceLostError
from esair.resources import Resource

T = TypeVar("T")


async def heard(
    device: Resource, inbox: Inbox[T], silent_after: float | None
) -> AsyncIterator[T]:
    """Yield what comes.

    Args:
        device: The device that listens.
        inbox: What it hears.
        silent_after: After how many seconds without anything its part is lost; it may
            be silent for ever if None.

    Raises:
        DeviceLostError: Nothing came for so long.
    """
    while True:
        try:
            yield await inbox.take(timeout=silent_after)
        except StopAsyncIteration:
            return
        except TimeoutError:
            raise DeviceLostError(
                device.name, f"nothing came for {silent_after:g} s"
            ) from None


async def hear_first(
    device: Resource, inbox: Inbox[T], silent_after: float | None
) -> None:
    """Wait for a sign of life, if there has to be one; args and errors as for `heard`."""
    with contextlib.closing(inbox):
        if silent_after is not None:
            async for _ in heard(device, inbox, silent_after):
                return
