"""What the far ends of I²C and SPI have in common: a bus of chips in memory."""

from __future__ import annotations

import errno
from typing import Any, Self

from esair.buses._bus import Wire
from esair.buses._failures import os_error


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
