"""Run a coroutine's first step without a task, and the rest under a deadline.

Most driver calls end in their first step: a frame is handed to a socket and that
is all. For those a task, a timer or a cancel scope would cost several times the
call itself, so nothing is armed until a wait really begins.
"""

from __future__ import annotations

import asyncio
import types
from collections.abc import Coroutine, Generator
from typing import Any, NamedTuple, TypeVar

from esair.loop._deadlines import Deadlines

T = TypeVar("T")


class Suspended(NamedTuple):
    """A coroutine that waits for something; hand it to `finish` in the same task."""

    coroutine: Coroutine[Any, Any, Any]
    waits_for: Any


def first_step(coroutine: Coroutine[Any, Any, T]) -> T | Suspended:
    """Run a coroutine to its end or to its first wait, in the current task.

    Returns:
        Its result, or a `Suspended` that the current task must `finish`.
    """
    try:
        return Suspended(coroutine, coroutine.send(None))
    except StopIteration as stop:
        result: T = stop.value
        return result


@types.coroutine
def finish(suspended: Suspended, seconds: float) -> Generator[Any, Any, Any]:
    """Run a suspended coroutine to its end, in the task that began it.

    It is cancelled when the time is over, as `asyncio.timeout` does it.

    Raises:
        TimeoutError: It did not end in time.
    """
    coroutine, waits_for = suspended
    loop = asyncio.get_running_loop()
    task = asyncio.current_task()
    assert task is not None
    expired = False
    before = task.cancelling()

    def expire() -> None:
        nonlocal expired
        expired = True
        task.cancel()

    deadline = Deadlines.of(loop).after(seconds, expire)
    try:
        while True:
            try:
                sent = yield waits_for
            except BaseException as error:  # all of it is the coroutine's
                waits_for = coroutine.throw(error)
            else:
                waits_for = coroutine.send(sent)
    except StopIteration as stop:
        if expired:
            task.uncancel()
        return stop.value
    except asyncio.CancelledError:
        if expired and task.uncancel() <= before:
            raise TimeoutError from None
        raise
    except BaseException:
        if expired:
            task.uncancel()
        raise
    finally:
        deadline.cancel()
