"""A fake I²C bus: chips in memory, and everything that goes wrong with real ones."""

from __future__ import annotations

import asyncio
import collections
import contextlib
import errno
import os
import threading
import time
from collections.abc import Callable, Mapping
from typing import TypeVar

import attrs

from esair.buses import I2CBus
from esair.buses.i2c import Chip, ChipBus, Registers
from esair.buses.i2c._errors import stuck_with
from esair.exceptions import DeviceLostError

T = TypeVar("T")

LOG_LIMIT = 4096
"""How many transfers are kept; then the oldest go."""


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


@attrs.define
class _Failure:
    error: BaseException
    after: int
    times: int | None
    address: int | None


class FakeLink(ChipBus):
    """The far end of a `FakeI2c`, in two steps as the kernel: select, then transfer.

    Used by two threads at once it reaches the wrong chip, as the kernel does.
    """

    def __init__(self, chips: dict[int, Chip]) -> None:
        super().__init__(chips)
        self.virtual = False
        self.selected = 0
        self.silent: set[int] = set()
        self.failures: list[_Failure] = []
        self.stretch = 0.0
        self.go = threading.Event()
        self.go.set()
        self.log: collections.deque[Transfer] = collections.deque(maxlen=LOG_LIMIT)
        self._one_at_a_time = threading.Lock()

    def _exchange(self, address: int, write: bytes, read: int) -> bytes:
        self.selected = address
        self._wait()
        if not self.virtual:  # where the loop and a driver's thread may both be here
            address = self.selected
        with self._one_at_a_time:
            self._fail(address)
            data = super()._exchange(address, write, read)
            self.log.append(Transfer(address, write, data))
        return data

    def _wait(self) -> None:
        if not self.virtual:
            self.go.wait()
            time.sleep(self.stretch)  # where another thread may select another chip
        elif not self.go.is_set():
            # No time passes on a virtual clock while a driver's thread works.
            raise _os_error(errno.ETIMEDOUT)

    def _fail(self, address: int) -> None:
        if not self.plugged:
            return  # that comes first
        for failure in self.failures:
            if failure.address not in {None, address}:
                continue
            if failure.after > 0:
                failure.after -= 1
                continue
            if failure.times is not None:
                failure.times -= 1
                if failure.times <= 0:
                    self.failures.remove(failure)
            raise failure.error

    def _chip(self, address: int) -> Chip:
        chip = super()._chip(address)
        if address in self.silent:
            raise _os_error(errno.ENXIO)
        return chip


def _os_error(code: int) -> OSError:
    return OSError(code, os.strerror(code))


class FakeI2c(I2CBus):
    r"""An I²C bus with chips in memory that does what its test tells it.

    On a virtual clock it runs in the event loop, else on its thread as a real bus; it
    is driven by the same code as a real one either way.

    Args:
        name: The name of the bus.
        chips: The chips by their addresses: objects with ``read(register, length)``
            and ``write(register, data)``, such as `esair.drivers.bme280.fake.FakeBme280`; or
            plain registers, as bytes or by their numbers.
        timeout: How long a transfer may take, in seconds.

    Example:
        >>> bus = FakeI2c(chips={0x48: {0x00: b"\x19\x00"}})
        >>> bus.fail(errno.EIO, after=2)
    """

    def __init__(
        self,
        name: str = "i2c",
        chips: Mapping[int, Chip | bytes | Mapping[int, int | bytes]] | None = None,
        *,
        timeout: float = 0.2,
    ) -> None:
        self.link = FakeLink(
            {
                address: Registers(chip) if isinstance(chip, bytes | Mapping) else chip
                for address, chip in (chips or {}).items()
            }
        )
        super().__init__(name=name, timeout=timeout, opener=self._plug_in)
        self._wire = asyncio.Lock()
        self._go = asyncio.Event()
        self._go.set()
        self._begun: Callable[[], object] | None = None

    @property
    def chips(self) -> dict[int, Chip]:
        """The chips on the bus by their addresses; put in and take out at any time."""
        return self.link.chips

    @property
    def log(self) -> list[Transfer]:
        """The newest transfers that a chip answered, the oldest of them first."""
        return list(self.link.log)

    def fail(
        self,
        error: OSError | int,
        *,
        after: int = 0,
        times: int | None = 1,
        address: int | None = None,
    ) -> None:
        """Let transfers fail.

        Args:
            error: What the kernel says: an error number, such as ``errno.EIO``.
            after: How many transfers go well before.
            times: How many fail; None for all from then on.
            address: Only those with this chip; with any if None.
        """
        if isinstance(error, int):
            error = _os_error(error)
        self.link.failures.append(_Failure(error, after, times, address))

    def silent(self, address: int, *, silent: bool = True) -> None:
        """Let a chip acknowledge nothing, or answer again."""
        (self.link.silent.add if silent else self.link.silent.discard)(address)

    def stretch(self, seconds: float) -> None:
        """Let every transfer take so long, as a chip does that holds the clock low."""
        self.link.stretch = seconds

    def stall(self) -> None:
        """Let no transfer return until `resume`: the clock is held low for ever."""
        self.link.go.clear()
        self._go.clear()

    def resume(self) -> None:
        """Let transfers go on; one that had begun is made now."""
        self.link.go.set()
        self._go.set()
        self._finish()

    def unplug(self, *, noticed: bool = True) -> None:
        """Take the adapter away.

        Args:
            noticed: Whether all on the bus are told at once, as with a USB adapter;
                else the next transfer finds out.
        """
        self.link.unplug()
        if noticed:
            self.lost(DeviceLostError(self.name, "the adapter was unplugged"))

    def plug(self) -> None:
        """Bring the adapter back; the bus can be opened again."""
        self.link.plug()
        self.arrived()

    def _plug_in(self) -> FakeLink:
        if not self.link.plugged:
            raise _os_error(errno.ENOENT)
        self.link.closed = False
        return self.link

    async def _open(self) -> None:
        virtual = getattr(asyncio.get_running_loop(), "virtual", False)
        self._inline = self.link.virtual = virtual
        await super()._open()

    async def _close(self) -> None:
        if self._begun is not None:  # the wire is let go with what is stuck on it
            self._begun = None
            self._wire.release()
            self.executor.stuck_since = None
        await super()._close()

    async def _call(
        self,
        function: Callable[..., T],
        *args: object,
        timeout: float,
        address: int | None = None,
    ) -> T:
        if not self._inline or (self._go.is_set() and not self.link.stretch):
            return await super()._call(
                function, *args, timeout=timeout, address=address
            )
        link = self._connected()
        self._check_stuck()
        loop = asyncio.get_running_loop()
        until = loop.time() + timeout
        stuck = stuck_with(self.name, address, timeout)
        try:
            async with asyncio.timeout_at(until):
                await self._wire.acquire()
        except TimeoutError:
            raise self._failed(stuck) from None
        try:
            async with asyncio.timeout_at(until):
                await self._go.wait()
                await asyncio.sleep(self.link.stretch)
        except TimeoutError:
            # The transfer has begun: nobody waits for it, but the chip will see it.
            self._begun = lambda: function(link, *args)
            self.executor.stuck_since = loop.time()
            if self._go.is_set():
                loop.call_later(max(0.0, self.link.stretch - timeout), self._finish)
            raise self._failed(stuck) from None
        except asyncio.CancelledError:
            self._wire.release()
            raise
        try:
            return await super()._call(
                function, *args, timeout=timeout, address=address
            )
        finally:
            self._wire.release()

    def _finish(self) -> None:
        """Make the transfer that had begun, too late for who asked for it."""
        begun, self._begun = self._begun, None
        if begun is not None:
            with contextlib.suppress(OSError):
                begun()
            self._wire.release()
            self.executor.stuck_since = None
