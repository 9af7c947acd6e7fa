"""The bell: how threads wake an event loop."""

from __future__ import annotations

import contextlib
import os
import threading
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from esair.loop._turn import Turn


class Bell:
    """Has a loop come to the border of its turns when a thread rings.

    While it is held it is an eventfd, which costs the loop a third of its own way: that
    reads its socket until an exception says that there is no more.
    """

    def __init__(self, turn: Turn) -> None:
        self._turn = turn
        self._loop = turn.loop
        self._lock = threading.Lock()
        self._holders = 0
        self._fd = -1

    def ring(self) -> None:
        """Have the loop come, from any thread.

        Raises:
            RuntimeError: The loop is closed.
        """
        with self._lock:  # a number that was closed may be another file's
            if self._fd >= 0 and not self._loop.is_closed():
                os.eventfd_write(self._fd, 1)
                return
        self._turn.ring()

    def hold(self) -> None:
        """Be quick for a thread that will ring; called in the loop."""
        self._holders += 1
        if self._fd >= 0 or self._turn.virtual:
            return
        with contextlib.suppress(OSError, NotImplementedError, AttributeError):
            fd = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
            try:
                self._loop.add_reader(fd, self._heard)
            except BaseException:
                os.close(fd)
                raise
            self._fd = fd

    def let_go(self) -> None:
        """It may still ring, but not for long; called in the loop."""
        self._holders -= 1
        if self._holders or self._fd < 0:
            return
        if not self._loop.is_closed():
            self._loop.remove_reader(self._fd)
            self._loop.call_soon(self._turn.come)  # it may have been rung just now
        self._close()

    def _close(self) -> None:
        with self._lock:
            fd, self._fd = self._fd, -1
        if fd >= 0:
            os.close(fd)

    __del__ = _close  # with a loop that was closed while it was held

    def _heard(self) -> None:
        os.eventfd_read(self._fd)
        self._turn.come()
