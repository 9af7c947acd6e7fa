"""Buses whose package blocks: every call is made on the one thread of the bus."""

from __future__ import annotations

import abc
import asyncio
import contextlib
import errno
import random
from collections.abc import Callable, Hashable
from typing import Generic, NamedTuple, Protocol, TypeVar

from esair.buses._bus import TURN_LIMIT, Bus, Wire, open_on, shut_on, wanted
from esair.exceptions import (
    BadValueError,
    BusyError,
    DeviceFaultError,
    DeviceLostError,
    DriverStuckError,
    EsairError,
    NoTurnError,
    describe,
)
from esair.loop import turn_of
from esair.values import check_duration, check_seconds, is_whole

T = TypeVar("T")

GONE = frozenset({errno.ENODEV, errno.EBADF, errno.ENOENT, errno.ESHUTDOWN})
"""The adapter itself is not there; some say it of a chip."""

OPEN_TIMEOUT = 2.0
"""How long opening a bus may take, in seconds."""

RETRIES = 3
"""How often a transfer is tried again that may be."""

RETRY_PERIOD = 0.001
"""The first pause before that, in seconds; it doubles, and varies by half."""


class Closable(Protocol):
    """What is open while a bus is."""

    def close(self) -> None:
        """Let the bus go; may block."""


L = TypeVar("L", bound=Closable)


class Failure(NamedTuple):
    """A transfer that failed; its number is None if trying again cannot help."""

    error: EsairError
    cause: OSError
    code: int | None


class LinkBus(Bus, Generic[L]):
    """A bus behind a link whose calls block, and return when the transfer is made.

    Whoever asks waits for a turn, at most `TURN_LIMIT`; the time-out of a transfer begins
    with that. One that does not return is a `DriverStuckError` and holds up the bus: the
    others get `NoTurnError` at once until it returns, and what waited is not made late.

    Where the link is a wire in memory and the clock a virtual one, calls are made in
    the event loop itself: a thread would make the order of things depend on chance.

    Args:
        name: The name of the bus.
        timeout: How long a transfer may take unless it says otherwise, in seconds.
        wire: What is opened instead of a bus of the kernel; ``open()`` returns a link.
    """

    def __init__(self, *, name: str, timeout: float, wire: Wire | None = None) -> None:
        super().__init__(name=name, wire=wire)
        self.timeout: float = check_seconds(name, "timeout", timeout)
        self.path: str = ""
        """The path of the kernel's bus while it is open."""
        self._link: L | None = None
        self._jitter = random.Random(name)
        self._inline = False
        self._opened_as: Hashable | None = None
        if wire is None:
            self._presence = self._look
            self._still_there = self._same_place
        self._loop: asyncio.AbstractEventLoop | None = None

    @abc.abstractmethod
    def _open_link(self) -> L:
        """Open the kernel's bus, and set its ``path``; blocks."""

    @abc.abstractmethod
    def _look(self) -> Hashable | None:
        """Look what is where the bus is; another value is another arrival of it."""

    @abc.abstractmethod
    def _identity(self) -> Hashable | None:
        """Return what tells the bus that is open from another; None if it is gone."""

    _chip_form = "chip {}"
    """How a chip is called, by its address or chip select."""

    def _chip(self, address: int | None) -> str:
        return "a chip" if address is None else self._chip_form.format(address)

    def _check_whole(
        self, field: str, value: object, least: int, most: int, what: str = ""
    ) -> None:
        if not is_whole(value, least, most):
            told = f"expected {least} to {most}{what}, not {value!r:.80}"
            raise BadValueError(self.name, field, told)

    def _same_place(self) -> bool:
        seen = self._identity()
        return seen is not None and seen == self._opened_as

    def _is_there(self, error: OSError) -> bool | None:
        """Tell whether the adapter is, after an error; None where nobody can know."""
        return self._same_place() if self.path else None

    def _fault_text(self, error: OSError, address: int | None) -> str:
        """Say what a transfer failed with."""
        return f"transfer with {self._chip(address)} failed: {describe(error)}"

    def _explained(
        self, error: OSError, address: int | None, seconds: float
    ) -> EsairError:
        """Find out what an error of a transfer means; may look into files."""
        there, code = self._is_there(error), error.errno
        was_lost = not self.is_open  # meanwhile: nobody can look any more
        if was_lost or there is False or (there is None and code in GONE):
            return DeviceLostError(self.name, describe(error))
        if code == errno.ETIMEDOUT:
            return self._stuck_with(address, seconds)
        fault = DeviceFaultError(self.name, self._fault_text(error, address))
        fault.errno = code
        return fault

    def _stuck_with(self, address: int | None, seconds: float) -> DriverStuckError:
        what = f"a transfer with {self._chip(address)}"
        return DriverStuckError(self.name, what, seconds)

    def direct(self, transfer: Callable[[L], T], *, address: int | None = None) -> T:
        """Make transfers from a plain method of a driver, which may block.

        Such methods run on the bus's thread already, so nobody else's transfers come
        between those of one call. Nothing is tried again.

        Args:
            transfer: Gets the link, as in `transaction`.
            address: The chip, for error messages.

        Raises:
            RuntimeError: It is called from another thread.
            DeviceFaultError: The chip does not answer, or a transfer failed.
            DeviceLostError: The bus itself is gone.
            DriverStuckError: The adapter gave up on the bus.
        """
        if not self.executor.is_current:
            raise RuntimeError(
                f"{self.name}: direct() is for plain (not async) methods of drivers, "
                "which run on the thread of the bus"
            )
        outcome = self._make(self._connected(), transfer, address, self.timeout)
        if isinstance(outcome, Failure):
            if not isinstance(outcome.error, DeviceLostError):
                self.failed(outcome.error)
            elif self._loop is not None:
                self._loop.call_soon_threadsafe(self.lost, outcome.error)
            raise outcome.error from outcome.cause
        return outcome

    @property
    def stuck_since(self) -> float | None:
        """When a transfer overran its time that has not returned; None if none has."""
        return self.executor.stuck_since

    async def _turn(
        self,
        transfer: Callable[[L], T],
        address: int | None,
        timeout: float | None,
        repeated: frozenset[int] = frozenset(),
        *,
        sent: bool = True,
        received: bool = False,
    ) -> T:
        """Make a transfer in its turn; again, with growing pauses, after some errors.

        Args:
            transfer: Makes it.
            address: The chip, for errors.
            timeout: How long it may take; that of the bus if None.
            repeated: The error numbers after which it is made again.
            sent: Whether it counts as sent.
            received: Whether it counts as received.
        """
        left = self.timeout
        if timeout is not None:
            left = check_duration(self.name, "timeout", timeout)
        loop = asyncio.get_running_loop()
        until = loop.time() + left
        attempt = 0
        while True:
            outcome = await self._call(
                self._make,
                *(transfer, address, left, sent, received),
                timeout=left,
                address=address,
            )
            if not isinstance(outcome, Failure):
                return outcome  # type: ignore[no-any-return]
            pause = RETRY_PERIOD * 2**attempt * self._jitter.uniform(0.5, 1.5)
            left = until - loop.time() - pause
            if outcome.code not in repeated or attempt == RETRIES or left <= 0:
                raise self._told(outcome.error) from outcome.cause
            attempt += 1
            self.stats.retries += 1
            await asyncio.sleep(pause)

    def _make(
        self,
        link: L,
        transfer: Callable[[L], T],
        address: int | None,
        seconds: float,
        sent: bool = True,
        received: bool = False,
    ) -> T | Failure:
        """Make a transfer, on the thread, and find out what an error means."""
        try:
            made = transfer(link)
        except EsairError:
            raise
        except OSError as error:
            reason = self._explained(error, address, seconds)
            return Failure(reason, error, self._code(error, address))
        self.stats.sent += sent
        self.stats.received += received
        return made

    def _code(self, error: OSError, address: int | None) -> int | None:
        """Return the error number by which a transfer is repeated, if it may be."""
        return error.errno

    async def _call(
        self,
        function: Callable[..., T],
        *args: object,
        timeout: float,
        address: int | None = None,
    ) -> T:
        """Call a function with the link first, in the thread; not late."""
        link = self._connected()
        self._check_stuck()
        if self._inline:
            return function(link, *args)
        try:
            return await self.executor.call(
                function, link, *args, timeout=timeout, guard=wanted, turn=TURN_LIMIT
            )
        except NoTurnError as error:
            raise self._no_turn(address, error.seconds) from None
        except DriverStuckError:
            raise self.failed(self._stuck_with(address, timeout)) from None
        except BusyError:
            self.stats.refused += 1
            raise

    def _check_stuck(self) -> None:
        stuck = self.executor.stuck_since
        if stuck is not None:
            self.stats.refused += 1
            since = asyncio.get_running_loop().time() - stuck + self.timeout
            raise self.failed(NoTurnError(self.name, "a transfer", since))

    def _no_turn(self, address: int | None, seconds: float) -> NoTurnError:
        self.stats.no_turn += 1
        return self.failed(NoTurnError(self.name, self._chip(address), seconds))

    def _told(self, error: EsairError) -> EsairError:
        if isinstance(error, DeviceLostError):
            self.lost(error)  # which counts it
            return error
        return self.failed(error)

    def _connected(self) -> L:
        if not self.is_open or self._link is None:
            raise DeviceLostError(self.name, "the bus is not open")
        return self._link

    def _open_of_kernel(self) -> L:
        link = self._open_link()
        self._opened_as = self._identity()
        return link

    async def _open(self) -> None:
        self._loop = asyncio.get_running_loop()
        make: Callable[[], L] = self._open_of_kernel
        if self._wire is not None:
            make = (await self._far_end(self._wire)).open
            self._inline = turn_of(self._loop).virtual
        try:
            if self._inline:
                self._link = make()
            else:
                self._link = await open_on(
                    self.executor, make, _shut, timeout=OPEN_TIMEOUT
                )
        except DeviceLostError:
            raise
        except OSError as error:
            detail = f"cannot be opened: {describe(error)}"
            raise DeviceLostError(self.name, detail) from error

    async def _close(self) -> None:
        link, self._link = self._link, None
        self.path = ""
        if link is None:
            return
        if self._inline:
            link.close()
            return
        try:
            await shut_on(self.executor, link.close, timeout=0.2)
        except OSError as error:
            self.stats.last_error = describe(error)


def _shut(link: Closable) -> None:
    with contextlib.suppress(OSError):
        link.close()
