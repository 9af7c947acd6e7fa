"""The far end of an I²C bus: chips in memory behind the methods of smbus2."""

from __future__ import annotations

import errno
import os
from collections.abc import Sequence
from typing import Protocol


class Chip(Protocol):
    """A chip on an I²C bus: registers."""

    def read(self, register: int, length: int) -> bytes:
        """Return registers."""

    def write(self, register: int, data: bytes) -> None:
        """Set registers."""


class ChipBus:
    """An I²C bus with simulated chips, behind the methods of ``smbus2.SMBus``.

    Args:
        chips: The chips by their addresses. An address without one does not answer.
    """

    def __init__(self, chips: dict[int, Chip]) -> None:
        self.chips = chips
        self.plugged = True
        self.closed = False

    def read_byte_data(self, i2c_addr: int, register: int) -> int:
        """Read one register."""
        return self._chip(i2c_addr).read(register, 1)[0]

    def write_byte_data(self, i2c_addr: int, register: int, value: int) -> None:
        """Write one register."""
        self._chip(i2c_addr).write(register, bytes([value]))

    def read_i2c_block_data(
        self, i2c_addr: int, register: int, length: int
    ) -> list[int]:
        """Read up to 32 registers in one transfer."""
        return list(self._chip(i2c_addr).read(register, min(length, 32)))

    def write_i2c_block_data(
        self, i2c_addr: int, register: int, data: Sequence[int]
    ) -> None:
        """Write up to 32 registers in one transfer."""
        self._chip(i2c_addr).write(register, bytes(data[:32]))

    def close(self) -> None:
        """Let the bus go."""
        self.closed = True

    def _chip(self, address: int) -> Chip:
        if not self.plugged:
            raise OSError(errno.ENODEV, os.strerror(errno.ENODEV))
        if address not in self.chips:
            raise OSError(errno.ENXIO, os.strerror(errno.ENXIO))
        return self.chips[address]
