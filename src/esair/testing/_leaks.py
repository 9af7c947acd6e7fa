"""Leak checks: what a test started must be gone when it ends."""

from __future__ import annotations

import asyncio
import os
import threading
import time


class Leaks:
    """Compares tasks, threads and descriptors with those from before.

    Args:
        loop: Whose tasks; the running one's unless given.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop | None = None) -> None:
        self._tasks = asyncio.all_tasks(loop)
        self._threads = set(threading.enumerate())
        self._descriptors = _descriptors()

    async def check(self, patience: float = 1.0) -> list[str]:
        """Return what is left, after what is ending has ended.

        Args:
            patience: How long to wait for threads to end, and for files that one of
                them has open just now, in real seconds.
        """
        if self._new_threads():
            await self._let_tasks_end()  # a thread may wait for one
            self._join(patience)
        await asyncio.sleep(0)  # what a thread has told the loop at its end
        found = [f"task {task!r}" for task in await self._let_tasks_end()]
        return found + self.check_process(patience)

    def check_process(self, patience: float = 1.0) -> list[str]:
        """Return what is left beside tasks; no loop has to run. See `check`."""
        self._join(patience)
        found = [f"thread {thread.name!r}" for thread in self._new_threads()]
        return found + self._new_descriptors(patience)

    def _join(self, patience: float) -> None:
        for thread in self._new_threads():
            _join(thread, patience)

    async def _let_tasks_end(self) -> list[asyncio.Task[object]]:
        """Give tasks some turns to end; return those that have not."""
        for _ in range(20):
            if not (left := self._new_tasks()):
                break
            await asyncio.sleep(0)
        return left and self._new_tasks()

    def _new_tasks(self) -> list[asyncio.Task[object]]:
        mine = asyncio.current_task()
        tasks = asyncio.all_tasks() - self._tasks
        return sorted((t for t in tasks if t is not mine), key=lambda t: t.get_name())

    def _new_threads(self) -> list[threading.Thread]:
        return [
            thread
            for thread in threading.enumerate()
            if thread not in self._threads and not thread.name.startswith("asyncio_")
        ]

    def _new_descriptors(self, patience: float) -> list[str]:
        give_up = time.monotonic() + patience
        while left := [
            f"descriptor {number} -> {target}"
            for number, target in _descriptors().items()
            if self._descriptors.get(number) != target
        ]:
            if time.monotonic() > give_up:
                break
            time.sleep(0.001)
        return left


def _join(thread: threading.Thread, patience: float) -> None:
    give_up = time.monotonic() + patience
    while (left := give_up - time.monotonic()) > 0:
        try:
            thread.join(left)
            break
        except RuntimeError:  # another thread is just about to start it
            time.sleep(0.001)


def _descriptors() -> dict[int, str]:
    found: dict[int, str] = {}
    try:
        numbers = os.listdir("/proc/self/fd")
    except OSError:
        return found  # not Linux
    for number in numbers:
        try:
            found[int(number)] = os.readlink(f"/proc/self/fd/{number}")
        except OSError:
            continue  # the descriptor of the listing itself
    return found
