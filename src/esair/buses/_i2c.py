"""I²C buses. The only module that knows smbus2."""

from __future__ import annotations

import asyncio
import errno
from collections.abc import Callable, Sequence
from typing import Any, Protocol, TypeVar, cast

from esair.buses._bus import Bus
from esair.exceptions import (
    BadValueError,
    ConfigError,
    DeviceFaultError,
    DeviceLostError,
    DriverStuckError,
    describe,
)

T = TypeVar("T")

RETRIES = 3
"""How often a transfer is tried again after another master won the bus."""

RETRY_PERIOD = 0.001
"""The first pause before that, in seconds; it doubles."""

_GONE = {errno.ENODEV, errno.EBADF, errno.ENOENT, errno.ESHUTDOWN}
_SILENT = {errno.ENXIO, errno.EREMOTEIO}


class RegisterLink(Protocol):
    """An I²C master; ``smbus2.SMBus`` is one."""

    def read_byte_data(self, i2c_addr: int, register: int) -> int:
        """Read one register."""

    def write_byte_data(self, i2c_addr: int, register: int, value: int) -> None:
        """Write one register."""

    def read_i2c_block_data(
        self, i2c_addr: int, register: int, length: int
    ) -> list[int]:
        """Read several registers in one transfer."""

    def write_i2c_block_data(
        self, i2c_addr: int, register: int, data: Sequence[int]
    ) -> None:
        """Write several registers in one transfer."""

    def close(self) -> None:
        """Let the bus go."""


class I2CBus(Bus):
    """An I²C bus and the chips on it.

    Every transfer is made on the bus's one thread, so the address and the transfer,
    which are two calls of the kernel, are never torn apart by another chip's
    transfer; a `transaction` keeps several transfers together.

    Args:
        name: The name of the bus.
        bus: The number in ``/dev/i2c-N``.
        timeout: How long a transfer may take unless it says otherwise, in seconds.
        opener: Opens something else than a bus of the kernel, such as a fake.
        inline: Call the link in the event loop itself. Only for a link that never
            blocks, where a thread would make the order of things depend on chance:
            a simulation on a virtual clock.

    Attributes:
        arbitrations: How many transfers were repeated after another master's.
    """

    def __init__(
        self,
        *,
        name: str,
        bus: int = 1,
        timeout: float = 0.2,
        opener: Callable[[], RegisterLink] | None = None,
        inline: bool = False,
    ) -> None:
        super().__init__(name=name)
        if type(bus) is not int or bus < 0:
            raise ConfigError(
                name, "bus", f"expected the N of /dev/i2c-N, not {bus!r:.80}"
            )
        self.number = bus
        self.timeout = timeout
        self.arbitrations = 0
        self._opener = opener or self._open_kernel_bus
        self._inline = inline
        self._link: RegisterLink | None = None

    async def read(
        self,
        address: int,
        register: int,
        length: int = 1,
        *,
        timeout: float | None = None,
    ) -> bytes:
        """Read registers that follow one another, in one transfer.

        Args:
            address: The 7-bit address of the chip.
            register: The first register.
            length: How many, 1 to 32.
            timeout: How long to wait, in seconds; the bus's ``timeout`` if None.

        Raises:
            BadValueError: Not an address, a register or a length.
            DeviceFaultError: The chip does not answer, or the transfer failed.
            DeviceLostError: The bus itself is gone.
            DriverStuckError: It took too long.
        """
        self._check(address, register, length)

        def transfer(link: RegisterLink) -> bytes:
            return bytes(link.read_i2c_block_data(address, register, length))

        data = await self.transaction(transfer, address=address, timeout=timeout)
        if len(data) != length:
            raise DeviceFaultError(
                self.name,
                f"chip {address:#04x} sent {len(data)} bytes instead of {length}",
            )
        return data

    async def write(
        self, address: int, register: int, data: bytes, *, timeout: float | None = None
    ) -> None:
        """Write registers that follow one another, in one transfer.

        Args and errors are those of `read`.
        """
        self._check(address, register, len(data))

        def transfer(link: RegisterLink) -> None:
            if len(data) == 1:
                link.write_byte_data(address, register, data[0])
            else:
                link.write_i2c_block_data(address, register, list(data))

        await self.transaction(transfer, address=address, timeout=timeout)

    async def transaction(
        self,
        transfer: Callable[[RegisterLink], T],
        *,
        address: int | None = None,
        timeout: float | None = None,
    ) -> T:
        """Make several transfers with nothing of anybody else in between.

        Args:
            transfer: Gets the link (``smbus2.SMBus``) and may block; runs again
                from its start when another master has won the bus.
            address: The chip, for error messages.
            timeout: How long to wait, in seconds; the bus's ``timeout`` if None.

        Raises:
            DeviceFaultError: The chip does not answer, or a transfer failed.
            DeviceLostError: The bus itself is gone.
            DriverStuckError: It took too long.
        """
        seconds = self.timeout if timeout is None else timeout
        for attempt in range(RETRIES + 1):
            link = self._connected()
            try:
                return await self._call(transfer, link, timeout=seconds)
            except (DeviceFaultError, DeviceLostError, DriverStuckError):
                raise
            except OSError as error:
                if error.errno != errno.EAGAIN or attempt == RETRIES:
                    raise self._explained(error, address) from error
                self.arbitrations += 1
            await asyncio.sleep(RETRY_PERIOD * 2**attempt)
        raise AssertionError  # the last attempt has returned or raised

    async def _call(self, function: Callable[..., T], *args: Any, timeout: float) -> T:
        if self._inline:
            return function(*args)
        return await self.lane.call(function, *args, timeout=timeout)

    def _connected(self) -> RegisterLink:
        if not self.is_open or self._link is None:
            raise DeviceLostError(self.name, "the bus is not open")
        return self._link

    def _check(self, address: int, register: int, length: int) -> None:
        if not 0x03 <= address <= 0x77:
            raise BadValueError(
                self.name, "address", f"expected 0x03 to 0x77, not {address!r:.80}"
            )
        if not 0 <= register <= 0xFF:
            raise BadValueError(
                self.name, "register", f"expected 0 to 255, not {register!r:.80}"
            )
        if not 1 <= length <= 32:
            raise BadValueError(
                self.name, "length", f"expected 1 to 32 bytes, not {length!r:.80}"
            )

    def _explained(self, error: OSError, address: int | None) -> OSError:
        chip = "a chip" if address is None else f"chip {address:#04x}"
        if error.errno in _GONE:
            loss = DeviceLostError(self.name, describe(error))
            self.lost(loss)
            return loss
        if error.errno in _SILENT:
            return DeviceFaultError(
                self.name, f"{chip} does not answer ({describe(error)})"
            )
        if error.errno == errno.EBUSY:
            return DeviceFaultError(
                self.name,
                f"{chip} belongs to a driver of the kernel: unbind that first",
            )
        return DeviceFaultError(
            self.name, f"transfer with {chip} failed: {describe(error)}"
        )

    async def _open(self) -> None:
        await self._close()  # what a loss has left behind
        try:
            self._link = await self._call(self._opener, timeout=2.0)
        except OSError as error:
            detail = f"cannot be opened: {describe(error)}"
            raise DeviceLostError(self.name, detail) from error

    async def _close(self) -> None:
        link, self._link = self._link, None
        if link is not None:
            await self._call(link.close, timeout=0.5)

    def _open_kernel_bus(self) -> RegisterLink:
        import smbus2

        return cast("RegisterLink", smbus2.SMBus(self.number))
