"""Opening and closing what blocks, in a thread: nothing stays open that nobody has."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable
from typing import TypeVar

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
