"""An I²C bus of chips in memory, behind the methods of smbus2, and the fake that has one."""

from __future__ import annotations

import errno
import threading
from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import attrs

from esair.buses._fakes import ChipsWire, PlayedBus, os_error
from esair.buses.i2c._bus import I2CBus
from esair.buses.i2c._kernel import RegisterLink

FUNCS = 0x0EFF0001
"""What `ChipBus` can do: plain I²C, and SMBus by it; as the kernel's bits."""


class Chip(Protocol):
    """A chip on an I²C bus: registers.

    A chip whose pointer stays where it is when it is read has ``keeps_pointer = True``.
    """

    def read(self, register: int, length: int) -> bytes:
        """Return registers."""

    def write(self, register: int, data: bytes) -> None:
        """Set registers."""


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
        self.content: bytearray = bytearray(self.size)
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


class ChipBus(ChipsWire):
    """An I²C bus with simulated chips, behind the methods of ``smbus2.SMBus``.

    Args:
        chips: The chips by their addresses. An address without one does not answer.

    Attributes:
        silent: The addresses of chips that acknowledge nothing.
    """

    def __init__(self, chips: dict[int, Chip]) -> None:
        super().__init__(chips)
        self.funcs = FUNCS
        self.silent: set[int] = set()
        self._pointers: dict[int, int] = {}

    def read_byte_data(self, i2c_addr: int, register: int) -> int:
        """Read one register."""
        return self._exchange(i2c_addr, bytes([register]), 1)[0]

    def write_byte_data(self, i2c_addr: int, register: int, value: int) -> None:
        """Write one register."""
        self._exchange(i2c_addr, bytes([register, value]), 0)

    def read_i2c_block_data(
        self, i2c_addr: int, register: int, length: int
    ) -> list[int]:
        """Read up to 32 registers in one transfer."""
        return list(self._exchange(i2c_addr, bytes([register]), min(length, 32)))

    def write_i2c_block_data(
        self, i2c_addr: int, register: int, data: Sequence[int]
    ) -> None:
        """Write up to 32 registers in one transfer."""
        self._exchange(i2c_addr, bytes([register, *data[:32]]), 0)

    def read_byte(self, i2c_addr: int) -> int:
        """Read a byte from where the chip's pointer is."""
        return self._exchange(i2c_addr, b"", 1)[0]

    def write_byte(self, i2c_addr: int, value: int) -> None:
        """Set the chip's pointer."""
        self._exchange(i2c_addr, bytes([value]), 0)

    def write_quick(self, i2c_addr: int) -> None:
        """Find out whether a chip answers."""
        self._exchange(i2c_addr, b"", 0)

    def i2c_rdwr(self, *messages: Any) -> None:
        """Make ``smbus2.i2c_msg`` transfers, a write and the read after it as one."""
        waiting: Any = None
        for message in messages:
            reads, before = message.flags & 1, b""
            if reads and waiting is not None and waiting.addr == message.addr:
                before, waiting = bytes(waiting), None
            if waiting is not None:
                self._exchange(waiting.addr, bytes(waiting), 0)
            waiting = None if reads else message
            if reads:
                data = self._exchange(message.addr, before, message.len)
                for index, value in enumerate(data):
                    message.buf[index] = value
        if waiting is not None:
            self._exchange(waiting.addr, bytes(waiting), 0)

    def _exchange(self, address: int, write: bytes, read: int) -> bytes:
        """Make a transfer: write some bytes, then read some; every one comes here."""
        chip = self._chip(address)
        if write:
            self._pointers[address] = write[0]
        if len(write) > 1:
            chip.write(write[0], write[1:])
            if not getattr(chip, "keeps_pointer", False):
                self._pointers[address] = (write[0] + len(write) - 1) % 256
        if not read:
            return b""
        pointer = self._pointers.get(address, 0)
        data = chip.read(pointer, read)
        if not getattr(chip, "keeps_pointer", False):
            self._pointers[address] = (pointer + read) % 256
        return data

    def _chip(self, address: int) -> Chip:
        self.check(address)
        if address not in self.chips or address in self.silent or not self.powered:
            raise os_error(errno.ENXIO)
        found: Chip = self.chips[address]
        return found


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


class FakeLink(ChipBus):
    """The far end of a `FakeI2c`, in two steps as the kernel: select, then transfer.

    Used by two threads at once it reaches the wrong chip, as the kernel does.
    """

    def __init__(self, chips: dict[int, Chip]) -> None:
        super().__init__(chips)
        self.selected: int = 0
        self._one_at_a_time = threading.Lock()

    def _exchange(self, address: int, write: bytes, read: int) -> bytes:
        self.selected = address
        self.hold()
        if not self.virtual:  # where the loop and a driver's thread may both be here
            address = self.selected
        with self._one_at_a_time:
            data = super()._exchange(address, write, read)
            self.log.append(Transfer(address, write, data))
        return data


class FakeI2c(PlayedBus[RegisterLink, Chip, Transfer], I2CBus):
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

    _wire_of = FakeLink
    _registers = Registers
    _medium = "i2c"

    def silent(self, address: int, *, silent: bool = True) -> None:
        """Let a chip acknowledge nothing, or answer again."""
        (self.link.silent.add if silent else self.link.silent.discard)(address)
