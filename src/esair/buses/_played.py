"""What the fakes of buses with a blocking link have in common: their bad days."""

from __future__ import annotations

import asyncio
import collections
import contextlib
import errno
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

from esair.buses._bus import TURN_LIMIT
from esair.buses._failures import Failures, MemoryWire, os_error
from esair.buses._inbox import within
from esair.buses._link_bus import L, LinkBus
from esair.exceptions import DeviceLostError
from esair.loop import InLine, fail, had_turn, turn_of

T = TypeVar("T")

LOG_LIMIT = 4096
"""How many transfers are kept; then the oldest go."""


class PlayedWire(MemoryWire):
    """A far end whose transfers wait, stretch and fail as a test says.

    Attributes:
        virtual: Whether it is on a virtual clock, in the event loop.
        powered: Whether its chips have power.
        log: The newest transfers, the oldest of them first.
        stretch: How long every transfer takes, in seconds.
        go: Set unless transfers do not return.
        failures: What is to fail.
    """

    def __init__(self, chips: dict[int, Any]) -> None:
        super().__init__(chips)
        self.virtual = False
        self.powered = True
        self.log: collections.deque[Any] = collections.deque(maxlen=LOG_LIMIT)
        self.stretch: float = 0.0
        self.go: threading.Event = threading.Event()
        self.go.set()
        self.failures: Failures = Failures()

    def hold(self) -> None:
        """Let a transfer take its time; on the thread of the bus."""
        if not self.virtual:
            self.go.wait()
            time.sleep(self.stretch)  # where another thread may select another chip
        elif not self.go.is_set():
            # No time passes on a virtual clock while a driver's thread works.
            raise os_error(errno.ETIMEDOUT)

    def fail_if_told(self, address: int) -> None:
        """Raise what a transfer with a chip is to fail with."""
        if self.plugged:  # that comes first
            self.failures.check(address)


class PlayedBus(LinkBus[L]):
    """A bus that does what its test tells it; ``link`` is its far end.

    On a virtual clock it runs in the event loop, else on its thread as a real bus; it
    is driven by the same code as a real one either way.
    """

    link: Any

    def __init__(
        self,
        name: str,
        wire: Callable[[dict[int, Any]], PlayedWire],
        registers: Callable[[Any], object],
        chips: Mapping[int, Any] | None,
        *,
        timeout: float,
    ) -> None:
        self.link = wire(
            {
                number: registers(chip) if isinstance(chip, bytes | Mapping) else chip
                for number, chip in (chips or {}).items()
            }
        )
        super().__init__(name=name, timeout=timeout, wire=self.link)
        self._is_taken = False
        self._line: collections.deque[InLine[None]] = collections.deque()
        """The calls that wait for their turn."""
        self._go = asyncio.Event()
        self._go.set()
        self._begun: Callable[[], object] | None = None

    def silence(self) -> None:
        """Let no chip answer: they have no power."""
        self.link.powered = False

    def speak(self) -> None:
        """Let the chips answer again."""
        self.link.powered = True

    def power_cycle(self) -> None:
        """Call the ``power_cycle`` of each chip that has one."""
        for chip in self.link.chips.values():
            if callable(restart := getattr(chip, "power_cycle", None)):
                restart()

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
            error = os_error(error)
        self.link.failures.add(error, after, times, address)

    def stretch(self, seconds: float) -> None:
        """Let every transfer take so long, as a slow or busy chip does."""
        self.link.stretch = seconds

    def seconds_for(self, traffic: int) -> float:
        """Return how long a transfer takes."""
        return self.link.stretch or super().seconds_for(traffic)

    def stall(self) -> None:
        """Let no transfer return until `resume`."""
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
        self.link.plugged = False
        if noticed:
            self.lost(DeviceLostError(self.name, "the adapter was unplugged"))

    def plug(self) -> None:
        """Bring the adapter back; the bus can be opened again."""
        self.link.plugged = True
        self.arrived()

    async def _open(self) -> None:
        self.link.virtual = turn_of(asyncio.get_running_loop()).virtual
        await super()._open()

    async def _close(self) -> None:
        if self._begun is not None:  # the wire is let go with what is stuck on it
            self._begun = None
            self._pass_on()
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
        stuck = self._stuck_with(address, timeout)
        await self._take_turn(address)
        try:
            async with asyncio.timeout(timeout):
                await self._go.wait()
                await asyncio.sleep(self.link.stretch)
        except TimeoutError:
            # The transfer has begun: nobody waits for it, but the chip will see it.
            self._begun = lambda: function(link, *args)
            self.executor.stuck_since = loop.time()
            while self._line:
                fail(self._line.popleft(), TimeoutError())
            if self._go.is_set():
                loop.call_later(max(0.0, self.link.stretch - timeout), self._finish)
            raise self.failed(stuck) from None
        except asyncio.CancelledError:
            self._pass_on()
            raise
        try:
            return await super()._call(
                function, *args, timeout=timeout, address=address
            )
        finally:
            self._pass_on()

    async def _take_turn(self, address: int | None) -> None:
        loop = asyncio.get_running_loop()
        since = loop.time()
        if not self._is_taken:
            self._is_taken = True
            return
        waiter: InLine[None] = InLine(loop=loop)
        self._line.append(waiter)
        try:
            await within(waiter, TURN_LIMIT)
            had_turn(loop.time() - since)
        except TimeoutError:
            raise self._no_turn(address, loop.time() - since) from None
        except asyncio.CancelledError:
            if waiter.done() and not waiter.cancelled():
                self._pass_on()
            raise

    def _pass_on(self) -> None:
        self._is_taken = False
        while self._line and not self._is_taken:
            waiter = self._line.popleft()
            if not waiter.done():
                self._is_taken = True
                waiter.set_result(None)

    def _finish(self) -> None:
        """Make the transfer that had begun, too late for who asked for it."""
        begun, self._begun = self._begun, None
        if begun is not None:
            with contextlib.suppress(OSError):
                begun()
            self.executor.stuck_since = None
            self._pass_on()
