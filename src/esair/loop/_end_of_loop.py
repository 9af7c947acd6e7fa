"""Runs a coroutine in a new event loop, and ends that loop whatever is left in it."""

from __future__ import annotations

import asyncio
import logging
import threading
import time
from collections.abc import Callable, Coroutine, Iterable
from typing import Any

PATIENCE = 0.3
"""How long the end of a loop waits for tasks that are left in it, in seconds."""

THREADS_PATIENCE = 0.1
"""How long the end of the process waits for threads that are about to end, in seconds."""

_log = logging.getLogger("esair")


def run_and_end(
    work: Coroutine[Any, Any, None],
    loop_factory: Callable[[], asyncio.AbstractEventLoop] | None,
) -> None:
    """Do what `asyncio.run` does, but do not wait for ever for tasks and threads."""
    loop = asyncio.new_event_loop() if loop_factory is None else loop_factory()
    asyncio.set_event_loop(loop)
    try:
        loop.run_until_complete(loop.create_task(work))
    finally:
        try:
            _end_tasks(loop)
        finally:
            asyncio.set_event_loop(None)
            loop.close()  # threads of run_in_executor are not waited for


def _end_tasks(loop: asyncio.AbstractEventLoop) -> None:
    left = asyncio.all_tasks(loop)
    for task in left:
        task.cancel()
    if left:
        loop.run_until_complete(asyncio.wait(left, timeout=PATIENCE))
    leave_behind([task for task in left if not task.done()])
    for task in left:
        if task.done() and not task.cancelled() and (error := task.exception()):
            _log.warning("%s: it ended with %r", task.get_name(), error)
    generators = loop.create_task(loop.shutdown_asyncgens())
    loop.run_until_complete(asyncio.wait({generators}, timeout=PATIENCE))


def leave_behind(tasks: Iterable[asyncio.Task[Any]]) -> None:
    """Have nobody wait for tasks that would not end.

    Who ends an event loop cancels all of its tasks and waits for them, `asyncio.run` for
    ever: it must not find these.
    """
    names = []
    for task in tasks:
        names.append(task.get_name())
        _keep_for_ever(task)
        asyncio._unregister_task(task)  # noqa: SLF001 - documented for other kinds of tasks
    if names:
        _log.warning("left behind, they would not end: %s", ", ".join(sorted(names)))


def _keep_for_ever(task: asyncio.Task[Any]) -> None:
    """Never let a task be collected, not even at the interpreter's end.

    Its coroutine would be closed then, which runs its code once more; without a loop
    each await of it raises, and what swallows that in a loop does not end.
    """
    import ctypes  # only when a task would not end

    ctypes.pythonapi.Py_IncRef(ctypes.py_object(task))


def threads_that_keep_the_process(before: set[threading.Thread]) -> list[str]:
    """Name new threads for whose end the interpreter waits at its own.

    Those that have nothing more to do are given the moment that they need to end.
    """
    new = [
        thread
        for thread in threading.enumerate()
        if thread not in before and not thread.daemon
    ]
    until = time.monotonic() + THREADS_PATIENCE
    for thread in new:
        thread.join(max(0.0, until - time.monotonic()))
    return sorted(thread.name for thread in new if thread.is_alive())
