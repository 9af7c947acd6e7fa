"""Opening and closing what blocks, in a thread: nothing stays open that nobody has."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable
from typing import Generic, TypeVar

from esair.exceptions import BusyError, DriverStuckError
from esair.loop import Executor

T = TypeVar("T")


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
    opening = Opening(make, shut)
    try:
        return await executor.call(opening.open, timeout=timeout)
    except BaseException:
        opening.abandon()
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


class Opening(Generic[T]):
    """One attempt to open something, in a thread that cannot be stopped."""

    def __init__(self, make: Callable[[], T], shut: Callable[[T], object]) -> None:
        self._make = make
        self._shut = shut
        self._lock = threading.Lock()
        self._abandoned = False
        self._opened: list[T] = []

    def open(self) -> T:
        """Open it, in the thread; close it again if nobody waits for it by then."""
        opened = self._make()
        with self._lock:
            self._opened.append(opened)
            abandoned = self._abandoned
        if abandoned:
            self._shut(opened)
        return opened

    def abandon(self) -> None:
        """Have it closed, as soon as it is open. Never blocks."""
        with self._lock:
            self._abandoned = True
            opened = tuple(self._opened)
        for each in opened:  # open, and its caller was gone by then
            threading.Thread(target=self._shut, args=(each,), daemon=True).start()
