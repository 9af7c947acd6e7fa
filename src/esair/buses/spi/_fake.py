"""A fake SPI bus: chips in memory, and what goes wrong with real ones."""

from __future__ import annotations

from collections.abc import Mapping

import attrs

from esair.buses._played import PlayedBus
from esair.buses.spi._bus import SpiBus
from esair.buses.spi._far_end import SpiChip, SpiChips, SpiRegisters
from esair.buses.spi._kernel import SpiLink


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


class _Logged(SpiChips):
    def exchange(self, chip: int, data: bytes, speed: int, mode: int) -> bytes:
        back = super().exchange(chip, data, speed, mode)
        self.log.append(Exchange(chip, data, back, speed, mode))
        return back


class FakeSpi(PlayedBus[SpiLink], SpiBus):
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

    link: _Logged

    def __init__(
        self,
        name: str = "spi",
        chips: Mapping[int, SpiChip | bytes | Mapping[int, int | bytes]] | None = None,
        *,
        timeout: float = 0.2,
    ) -> None:
        super().__init__(name, _Logged, SpiRegisters, chips, timeout=timeout)

    @property
    def chips(self) -> dict[int, SpiChip]:
        """The chips on the bus; put in and take out at any time."""
        return self.link.chips

    @property
    def log(self) -> list[Exchange]:
        """The newest transfers, the oldest of them first."""
        return list(self.link.log)
