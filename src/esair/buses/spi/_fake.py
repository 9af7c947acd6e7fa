"""A fake SPI bus: chips in memory, and what goes wrong with real ones."""

from __future__ import annotations

from typing import Protocol

import attrs

from esair.buses._fakes import ChipsWire, PlayedBus
from esair.buses.i2c import Registers
from esair.buses.spi._bus import SpiBus
from esair.buses.spi._kernel import SpiLink


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


@attrs.frozen
class Exchange:
    """One transfer.

    Attributes:
        chip: The chip select.
        sent: What the robot sent.
        received: What came back.
        speed: Bits per second.
        mode: Polarity and phase of the clock.
    """

    chip: int
    sent: bytes
    received: bytes
    speed: int
    mode: int


class SpiChips(ChipsWire):
    """An SPI bus in memory.

    Args:
        chips: The chips by their chip selects. One without a chip reads as 0xFF.
    """

    def exchange(self, chip: int, data: bytes, speed: int, mode: int) -> bytes:
        """Make a transfer."""
        self.hold()
        self.check(chip)
        back = b"\xff" * len(data)
        if chip in self.chips and self.powered:
            back = self.chips[chip].exchange(data)
        self.log.append(Exchange(chip, data, back, speed, mode))
        return back


class FakeSpi(PlayedBus[SpiLink, SpiChip, Exchange], SpiBus):
    r"""An SPI bus with chips in memory that does what its test tells it.

    Args:
        name: The name of the bus.
        chips: The chips by their chip selects: objects with ``exchange(data)``, or
            plain registers, as bytes or by their numbers (see `SpiRegisters`).
        timeout: How long a transfer may take, in seconds.

    Example:
        >>> bus = FakeSpi(chips={0: {0x0F: 0x33}})
        >>> bus.stretch(0.01)
    """

    _wire_of = SpiChips
    _registers = SpiRegisters
    _medium = "spi"
