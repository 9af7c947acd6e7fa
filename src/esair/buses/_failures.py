"""What fakes are told to fail with, and for how long."""

from __future__ import annotations

import errno
import os
from collections.abc import Hashable
from typing import Any, Self

import attrs

from esair.buses._bus import Wire


def os_error(code: int) -> OSError:
    """Return the error of an error number, in the kernel's words."""
    return OSError(code, os.strerror(code))


@attrs.define
class _Failure:
    error: BaseException
    after: int
    times: int | None
    about: Hashable | None


class Failures:
    """Calls that fail as a test says, in the order in which it was told."""

    def __init__(self) -> None:
        self._all: list[_Failure] = []

    def add(
        self,
        error: BaseException,
        after: int = 0,
        times: int | None = 1,
        about: Hashable | None = None,
    ) -> None:
        """Fail so many calls, or all if None, after some; those about one thing only."""
        self._all.append(_Failure(error, after, times, about))

    def clear(self) -> None:
        """Let all calls go well from now on."""
        self._all.clear()

    def due(self, about: Hashable | None = None) -> BaseException | None:
        """Return what the next call fails with, which counts as that call."""
        for failure in self._all:
            if failure.about not in {None, about}:
                continue
            if failure.after > 0:
                failure.after -= 1
                continue
            if failure.times is not None:
                failure.times -= 1
                if failure.times <= 0:
                    self._all.remove(failure)
            return failure.error
        return None

    def check(self, about: Hashable | None = None) -> None:
        """Raise what the next call fails with."""
        error = self.due(about)
        if error is not None:
            raise error


class MemoryWire(Wire):
    """A bus of chips in memory, which is its own link.

    Args:
        chips: The chips by their addresses, or by their chip selects.
    """

    def __init__(self, chips: dict[int, Any]) -> None:
        super().__init__()
        self.chips = chips
        self.plugged: bool = True
        self.closed: bool = False

    def open(self) -> Self:
        """Return the link, which is this.

        Raises:
            OSError: It is unplugged.
        """
        if not self.plugged:
            raise os_error(errno.ENOENT)
        self.closed = False
        return self

    def unplug(self) -> None:
        """Take the adapter away; who used it notices at the next transfer."""
        self.plugged = False

    def plug(self) -> None:
        """Bring it back; nothing happens if it is there."""
        if not self.plugged:
            self.plugged = True
            self._tell_plugged()

    def close(self) -> None:
        """Let the bus go."""
        self.closed = True
