"""A fake I²C bus: chips in memory, and everything that goes wrong with real ones."""

from __future__ import annotations

import errno
import threading
from collections.abc import Mapping

import attrs

from esair.buses._failures import os_error
from esair.buses._played import PlayedBus, PlayedWire
from esair.buses.i2c._bus import I2CBus
from esair.buses.i2c._far_end import Chip, ChipBus, Registers
from esair.buses.i2c._link import RegisterLink


@attrs.frozen
class Transfer:
    """One transfer that a chip answered.

    Attributes:
        address: The address of the chip.
        written: What was written; the register comes first.
        read: What the chip gave then.
    """

    address: int
    written: bytes
    read: bytes


class FakeLink(PlayedWire, ChipBus):
    """The far end of a `FakeI2c`, in two steps as the kernel: select, then transfer.

    Used by two threads at once it reaches the wrong chip, as the kernel does.
    """

    def __init__(self, chips: dict[int, Chip]) -> None:
        super().__init__(chips)
        self.selected: int = 0
        self.silent: set[int] = set()
        self._one_at_a_time = threading.Lock()

    def _exchange(self, address: int, write: bytes, read: int) -> bytes:
        self.selected = address
        self.hold()
        if not self.virtual:  # where the loop and a driver's thread may both be here
            address = self.selected
        with self._one_at_a_time:
            self.fail_if_told(address)
            data = super()._exchange(address, write, read)
            self.log.append(Transfer(address, write, data))
        return data

    def _chip(self, address: int) -> Chip:
        chip = super()._chip(address)
        if address in self.silent or not self.powered:
            raise os_error(errno.ENXIO)
        return chip


class FakeI2c(PlayedBus[RegisterLink], I2CBus):
    r"""An I²C bus with chips in memory that does what its test tells it.

    On a virtual clock it runs in the event loop, else on its thread as a real bus; it
    is driven by the same code as a real one either way.

    Args:
        name: The name of the bus.
        chips: The chips by their addresses: objects with ``read(register, length)``
            and ``write(register, data)``, such as
            `esair.drivers.bme280.fake.FakeBme280`; or plain registers, as bytes or by
            their numbers.
        timeout: How long a transfer may take, in seconds.

    Example:
        >>> bus = FakeI2c(chips={0x48: {0x00: b"\x19\x00"}})
        >>> bus.fail(errno.EIO, after=2)
    """

    link: FakeLink

    def __init__(
        self,
        name: str = "i2c",
        chips: Mapping[int, Chip | bytes | Mapping[int, int | bytes]] | None = None,
        *,
        timeout: float = 0.2,
    ) -> None:
        super().__init__(name, FakeLink, Registers, chips, timeout=timeout)

    @property
    def chips(self) -> dict[int, Chip]:
        """The chips on the bus by their addresses; put in and take out at any time."""
        return self.link.chips

    @property
    def log(self) -> list[Transfer]:
        """The newest transfers that a chip answered, the oldest of them first."""
        return list(self.link.log)

    def silent(self, address: int, *, silent: bool = True) -> None:
        """Let a chip acknowledge nothing, or answer again."""
        (self.link.silent.add if silent else self.link.silent.discard)(address)
