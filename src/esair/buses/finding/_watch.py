"""Noticing that a device is there again: one thread for all that are waited for."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections.abc import Callable, Hashable

from esair.buses.finding._wakes import Wakes

PERIOD = 0.25
"""How long a device is overlooked that udev says nothing about, in seconds."""


def watch(
    presence: Callable[[], Hashable | None],
    arrived: Callable[[], None],
    *,
    seen: Hashable | None = None,
) -> Callable[[], None]:
    """Have a function called whenever something has come that was not there.

    To be called in an event loop. While anybody waits there is one thread; it looks
    when udev has news and four times a second, and ends when nobody waits.

    Args:
        presence: Says what is there now, None if nothing is; another value is another
            arrival. Called in the thread: it may block, but holds up all others that
            wait. What it raises counts as nothing being there.
        arrived: Called in the event loop.
        seen: What was there before; that it is still there is no arrival.

    Returns:
        How to stop waiting. After that ``arrived`` is not called.
    """
    loop = asyncio.get_running_loop()
    waiting = _Waiting(loop, presence, arrived, seen)
    with _lock:
        watcher = _watchers.get(loop) or _Watcher(loop)
        watcher.add(waiting)

    def forget() -> None:
        waiting.over = True
        with _lock:
            watcher.remove(waiting)

    return forget


class _Waiting:
    """One thing that is waited for."""

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        presence: Callable[[], Hashable | None],
        arrived: Callable[[], None],
        seen: Hashable | None,
    ) -> None:
        self.over = False
        self._loop = loop
        self._presence = presence
        self._arrived = arrived
        self._seen = seen

    def look(self) -> None:
        """Look whether it has come. In the thread."""
        try:
            now = self._presence()
        except Exception:  # whatever it cannot see is not there
            now = None
        before, self._seen = self._seen, now
        if now is not None and now != before:
            with contextlib.suppress(RuntimeError):  # the loop is closed
                self._loop.call_soon_threadsafe(self._tell)

    def _tell(self) -> None:
        if not self.over:
            self._arrived()


class _Watcher:
    """The thread of one event loop; all but the looking is done under the lock."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._all: list[_Waiting] = []
        self._wakes: Wakes | None = None

    def add(self, waiting: _Waiting) -> None:
        if self._wakes is None:
            self._wakes = Wakes()
            _watchers[self._loop] = self
            try:
                threading.Thread(
                    target=self._work,
                    args=(self._wakes,),
                    name="esair-hotplug",
                    daemon=True,
                ).start()
            except BaseException:  # no more threads: nothing is half made
                self._end()
                raise
        else:
            self._wakes.wake()
        self._all.append(waiting)  # the thread waits for the lock to see it

    def remove(self, waiting: _Waiting) -> None:
        if waiting in self._all:
            self._all.remove(waiting)
        if not self._all and self._wakes is not None:
            self._wakes.wake()

    def _work(self, wakes: Wakes) -> None:
        try:
            wakes.listen()
            while self._has_work():
                for waiting in self._all.copy():
                    if not waiting.over:
                        waiting.look()
                wakes.wait(PERIOD)
        finally:
            with _lock:
                self._end()

    def _has_work(self) -> bool:
        """Return whether anybody waits; if nobody does it is the end, at once."""
        with _lock:
            if not self._all or self._loop.is_closed():
                self._end()
                return False
            return True

    def _end(self) -> None:
        if self._wakes is not None:
            del _watchers[self._loop]
            self._all.clear()
            self._wakes.close()
            self._wakes = None


_lock = threading.Lock()
_watchers: dict[asyncio.AbstractEventLoop, _Watcher] = {}
