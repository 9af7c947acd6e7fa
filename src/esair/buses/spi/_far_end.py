"""The far end of an SPI bus: chips in memory."""

from __future__ import annotations

import errno
from typing import Protocol

from esair.buses._failures import os_error
from esair.buses._played import PlayedWire
from esair.buses.i2c import Registers


class SpiChip(Protocol):
    """A chip on an SPI bus."""

    def exchange(self, data: bytes) -> bytes:
        """Return as many bytes as came, for one selection of the chip."""


class SpiRegisters(Registers):
    """A chip with 128 registers of a byte: the first bit of a transfer says read.

    That is how most sensors are read: ``0x80 | register``, then a byte for each of the
    registers that follow one another; without the bit they are written.

    Args:
        content: The registers from 0 on; or values, or bytes, by register.
    """

    size = 128

    def exchange(self, data: bytes) -> bytes:
        """Read or write registers; what came first is answered by 0xFF."""
        register, rest = data[0] & 0x7F, data[1:]
        if not data[0] & 0x80:
            self.write(register, rest)
            return b"\xff" * len(data)
        return b"\xff" + self.read(register, len(rest))


class SpiChips(PlayedWire):
    """An SPI bus in memory.

    Args:
        chips: The chips by their chip selects. One without a chip reads as 0xFF.
    """

    def __init__(self, chips: dict[int, SpiChip]) -> None:
        super().__init__(chips)

    def exchange(self, chip: int, data: bytes, speed: int, mode: int) -> bytes:
        """Make a transfer."""
        self.hold()
        if not self.plugged:
            raise os_error(errno.ENODEV)
        self.fail_if_told(chip)
        if chip not in self.chips or not self.powered:
            return b"\xff" * len(data)
        back: bytes = self.chips[chip].exchange(data)
        return back
