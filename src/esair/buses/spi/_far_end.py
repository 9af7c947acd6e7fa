"""The far end of an SPI bus: chips in memory."""

from __future__ import annotations

import errno
from collections.abc import Mapping
from typing import Protocol

from esair.buses._failures import os_error
from esair.buses._played import PlayedWire


class SpiChip(Protocol):
    """A chip on an SPI bus."""

    def exchange(self, data: bytes) -> bytes:
        """Return as many bytes as came, for one selection of the chip."""


class SpiRegisters:
    """A chip with 128 registers of a byte: the first bit of a transfer says read.

    That is how most sensors are read: ``0x80 | register``, then a byte for each of the
    registers that follow one another; without the bit they are written.

    Args:
        content: The registers from 0 on; or values, or bytes, by register.
    """

    def __init__(self, content: bytes | Mapping[int, int | bytes] = b"") -> None:
        self.content = bytearray(128)
        given = content if isinstance(content, Mapping) else {0: content}
        for register, value in given.items():
            self._write(register, bytes([value]) if isinstance(value, int) else value)

    def exchange(self, data: bytes) -> bytes:
        """Read or write registers; what came first is answered by 0xFF."""
        register, rest = data[0] & 0x7F, data[1:]
        if not data[0] & 0x80:
            self._write(register, rest)
            return b"\xff" * len(data)
        found = (self.content[(register + n) % 128] for n in range(len(rest)))
        return bytes([0xFF, *found])

    def _write(self, register: int, data: bytes) -> None:
        for index, value in enumerate(data):
            self.content[(register + index) % 128] = value


class SpiChips(PlayedWire):
    """An SPI bus in memory.

    Args:
        chips: The chips by their chip selects. One without a chip reads as 0xFF.
    """

    def __init__(self, chips: dict[int, SpiChip]) -> None:
        super().__init__()
        self.chips = chips
        self.closed = False

    def open(self) -> SpiChips:
        """Return the link, which is this.

        Raises:
            OSError: It is unplugged.
        """
        if not self.plugged:
            raise os_error(errno.ENOENT)
        self.closed = False
        return self

    def exchange(self, chip: int, data: bytes, speed: int, mode: int) -> bytes:
        """Make a transfer."""
        self.hold()
        if not self.plugged:
            raise os_error(errno.ENODEV)
        self.fail_if_told(chip)
        if chip not in self.chips:
            return b"\xff" * len(data)
        return self.chips[chip].exchange(data)

    def close(self) -> None:
        """Let the bus go."""
        self.closed = True
