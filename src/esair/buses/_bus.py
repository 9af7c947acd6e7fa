"""What every bus promises: one owner, opened once, its loss told to all on it."""

from __future__ import annotations

import abc
import asyncio
from collections.abc import Callable
from typing import TypeVar

from esair.buses._stats import BusStats
from esair.exceptions import describe
from esair.loop import Lane
from esair.messages import check_name

T = TypeVar("T")


class Bus(abc.ABC):
    """A wire that several devices share.

    A subclass writes ``_open`` and ``_close``, calls `lost` when the wire is gone
    and, if it can know it, `arrived` when it is there again. Everything else (opening
    once for all, reopening when a device asks for it after a loss) is here.

    Args:
        name: The name of the bus in errors, threads and the configuration.
    """

    def __init__(self, *, name: str) -> None:
        self.name = check_name("bus", name)
        self.is_open = False
        self.error: BaseException | None = None
        """Why the bus is not open; None if it is, or has not been tried."""
        self.stats = BusStats()
        """What happened on the bus since it was made."""
        self.lane = Lane(name)
        """The thread for blocking calls of the devices on this bus."""
        self._opening: asyncio.Task[None] | None = None
        self._on_lost: list[Callable[[BaseException], None]] = []
        self._on_arrival: list[Callable[[], None]] = []

    @abc.abstractmethod
    async def _open(self) -> None:
        """Open the wire; raise `ConnectionError` or `OSError` if it is not there."""

    @abc.abstractmethod
    async def _close(self) -> None:
        """Let the wire go. Must not wait for anything that may never come."""

    async def open(self) -> None:
        """Open the bus unless it is open. All who ask at once share one opening."""
        if self.is_open:
            return
        if self._opening is None:
            self._opening = asyncio.get_running_loop().create_task(
                self._open_once(), name=f"open bus {self.name}"
            )
        await asyncio.shield(self._opening)

    async def _open_once(self) -> None:
        try:
            await self._open()
        except Exception as error:
            self._note(error)
            raise
        else:
            self.is_open = True
            self.error = None
            self.stats.opened += 1
        finally:
            self._opening = None

    async def close(self) -> None:
        """Close the bus and end its thread."""
        if self._opening is not None:
            self._opening.cancel()
        was_open, self.is_open = self.is_open, False
        if was_open or self.error is not None:
            await self._close()
        await self.lane.join(timeout=0.2)

    @property
    def waiting(self) -> int:
        """How much waits to be sent: bytes, frames or calls."""
        return self.lane.waiting

    def on_lost(self, listener: Callable[[BaseException], None]) -> Callable[[], None]:
        """Call a function when the wire is gone; returns how to stop that."""
        return _listen(self._on_lost, listener)

    def on_arrival(self, listener: Callable[[], None]) -> Callable[[], None]:
        """Call a function when the wire has come back and can be opened again.

        Returns how to stop that.
        """
        return _listen(self._on_arrival, listener)

    def lost(self, error: BaseException) -> None:
        """Tell everybody on the bus, once, that the wire is gone."""
        if not self.is_open:
            return
        self.is_open = False
        self.stats.lost += 1
        self._note(error)
        for listener in tuple(self._on_lost):
            listener(error)

    def arrived(self) -> None:
        """Tell everybody that the wire is there again; nothing is opened by that."""
        if self.is_open:
            return
        for listener in tuple(self._on_arrival):
            listener()

    def _note(self, error: BaseException) -> None:
        self.error = error
        self.stats.errors += 1
        self.stats.last_error = describe(error)

    def __repr__(self) -> str:
        state = "open" if self.is_open else "closed"
        if self.error is not None:
            state = describe(self.error)
        return f"<{type(self).__name__} {self.name!r} {state}>"


def _listen(listeners: list[T], listener: T) -> Callable[[], None]:
    listeners.append(listener)

    def forget() -> None:
        if listener in listeners:
            listeners.remove(listener)

    return forget
