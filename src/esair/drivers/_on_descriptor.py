"""What comes by a descriptor of the kernel, as an inbox."""

from __future__ import annotations

import asyncio
import contextlib
import os
from collections.abc import Callable, Iterable, Iterator
from typing import TypeVar

from esair.buses import Inbox

T = TypeVar("T")


class FakeDescriptor:
    """A descriptor of a fake, that becomes readable when it is told to."""

    def __init__(self) -> None:
        self._event = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)

    def fileno(self) -> int:
        """Return the descriptor; -1 once it is closed."""
        return self._event

    def wake(self) -> None:
        """Be readable."""
        if self._event >= 0:
            os.eventfd_write(self._event, 1)

    def close(self) -> None:
        """Let the descriptor go."""
        if self._event >= 0:
            os.close(self._event)
            self._event = -1


@contextlib.contextmanager
def arrivals(
    fileno: int, take: Callable[[], Iterable[T]], *, limit: int = 64
) -> Iterator[tuple[int, Inbox[T]]]:
    """Offer what can be taken whenever a descriptor is readable; an error ends it.

    A duplicate is watched, and given: the device is closed on another thread.
    """
    loop = asyncio.get_running_loop()
    descriptor = os.dup(fileno)
    inbox: Inbox[T] = Inbox(limit)

    def readable() -> None:
        try:
            inbox.extend(tuple(take()))
        except Exception as error:
            loop.remove_reader(descriptor)
            inbox.fail(error)

    loop.add_reader(descriptor, readable)
    try:
        yield descriptor, inbox
    finally:
        loop.remove_reader(descriptor)
        os.close(descriptor)
        inbox.close()
