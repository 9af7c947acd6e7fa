"""What every bus promises: one owner, opened once, its loss told to all on it."""

from __future__ import annotations

import abc
import asyncio
import contextlib
import inspect
import threading
from collections.abc import Awaitable, Callable, Hashable
from typing import Any, TypeVar

import attrs

from esair.exceptions import BusyError, DeviceLostError, DriverStuckError, describe
from esair.loop import Executor, look_at, spawn, wake
from esair.values import check_name
from esair.watchdog import Outlet


@attrs.define
class BusStats:
    """What happened on a bus since it was made; counts never go back.

    Attributes:
        sent: Bytes (serial), frames (CAN) or transfers (I²C) that were sent.
        received: Bytes (serial), frames (CAN) or transfers (I²C) that came.
        errors: Operations that failed, and error frames.
        bad_frames: Messages that came damaged, too long, or not as expected.
        dropped: What came and was thrown away because nobody took it in time.
        unheard: Messages that nobody listened to.
        late: Answers that came after their request was given up.
        no_turn: Operations that were not made: the bus had no time for them.
        retries: Operations that were tried again.
        refused: Operations refused because too many waited, or obsolete when their
            turn came.
        discarded: What waited to be sent and was thrown away because it took too long.
        opened: How often the bus was opened.
        lost: How often it was lost.
        last_error: The newest error in words; empty if there was none.
    """

    sent: int = 0
    received: int = 0
    errors: int = 0
    bad_frames: int = 0
    dropped: int = 0
    unheard: int = 0
    late: int = 0
    no_turn: int = 0
    retries: int = 0
    refused: int = 0
    discarded: int = 0
    opened: int = 0
    lost: int = 0
    last_error: str = ""

    def counts(self) -> dict[str, int]:
        """Return the counters, by name."""
        return {
            name: value
            for name, value in attrs.asdict(self).items()
            if isinstance(value, int)
        }


T = TypeVar("T")
E = TypeVar("E", bound=BaseException)

LOOK_TIMEOUT = 1.0
"""How long a bus looks what is there before it opens it, in seconds."""

TURN_LIMIT = 1.0
"""How long what is asked of a bus waits for its turn, in seconds; its time begins then."""

CANCEL_TIMEOUT = 0.2
"""How long a close waits for the end of an opening that is under way, in seconds."""


class Bus(abc.ABC):
    """A wire that several devices share.

    A subclass writes ``_open`` and ``_close``, calls `lost` when the wire is gone
    and, if it can know it, `arrived` when it is there again. Everything else (opening
    once for all, reopening when a device asks for it after a loss) is here; so is
    ``_close`` called, at once, after a loss and after an opening that failed.

    A subclass that can say what is there now, without opening it, sets ``_presence``
    to a function that does: it returns None if nothing is there, and another value
    for another arrival. It blocks, and is called in threads. While the wire is gone
    and a device waits for it, `esair.discovery.watch` looks, and `arrived` is called
    as soon as something new is there. A wire that is there but cannot be opened, being
    busy, is no arrival; that its permissions have changed is one, if the value says so.

    One whose wire says nothing when it is pulled sets ``_still_there`` to a function that
    tells whether what was opened is still there. It is called while the bus is open, as
    often as that, and the bus is `lost` as soon as it says no.

    Args:
        name: The name of the bus in errors, threads and the configuration.
        wire: What is opened instead of a port of the computer.
    """

    _presence: Callable[[], Hashable | None] | None = None
    _still_there: Callable[[], bool] | None = None

    def __init__(self, *, name: str, wire: Wire | None = None) -> None:
        self.name: str = check_name("bus", name)
        self._wire = wire
        self.is_open: bool = False
        self.error: BaseException | None = None
        """Why the bus is not open; None if it is, or has not been tried."""
        self.stats: BusStats = BusStats()
        """What happened on the bus since it was made."""
        self.executor: Executor = Executor(name)
        """The thread for blocking calls of the devices on this bus."""
        self._opening: asyncio.Task[None] | None = None
        self._closing: asyncio.Future[None] | None = None
        self._letting_go: asyncio.Task[None] | None = None
        self.shared: dict[type, dict[Any, Any]] = {}
        """What devices on the bus share, by its kind and a key of theirs."""
        self._on_lost: list[Callable[[BaseException], None]] = []
        self._on_arrival: list[Callable[[], None]] = []
        self._waits: list[asyncio.Timeout] = []
        """What waits for something that the wire brings; it ends with that."""
        self._seen_first: Hashable | None = None
        """What was there before the newest opening."""
        self._is_missed = False
        """Whether it is to be opened again: it was lost, or could not be opened."""
        self._end_of_watch: Callable[[], None] | None = None
        self._watched: Callable[[], None] | None = None
        """What is called when what is looked out for happens."""

    def adopt(self, part: Any) -> None:
        """Have a part that was made for another bus of this name."""
        part.bus = self

    @property
    def outlet(self) -> Outlet | None:
        """Where the watchdog sends safe frames; None if it cannot reach this bus."""
        return None

    @abc.abstractmethod
    async def _open(self) -> None:
        """Open the wire; raise `ConnectionError` or `OSError` if it is not there."""

    @abc.abstractmethod
    async def _close(self) -> None:
        """Let the wire go. Must not wait for anything that may never come."""

    async def open(self) -> None:
        """Open the bus unless it is open. All who ask at once share one opening.

        While it is closed, they wait for the end of that.

        Raises:
            DeviceLostError: The wire is not there, or the bus was closed meanwhile.
            ConfigError: Its settings are none that it can have.
        """
        while self._closing is not None:
            await asyncio.wait({self._closing})
        if self.is_open:
            return
        opening = self._opening
        if opening is None or opening.done():  # one was ended before it began
            loop = asyncio.get_running_loop()
            opening = spawn(loop, self._open_once(), name=f"open bus {self.name}")
            self._opening = opening
            opening.add_done_callback(look_at)  # who waited may be cancelled
        # Not awaited itself: if it is cancelled by a close, its callers are not.
        await asyncio.wait({opening})
        if opening.cancelled():
            raise DeviceLostError(self.name, "it was closed while it was opened")
        opening.result()

    async def _open_once(self) -> None:
        task = asyncio.current_task()
        assert task is not None
        try:
            await self._has_let_go()
            self._seen_first = await self._look_first()
            await self._open()
        except Exception as error:
            self._note(error)
            self._is_missed = not task.cancelling()
            self._let_go()
            raise
        else:
            if task.cancelling():  # a close has not waited for it any longer
                self._let_go()
                raise asyncio.CancelledError
            self.is_open = True
            self.error = None
            self._is_missed = False
            self.stats.opened += 1
        finally:
            self._opening = None
            self._keep_watch()

    async def _look_first(self) -> Hashable | None:
        """Look what is there, before it is opened: what comes later is an arrival."""
        if self._presence is None or self.executor.stuck_since is not None:
            return None
        try:
            return await self.executor.call(self._presence, timeout=LOOK_TIMEOUT)
        except Exception:  # what it cannot see is not there
            return None

    def _keep_watch(self) -> None:
        """Look out for the wire while somebody waits for it, and for its departure."""
        looks: Callable[[], Hashable | None] | None = None
        told: Callable[[], None] | None = None
        if self.is_open and self._still_there is not None:
            looks, told, seen = self._look_after, self._departed, None
        elif self._is_missed and self._on_arrival and self._presence is not None:
            looks, told, seen = self._presence, self.arrived, self._seen_first
        if told == self._watched:
            return
        self._watched = told
        end, self._end_of_watch = self._end_of_watch, None
        if end is not None:
            end()
        if looks is not None and told is not None:
            from esair.buses.finding import watch  # only when there is something to see

            # Without a thread or a descriptor left the devices still try by themselves.
            with contextlib.suppress(OSError, RuntimeError):
                self._end_of_watch = watch(looks, told, seen=seen)

    def _look_after(self) -> Hashable | None:
        assert self._still_there is not None
        return None if self._still_there() else "gone"

    def _departed(self) -> None:
        self.lost(DeviceLostError(self.name, "it was unplugged"))

    async def close(self) -> None:
        """Close the bus and end its thread. All who ask at once share one close."""
        if self._closing is not None:
            await asyncio.wait({self._closing})
            return
        self._closing = asyncio.get_running_loop().create_future()
        try:
            await self._close_once()
        except BaseException:  # who closes it may be cancelled
            self._let_go()
            raise
        finally:
            closing, self._closing = self._closing, None
            wake(closing)

    async def _close_once(self) -> None:
        opening = self._opening
        if opening is not None:
            opening.cancel()
            await asyncio.wait({opening}, timeout=CANCEL_TIMEOUT)
        self._is_missed = False
        was_open, self.is_open = self.is_open, False
        self._end_waits()
        self._keep_watch()
        await self._has_let_go()
        if was_open or opening is not None:
            await self._close()
        await self.executor.join(timeout=0.2)
        if self._wire is not None:
            await self._wire.leave(self)

    @property
    def waiting(self) -> int:
        """How much waits to be sent: bytes, frames or calls."""
        return self.executor.waiting

    def alone_at(self) -> str | None:
        """Return what no other bus can have now; None if there is no such thing. Blocks."""
        return None

    def seconds_for(self, traffic: int) -> float:
        """Return how long so many bytes of one device keep the wire; 0 if not known."""
        return 0.0

    def on_lost(self, listener: Callable[[BaseException], None]) -> Callable[[], None]:
        """Call a function when the wire is gone; returns how to stop that."""
        return listen(self._on_lost, listener)

    def on_arrival(self, listener: Callable[[], None]) -> Callable[[], None]:
        """Call a function when the wire has come back and can be opened again.

        Returns how to stop that.
        """
        forget = listen(self._on_arrival, listener)
        self._keep_watch()

        def forget_and_rest() -> None:
            forget()
            self._keep_watch()

        return forget_and_rest

    def lost(self, error: BaseException) -> None:
        """Tell everybody on the bus, once, that the wire is gone. In the event loop."""
        if not self.is_open:
            return
        self.is_open = False
        self._is_missed = True
        self.stats.lost += 1
        self._note(error)
        self._keep_watch()
        self._tell(self._on_lost, error)
        self._end_waits()
        self._let_go()

    async def wait_for(self, coming: Awaitable[T], timeout: float | None = None) -> T:
        """Wait for something that the wire brings; the wait ends with the wire.

        Args:
            coming: What is waited for, such as an event that a listener sets.
            timeout: How long to wait, in seconds; as long as the wire is there if None.

        Raises:
            DeviceLostError: The wire is gone, or was closed.
            DriverStuckError: It has not come in time.
        """
        if not self.is_open:
            if inspect.iscoroutine(coming):
                coming.close()
            raise DeviceLostError(self.name, "the bus is not open")
        waiting = asyncio.timeout(timeout)
        self._waits.append(waiting)
        try:
            async with waiting:
                return await coming
        except TimeoutError:
            if self.is_open and waiting.expired():
                raise DriverStuckError(self.name, "wait", timeout or 0.0) from None
            if not waiting.expired():
                raise
            why = describe(self.error) if self.error is not None else "it was closed"
            raise DeviceLostError(self.name, why) from None
        finally:
            self._waits.remove(waiting)

    def _end_waits(self) -> None:
        for waiting in self._waits:
            if not waiting.expired():
                waiting.reschedule(0.0)

    def _let_go(self) -> None:
        """Close what is left: an open file would keep its number from who returns."""
        self._letting_go = spawn(  # nobody's: it does not end with who met the loss
            asyncio.get_running_loop(),
            self._close_what_is_gone(),
            name=f"let go {self.name}",
        )

    async def _close_what_is_gone(self) -> None:
        try:
            await self._close()
        except Exception as error:  # it is gone anyway
            self.stats.last_error = describe(error)

    async def _has_let_go(self) -> None:
        while (task := self._letting_go) is not None:
            await asyncio.wait({task})
            if task is self._letting_go:
                self._letting_go = None

    def arrived(self) -> None:
        """Tell everybody that the wire is there again; nothing is opened by that."""
        if not self.is_open:
            self._tell(self._on_arrival)

    def _tell(self, listeners: list[Callable[..., None]], *news: object) -> None:
        """Tell all, also those behind one that fails: nobody's loss is another's."""
        for listener in tuple(listeners):
            try:
                listener(*news)
            except Exception as error:
                told = f"a listener of bus {self.name} failed"
                asyncio.get_running_loop().call_exception_handler(
                    {"message": told, "exception": error}
                )

    async def _far_end(self, wire: Wire) -> Any:
        """Return what is at the far end now, which tells of its arrivals from then on."""
        far_end = await wire.join(self)
        far_end.on_plug(self.arrived)
        return far_end

    def loss(self, error: BaseException) -> DeviceLostError:
        """Return an error as the loss of the bus that it is."""
        if isinstance(error, DeviceLostError):
            return error
        loss = DeviceLostError(self.name, describe(error))
        loss.__cause__ = error
        return loss

    def failed(self, error: E) -> E:
        """Count an error of the bus, and return it to be raised."""
        self.stats.errors += 1
        self.stats.last_error = describe(error)
        return error

    def _note(self, error: BaseException) -> None:
        self.error = self.failed(error)

    def __repr__(self) -> str:
        state = "open" if self.is_open else "closed"
        if self.error is not None:
            state = describe(self.error)
        return f"<{type(self).__name__} {self.name!r} {state}>"


def wanted() -> bool:
    """Guard a call that is not to be made once nobody waits for it any more.

    An executor asks only guarded calls whether that is so: a close is made in any case.
    """
    return True


def listen(listeners: list[T], listener: T) -> Callable[[], None]:
    """Add a listener; returns how to stop that."""
    listeners.append(listener)

    def forget() -> None:
        if listener in listeners:
            listeners.remove(listener)

    return forget


class Wire:
    """The far end of a wire: memory, a pseudo-terminal, a simulation.

    A bus with ``wire=`` opens that and nothing else. A subclass has the method
    ``open`` that its medium asks for: `SerialWire`, `CanWire`, or for I²C and SPI a
    plain one that returns the link. As the kernel does, it tells of an arrival.
    """

    def __init__(self) -> None:
        self._on_plug: dict[Callable[[], None], None] = {}

    async def join(self, bus: Bus) -> Any:
        """Return the wire that a bus opens now; a simulation starts one first."""
        return self

    async def leave(self, bus: Bus) -> None:
        """Be told that a bus was closed."""

    def on_plug(self, listener: Callable[[], None]) -> None:
        """Call a function whenever the plug is in again."""
        self._on_plug[listener] = None

    def _tell_plugged(self) -> None:
        for listener in tuple(self._on_plug):
            listener()


class LateWire(Wire):
    """A wire that is made, or found, when a bus opens it.

    Args:
        find: Returns the wire for a bus.
        left: Is told that a bus was closed.
    """

    def __init__(
        self,
        find: Callable[[Bus], Awaitable[Wire]],
        left: Callable[[Bus], Awaitable[None]] | None = None,
    ) -> None:
        super().__init__()
        self._find = find
        self._left = left

    async def join(self, bus: Bus) -> Wire:
        return await self._find(bus)

    async def leave(self, bus: Bus) -> None:
        if self._left is not None:
            await self._left(bus)


async def open_on(
    executor: Executor,
    make: Callable[[], T],
    shut: Callable[[T], object],
    *,
    timeout: float,
) -> T:
    """Open something on an executor; nothing stays open that nobody waits for any more.

    Args:
        executor: The thread to do it in.
        make: Opens it; blocks.
        shut: Closes it; may block, and is called in a thread.
        timeout: How long it may take, in seconds.

    Raises:
        BusyError: Too many calls wait.
        DriverStuckError: It took too long.
    """
    lock = threading.Lock()
    opened: list[T] = []
    is_abandoned = False

    def work() -> T:
        made = make()
        with lock:
            opened.append(made)
            is_nobodys = is_abandoned
        if is_nobodys:
            shut(made)
        return made

    try:
        return await executor.call(work, timeout=timeout)
    except BaseException:
        with lock:
            is_abandoned = True
        for each in opened:  # open, and its caller was gone by then
            threading.Thread(target=shut, args=(each,), daemon=True).start()
        raise


async def shut_on(
    executor: Executor, shut: Callable[[], object], *, timeout: float
) -> None:
    """Close something on an executor, behind the calls that it has.

    If one of them is stuck it is closed when that returns.

    Args:
        executor: The thread to do it in.
        shut: Closes it; may block.
        timeout: How long to wait for it, in seconds.
    """
    with contextlib.suppress(DriverStuckError, BusyError):  # no more threads
        await executor.call(shut, timeout=timeout, bounded=False)
