"""What the fakes of buses have in common: what was sent, what fails, chips in memory."""

from __future__ import annotations

import asyncio
import collections
import contextlib
import errno
import functools
import os
import threading
import time
from collections.abc import Callable, Hashable, Iterable, Mapping
from typing import Any, Generic, Self, SupportsIndex, TypeVar, overload

import attrs

from esair.buses._bus import Wire
from esair.buses._exchanges import Exchanges
from esair.buses._inbox import within
from esair.buses._link_bus import L, LinkBus
from esair.exceptions import DeviceLostError
from esair.loop import turn_of
from esair.values import check_whole

T = TypeVar("T")
W = TypeVar("W")
C = TypeVar("C")
X = TypeVar("X")


def os_error(code: int) -> OSError:
    """Return the error of an error number, in the kernel's words."""
    return OSError(code, os.strerror(code))


@attrs.define
class _Failure:
    error: BaseException
    after: int
    times: int | None
    about: Hashable | None


class Failures:
    """Calls that fail as a test says, in the order in which it was told."""

    def __init__(self) -> None:
        self._all: list[_Failure] = []

    def add(
        self,
        error: BaseException,
        after: int = 0,
        times: int | None = 1,
        about: Hashable | None = None,
    ) -> None:
        """Fail so many calls, or all if None, after some; those about one thing only."""
        self._all.append(_Failure(error, after, times, about))

    def clear(self) -> None:
        """Let all calls go well from now on."""
        self._all.clear()

    def due(self, about: Hashable | None = None) -> BaseException | None:
        """Return what the next call fails with, which counts as that call."""
        for failure in self._all:
            if failure.about not in {None, about}:
                continue
            if failure.after > 0:
                failure.after -= 1
                continue
            if failure.times is not None:
                failure.times -= 1
                if failure.times <= 0:
                    self._all.remove(failure)
            return failure.error
        return None

    def check(self, about: Hashable | None = None) -> None:
        """Raise what the next call fails with."""
        error = self.due(about)
        if error is not None:
            raise error


class Sent(collections.deque[T]):
    """The newest that a robot has sent, in order; a slice of it is a list."""

    @overload
    def __getitem__(self, at: SupportsIndex) -> T: ...
    @overload
    def __getitem__(self, at: slice) -> list[T]: ...
    def __getitem__(self, at: Any) -> Any:
        return list(self)[at] if isinstance(at, slice) else super().__getitem__(at)


class Awaited(Generic[T]):
    """Tests that wait until something has come."""

    def __init__(self) -> None:
        self._waiting: list[tuple[Callable[[T], bool], asyncio.Future[T]]] = []

    def came(self, item: T) -> None:
        """Tell who waits for it."""
        for matches, future in self._waiting:
            if not future.done() and matches(item):
                future.set_result(item)

    async def until(
        self,
        matches: Callable[[T], bool],
        there: Iterable[T],
        timeout: float,
        complain: Callable[[], str],
    ) -> T:
        """Return the first that matches, of what is there or of what comes in time."""
        for item in there:
            if matches(item):
                return item
        future: asyncio.Future[T] = asyncio.get_running_loop().create_future()
        waiter = (matches, future)
        self._waiting.append(waiter)
        try:
            return await within(future, timeout)
        except TimeoutError:
            raise TimeoutError(complain()) from None
        finally:
            self._waiting.remove(waiter)


class Fake(Generic[T, W]):
    """What the robot has sent on a fake bus, and what fails.

    Attributes:
        sent: What was sent and has reached the far end, oldest first. It is there a moment
            after the sending has returned: `until` waits for that.
    """

    name: str

    def _begin(self, limit: int) -> None:
        """Remember so much of what is sent; then the newest win."""
        self.sent: Sent[T] = Sent(maxlen=limit)
        self._failures = Failures()
        self._awaited: Awaited[T] = Awaited()

    def _is(self, item: T, wanted: W) -> bool:
        """Tell whether it is what a test waits for."""
        return bool(item == wanted)

    def _there(self) -> Iterable[T]:
        """Return what counts of what was sent before a wait."""
        return self.sent

    async def until(
        self, wanted: W | Callable[[T], bool], *, timeout: float = 1.0
    ) -> T:
        """Wait until the robot has sent something, and return it.

        What is in ``sent`` already counts: the oldest message on a serial line, the newest
        frame of each CAN id, the newest message of a broker.

        Args:
            wanted: A message without its framing, an id, a topic; or a condition.
            timeout: How long to wait, in seconds.

        Raises:
            TimeoutError: It did not come; what came last is in the error.
        """
        given: Any = wanted
        words = f"a frame {given:#x}" if isinstance(given, int) else repr(given)
        return await self._awaited.until(
            given if callable(given) else lambda item: self._is(item, given),
            self._there(),
            timeout,
            lambda: (
                f"{self.name}: {words} did not come in {timeout:g} s; "
                f"the last that came are {self.sent[-5:]!r}"
            ),
        )

    def fail(
        self, error: BaseException, *, after: int = 0, times: int | None = 1
    ) -> None:
        """Raise an error from what the robot sends; an `OSError` is a loss of the bus.

        Args:
            error: What to raise.
            after: How often it goes well before.
            times: How often it fails; None for all from then on.
        """
        self._failures.add(error, after, times)


LOG_LIMIT = 4096
"""How many transfers are kept; then the oldest go."""


class ChipsWire(Wire):
    """A bus of chips in memory, which is its own link; told to wait, stretch and fail.

    Args:
        chips: The chips by their addresses, or by their chip selects.

    Attributes:
        virtual: Whether it is on a virtual clock, in the event loop.
        powered: Whether its chips have power.
        log: The newest transfers, the oldest of them first.
        stretch: How long every transfer takes, in seconds.
        go: Set unless transfers do not return.
        failures: What is to fail.
    """

    def __init__(self, chips: dict[int, Any]) -> None:
        super().__init__()
        self.chips = chips
        self.plugged = True
        self.virtual = False
        self.powered = True
        self.log: collections.deque[Any] = collections.deque(maxlen=LOG_LIMIT)
        self.stretch: float = 0.0
        self.go: threading.Event = threading.Event()
        self.go.set()
        self.failures: Failures = Failures()

    def open(self) -> Self:
        """Return the link, which is this.

        Raises:
            OSError: It is unplugged.
        """
        if not self.plugged:
            raise os_error(errno.ENOENT)
        return self

    def unplug(self) -> None:
        """Take the adapter away; who used it notices at the next transfer."""
        self.plugged = False

    def plug(self) -> None:
        """Bring it back; nothing happens if it is there."""
        if not self.plugged:
            self.plugged = True
            self._tell_plugged()

    def close(self) -> None:
        """Let the bus go; nothing is kept for it."""

    def hold(self) -> None:
        """Let a transfer take its time; on the thread of the bus."""
        if not self.virtual:
            self.go.wait()
            time.sleep(self.stretch)  # where another thread may select another chip
        elif not self.go.is_set():
            # No time passes on a virtual clock while a driver's thread works.
            raise os_error(errno.ETIMEDOUT)

    def check(self, address: int) -> None:
        """Raise what a transfer with a chip fails with."""
        if not self.plugged:
            raise os_error(errno.ENODEV)
        self.failures.check(address)


class PlayedBus(LinkBus[L], Generic[L, C, X]):
    """A bus that does what its test tells it; ``link`` is its far end.

    On a virtual clock it runs in the event loop, else on its thread as a real bus; it
    is driven by the same code as a real one either way.
    """

    _wire_of: Callable[[dict[int, Any]], Any]
    _registers: Callable[[Any], Any]
    _medium: str

    def __init__(
        self,
        name: str = "",
        chips: Mapping[int, C | bytes | Mapping[int, int | bytes]] | None = None,
        *,
        timeout: float = 0.2,
    ) -> None:
        name = name or self._medium
        made = {
            check_whole(name, "chips", number, 0): (
                self._registers(chip) if isinstance(chip, bytes | Mapping) else chip
            )
            for number, chip in (chips or {}).items()
        }
        self.link = self._wire_of(made)
        super().__init__(name=name, timeout=timeout, wire=self.link)
        self._turns = Exchanges(self)
        self._go = asyncio.Event()
        self._go.set()
        self._begun: Callable[[], object] | None = None

    @property
    def chips(self) -> dict[int, C]:
        """The chips on the bus, by their numbers; put in and take out at any time."""
        chips: dict[int, C] = self.link.chips
        return chips

    @property
    def log(self) -> list[X]:
        """The newest transfers, the oldest of them first."""
        return list(self.link.log)

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
            self.executor.stuck_since = None
        await super()._close()

    async def _call(
        self,
        function: Callable[..., T],
        *args: object,
        timeout: float,
        address: int | None = None,
    ) -> T:
        make = functools.partial(
            super()._call, function, *args, timeout=timeout, address=address
        )
        if not self._inline or (self._go.is_set() and not self.link.stretch):
            return await make()
        link = self._connected()
        self._check_stuck()
        loop = asyncio.get_running_loop()
        request = self._turns.request(timeout=timeout)
        request.name = self._chip(address)
        async with request:
            if self.executor.stuck_since is not None:  # the one before has not returned
                raise self._no_turn(address, timeout)
            stuck = self._stuck_with(address, timeout)
            try:
                async with asyncio.timeout(timeout):
                    await self._go.wait()
                    await asyncio.sleep(self.link.stretch)
            except TimeoutError:
                # The transfer has begun: nobody waits for it, but the chip will see it.
                self._begun = lambda: function(link, *args)
                self.executor.stuck_since = loop.time()
                if self._go.is_set():
                    loop.call_later(max(0.0, self.link.stretch - timeout), self._finish)
                raise self.failed(stuck) from None
            return await make()

    def _finish(self) -> None:
        """Make the transfer that had begun, too late for who asked for it."""
        begun, self._begun = self._begun, None
        if begun is not None:
            with contextlib.suppress(OSError):
                begun()
            self.executor.stuck_since = None
