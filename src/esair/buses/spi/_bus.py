"""SPI buses: bytes to and from the chips on one clock."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import TypeVar

from esair.buses._bus import Wire
from esair.buses._link_bus import LinkBus
from esair.buses.spi import _kernel as kernel
from esair.buses.spi._kernel import LIMIT, SpiLink
from esair.exceptions import DeviceFaultError
from esair.values import check_bytes, check_whole

T = TypeVar("T")


class SpiBus(LinkBus[SpiLink]):
    """An SPI bus and the chips on it.

    Every transfer is made on the bus's one thread; a `transaction` keeps several of
    them together. For each byte sent one comes back at the same time, and nobody
    acknowledges anything: a chip that is not there reads as 0x00 or 0xFF, so a driver
    asks for something it knows before it believes the rest. Nothing is ever repeated.

    In ``bus.stats`` transfers are counted: ``sent``, and ``received`` those whose answer
    was asked for.

    Args:
        name: The name of the bus.
        bus: The N of ``/dev/spidevN.M``, where M is a chip select.
        speed: Bits per second, unless a transfer says otherwise.
        mode: 0 to 3: polarity and phase of the clock, unless a transfer says otherwise.
        timeout: How long a transfer may take unless it says otherwise, in seconds,
            the wait for its turn not included.
        wire: What is opened instead of a bus of the kernel, such as `SpiChips`; its
            ``open()`` returns the link.
    """

    path: str

    def __init__(
        self,
        *,
        name: str,
        bus: int = 0,
        speed: int = 1_000_000,
        mode: int = 0,
        timeout: float = 0.2,
        wire: Wire | None = None,
    ) -> None:
        super().__init__(name=name, timeout=timeout, wire=wire)
        self.bus: int = check_whole(name, "bus", bus, 0)
        self.speed: int = check_whole(name, "speed", speed, 1)
        self.mode: int = check_whole(name, "mode", mode, 0, 3)

    async def exchange(
        self,
        chip: int,
        data: bytes,
        *,
        speed: int | None = None,
        mode: int | None = None,
        timeout: float | None = None,
    ) -> bytes:
        """Send bytes, and return the bytes that came at the same time.

        Args:
            chip: The number of the chip select.
            data: 1 to 4096 bytes.
            speed: Bits per second; the bus's if None.
            mode: Polarity and phase of the clock; the bus's if None.
            timeout: How long to wait, in seconds; the bus's ``timeout`` if None.

        Raises:
            BadValueError: Not a chip select, a speed or a mode, or too many bytes.
            BusyError: Too many transfers wait.
            DeviceFaultError: The transfer failed; its ``errno`` tells how.
            DeviceLostError: The bus itself is gone.
            DriverStuckError: It took too long, or the bus is stuck.
        """
        hertz = self.speed if speed is None else speed
        phase = self.mode if mode is None else mode
        data = check_bytes(self.name, "data", data)
        self._check_whole("chip", chip, 0, 255)
        self._check_whole("data", len(data), 1, LIMIT, " bytes")
        self._check_whole("speed", hertz, 1, 2**32, " Hz")
        self._check_whole("mode", phase, 0, 3)
        back = await self._turn(
            lambda link: link.exchange(chip, data, hertz, phase), chip, timeout
        )
        if len(back) != len(data):
            told = f"chip {chip} sent {len(back)} bytes instead of {len(data)}"
            raise self.failed(DeviceFaultError(self.name, told))
        return back

    async def transfer(
        self,
        chip: int,
        write: bytes,
        read: int = 0,
        *,
        speed: int | None = None,
        mode: int | None = None,
        timeout: float | None = None,
    ) -> bytes:
        """Write bytes, then read bytes while zeros are sent, under one chip select.

        Args and errors are those of `exchange`, for 4096 bytes of both together.

        Returns:
            The bytes that were read.
        """
        write = check_bytes(self.name, "write", write)
        self._check_whole("read", read, 0, LIMIT, " bytes")
        back = await self.exchange(
            chip, write + bytes(read), speed=speed, mode=mode, timeout=timeout
        )
        self.stats.received += bool(read)
        return back[len(write) :]

    async def transaction(
        self,
        transfer: Callable[[SpiLink], T],
        *,
        chip: int | None = None,
        timeout: float | None = None,
    ) -> T:
        """Make several transfers with nothing of anybody else in between.

        Errors are those of `exchange`.

        Args:
            transfer: Gets the `SpiLink` and may block. What it returns is the result.
                It is called on the bus's thread.
            chip: The chip select, for error messages.
            timeout: How long to wait, in seconds; the bus's ``timeout`` if None.
        """
        return await self._turn(transfer, chip, timeout)

    def seconds_for(self, traffic: int) -> float:
        """Return how long so many bytes take."""
        return 8 * traffic / self.speed

    def _identity(self) -> Hashable | None:
        # A changed time may be a changed permission; device and file are the bus.
        return tuple(each[:3] for each in kernel.presence(self.bus) or ()) or None

    def _look(self) -> Hashable | None:
        return kernel.presence(self.bus)

    def _open_link(self) -> SpiLink:
        link = kernel.open_bus(self.name, self.bus)
        self.path = f"/dev/spidev{self.bus}"
        return link
