"""I²C buses: registers and transfers of the chips on one pair of wires."""

from __future__ import annotations

import errno
import time
from collections.abc import Callable, Hashable, Iterable
from pathlib import Path
from typing import TypeVar

from esair.buses._bus import Wire
from esair.buses._link_bus import GONE, LinkBus
from esair.buses.i2c import _kernel as kernel
from esair.buses.i2c._kernel import RegisterLink
from esair.exceptions import (
    BadValueError,
    DeviceFaultError,
    EsairError,
    describe,
)
from esair.values import check_bytes, check_whole, is_whole
from esair.watchdog import Outlet

SILENT = frozenset({errno.ENXIO, errno.EREMOTEIO})
"""Nobody acknowledged."""

OCCUPIED = frozenset({errno.EAGAIN, errno.EBUSY})
"""Another master had the bus: the transfer was not made."""

ITS_CHIP = SILENT | OCCUPIED
"""What is said of a chip, or of another master, while the adapter is well."""

GOING_TIME = 0.1
"""How long the kernel takes at most to take an unplugged adapter away, in seconds."""


def fault_text(chip: str, error: OSError, owner: Path | None) -> str:
    """Return what a transfer failed with; the chip may be of a driver of the kernel."""
    match error.errno:
        case code if code in SILENT or code in GONE:
            return f"{chip} does not answer ({describe(error)})"
        case errno.EBUSY if owner is not None:
            unbind = f"echo {owner.parent.name} > {owner}/unbind"
            return f"{chip} belongs to a driver of the kernel; take it back: {unbind}"
        case errno.EBUSY:
            return (
                f"{chip} belongs to a driver of the kernel (unbind that first, or use "
                "that), or another master keeps the bus"
            )
        case errno.EAGAIN:
            return f"another master keeps the bus from {chip}"
    return f"transfer with {chip} failed: {describe(error)}"


T = TypeVar("T")

SCANNED = range(0x08, 0x78)
"""The addresses that a chip may have; the others mean something else on every bus."""


class I2CBus(LinkBus[RegisterLink]):
    """An I²C bus and the chips on it.

    Every transfer is made on the bus's one thread, so the address and the transfer,
    which are two calls of the kernel, are never torn apart by another chip's
    transfer; a `transaction` keeps several transfers together.

    What is tried again: a transfer that another master kept from the bus, because
    nothing of it was done; and one that no chip acknowledged, only if it is declared
    ``idempotent``. Reading registers is, unless the caller says otherwise (reading
    some registers clears them); everything else is not, unless the caller says so.

    Whoever asks waits for a turn; the time-out of a transfer begins with that. One that
    does not return is a `DriverStuckError` and holds up the bus: the others get
    `NoTurnError` at once until it returns, and what waited is not made late.

    Args:
        name: The name of the bus.
        bus: The number in ``/dev/i2c-N``, a path, or ``name:`` and the beginning of
            the adapter's name, for one whose number changes (``i2cdetect -l`` shows
            the names).
        timeout: How long a transfer may take unless it says otherwise, in seconds,
            repeating included, the wait for its turn not.
        pec: Have the adapter add and check a checksum (SMBus packet error code); the
            chips must know it too.
        clock: How fast the adapter is set up, in bits per second, for `esair check`.
        wire: What is opened instead of a bus of the kernel, such as a `ChipBus`; its
            ``open()`` returns the link.
    """

    _chip_form = "chip {:#04x}"

    def __init__(
        self,
        *,
        name: str,
        bus: int | str = 1,
        timeout: float = 0.2,
        pec: bool = False,
        clock: int = 100_000,
        wire: Wire | None = None,
    ) -> None:
        super().__init__(name=name, timeout=timeout, wire=wire)
        self.place: int | str = kernel.check_place(name, bus)
        self.pec = pec
        self.clock: int = check_whole(name, "clock", clock, 1)
        self._is_removable = False

    @property
    def outlet(self) -> Outlet | None:
        """An opening of the watchdog's own, of an adapter of the kernel."""
        return Outlet("i2c", {"path": self.path}) if self.path else None

    async def read(
        self,
        address: int,
        register: int,
        length: int = 1,
        *,
        idempotent: bool = True,
        timeout: float | None = None,
    ) -> bytes:
        """Read registers that follow one another, in one transfer.

        Args:
            address: The 7-bit address of the chip.
            register: The first register, 0 to 255. For longer numbers write them with
                `transfer`.
            length: How many, 1 to 32; more with `transfer`.
            idempotent: Whether it may be tried again. Say no if reading changes
                something in the chip.
            timeout: How long to wait, in seconds; the bus's ``timeout`` if None.

        Raises:
            BadValueError: Not an address, a register or a length.
            BusyError: Too many transfers wait.
            DeviceFaultError: The chip does not answer, or the transfer failed; its
                ``errno`` tells how.
            DeviceLostError: The bus itself is gone.
            DriverStuckError: It took too long, or the bus is stuck.
        """
        self._check(address, register, length)
        data = await self._turn(
            lambda link: bytes(link.read_i2c_block_data(address, register, length)),
            address,
            timeout,
            ITS_CHIP if idempotent else OCCUPIED,
            sent=False,
            received=True,
        )
        if len(data) != length:
            told = f"{self._chip(address)} sent {len(data)} bytes instead of {length}"
            raise self.failed(DeviceFaultError(self.name, told))
        return data

    async def write(
        self,
        address: int,
        register: int,
        data: bytes,
        *,
        idempotent: bool = False,
        timeout: float | None = None,
    ) -> None:
        """Write registers that follow one another, in one transfer.

        Args and errors are those of `read`, for up to 32 bytes of data.
        """
        data = check_bytes(self.name, "data", data)
        self._check(address, register, len(data))

        def transfer(link: RegisterLink) -> None:
            if len(data) == 1:
                link.write_byte_data(address, register, data[0])
            else:
                link.write_i2c_block_data(address, register, list(data))

        repeated = ITS_CHIP if idempotent else OCCUPIED
        await self._turn(transfer, address, timeout, repeated)

    async def transfer(
        self,
        address: int,
        write: bytes = b"",
        read: int = 0,
        *,
        idempotent: bool = False,
        timeout: float | None = None,
    ) -> bytes:
        """Write bytes, then read bytes after a repeated start, as a chip wants them.

        An adapter that has only SMBus gets the call that means the same, for up to 33
        bytes written, or one byte written and up to 32 read; else it is a fault. Other
        errors are those of `read`.

        Args:
            address: The 7-bit address of the chip.
            write: What to write first, up to 8192 bytes.
            read: How many bytes to read then, up to 8192.
            idempotent: Whether it may be tried again.
            timeout: How long to wait, in seconds; the bus's ``timeout`` if None.

        Returns:
            The bytes that were read.
        """
        write = check_bytes(self.name, "write", write)
        self._check(address)
        self._check_whole("write", len(write), 0, kernel.LIMIT, " bytes")
        self._check_whole("read", read, 0, kernel.LIMIT, " bytes")
        return await self._turn(
            lambda link: kernel.transfer(link, address, write, read),
            address,
            timeout,
            ITS_CHIP if idempotent else OCCUPIED,
            sent=bool(write) or not read,
            received=bool(read),
        )

    async def transaction(
        self,
        transfer: Callable[[RegisterLink], T],
        *,
        address: int | None = None,
        idempotent: bool = False,
        timeout: float | None = None,
    ) -> T:
        """Make several transfers with nothing of anybody else in between.

        Errors are those of `read`.

        Args:
            transfer: Gets the link (``smbus2.SMBus``) and may block. What it returns
                is the result. It is called on the bus's thread.
            address: The chip, for error messages.
            idempotent: Whether all of it may be done again from the start, if a
                transfer in it was not acknowledged or lost to another master.
            timeout: How long to wait, in seconds; the bus's ``timeout`` if None.
        """
        repeated = ITS_CHIP if idempotent else frozenset()
        return await self._turn(transfer, address, timeout, repeated)

    async def scan(self, addresses: Iterable[int] = SCANNED) -> dict[int, str]:
        """Look which chips are there, as carefully as ``i2cdetect`` does.

        Addresses of memories, which a quick write could lock or destroy, are read;
        the others are only addressed. Others use the bus in between.

        Args:
            addresses: Where to look, 0x08 to 0x77.

        Returns:
            ``"answers"``, or ``"busy"`` for a chip of a driver of the kernel, by
            address.

        Raises:
            BadValueError: An address is none of a chip.
            DeviceFaultError: The adapter cannot look.
            DeviceLostError: The bus itself is gone.
            DriverStuckError: The bus is stuck.
        """
        found = {}
        for address in addresses:
            if address not in SCANNED:
                told = f"expected 0x08 to 0x77, not {address!r:.80}"
                raise BadValueError(self.name, "addresses", told)
            state = await self._call(
                self._probe, address, timeout=self.timeout, address=address
            )
            if isinstance(state, EsairError):
                raise self._told(state)
            if state:
                found[address] = state
        return found

    def seconds_for(self, traffic: int) -> float:
        """Return how long so many bytes take, with two addresses and a register."""
        return 9 * (traffic + 3) / self.clock

    # The way of one transfer.

    def _code(self, error: OSError, address: int | None) -> int | None:
        return error.errno if self._owner(error, address) is None else None

    def _probe(self, link: RegisterLink, address: int) -> str | EsairError:
        try:
            kernel.probe(link, address)
        except OSError as error:
            if error.errno == errno.EBUSY:
                return "busy"
            reason = self._explained(error, address, self.timeout)
            if error.errno == errno.EOPNOTSUPP or not isinstance(
                reason, DeviceFaultError
            ):
                return reason
            return ""
        self.stats.sent += 1
        return "answers"

    def _is_there(self, error: OSError) -> bool | None:
        there = super()._is_there(error)
        if there and self._is_removable and error.errno not in ITS_CHIP:
            return self._stays()
        return there

    def _fault_text(self, error: OSError, address: int | None) -> str:
        return fault_text(self._chip(address), error, self._owner(error, address))

    def _owner(self, error: OSError, address: int | None) -> Path | None:
        """Return the kernel's driver that keeps us from a chip, if one does."""
        if error.errno != errno.EBUSY or address is None or not self.path:
            return None
        return kernel.owner(self.path, address)

    def _check(self, address: int, register: int = 0, length: int = 1) -> None:
        if not is_whole(address, 0x03, 0x77):
            told = f"expected 0x03 to 0x77, not {address!r:.80}"
            raise BadValueError(self.name, "address", told)
        self._check_whole("register", register, 0, 0xFF)
        self._check_whole("length", length, 1, kernel.SMBUS_LIMIT, " bytes")

    # Its life.

    def _look(self) -> Hashable | None:
        return kernel.presence(self.place)

    def _identity(self) -> Hashable | None:
        seen = kernel.presence(self.path)
        # A changed time may be a changed permission; device and file are the adapter.
        return None if seen is None else seen[:2]

    def _stays(self) -> bool:
        """Look for a moment: a transfer that is cut fails before its adapter is gone."""
        end = time.monotonic() + GOING_TIME
        while self._same_place():
            if time.monotonic() >= end:
                return True
            time.sleep(0.005)
        return False

    def _open_link(self) -> RegisterLink:
        path = kernel.find(self.place)
        link = kernel.open_bus(path, pec=self.pec)
        self._is_removable = kernel.is_removable(path)
        self.path = path
        return link
