"""What the far ends of I²C and SPI have in common: chips in memory, and registers."""

from __future__ import annotations

import errno
from collections.abc import Mapping
from typing import Any, Self

from esair.buses._bus import Wire
from esair.buses._failures import os_error

Content = bytes | Mapping[int, int | bytes]


class Registers:
    """A chip that is nothing but 256 registers of a byte; they wrap around.

    One that does something when it is told sets its own `set`; one that is always the
    same after power-up says so in ``power_up``.

    Args:
        content: The registers from 0 on; or values, or bytes, by register.

    Attributes:
        content: All registers, as they are.
    """

    size = 256
    power_up: Content = b""

    def __init__(self, content: Content = b"") -> None:
        self.content = bytearray(self.size)
        self.fill(self.power_up)
        self.fill(content)
        self._at_start = bytes(self.content)

    def power_cycle(self) -> None:
        """Lose the power for a moment: it is as it was at the beginning."""
        self.content[:] = self._at_start

    def fill(self, content: Content) -> None:
        """Have something in registers that nobody has told the chip."""
        given = content if isinstance(content, Mapping) else {0: content}
        for register, value in given.items():
            for index, byte in enumerate([value] if isinstance(value, int) else value):
                self.content[(register + index) % self.size] = byte

    def read(self, register: int, length: int) -> bytes:
        """Return registers that follow one another."""
        content = bytes(self.content)  # one moment, whoever writes meanwhile
        return bytes(content[place] for place in self.places(register, length))

    def write(self, register: int, data: bytes) -> None:
        """Set registers that follow one another."""
        for place, value in zip(self.places(register, len(data)), data, strict=True):
            self.set(place, value)

    def places(self, register: int, length: int) -> list[int]:
        """Return which registers a transfer goes to, one after the other."""
        return [(register + index) % self.size for index in range(length)]

    def set(self, register: int, value: int) -> None:
        """Set one register."""
        self.content[register] = value


class MemoryWire(Wire):
    """A bus of chips in memory, which is its own link.

    Args:
        chips: The chips by their addresses, or by their chip selects.
    """

    def __init__(self, chips: dict[int, Any]) -> None:
        super().__init__()
        self.chips = chips
        self.plugged = True
        self.closed = False

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
