"""How futures are settled that may be done already, or that nobody may look at."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from typing import Any

from esair.exceptions import describe


def wake(*futures: asyncio.Future[None] | None) -> None:
    """Let those go on who still wait for some futures."""
    for future in futures:
        if future is not None and not future.done():
            future.set_result(None)


def wake_one(futures: Iterable[asyncio.Future[None]]) -> None:
    """Let the first go on who still waits."""
    for future in futures:
        if not future.done():
            future.set_result(None)
            return


def fail(future: asyncio.Future[Any] | None, error: BaseException) -> None:
    """Give who still waits an error; who waits may be cancelled in this moment."""
    if future is not None and not future.done():
        future.set_exception(error)
        future.exception()


def settle(
    future: asyncio.Future[Any], value: Any, error: BaseException | None
) -> None:
    """Give who still waits a value, or an error if there is one."""
    if future.done():
        return
    if error is None:
        future.set_result(value)
    else:
        future.set_exception(error)


def raisable(error: BaseException, who: str = "it") -> Exception:
    """Make an error that may be raised in any task of what somebody has raised."""
    if isinstance(error, Exception) and not isinstance(error, StopIteration):
        return error  # a future takes everything but a StopIteration
    wrapped = RuntimeError(f"{who} raised {describe(error)}")
    wrapped.__cause__ = error
    return wrapped


def ignore(*_: object) -> None:
    """Take no notice: what a hook is that nobody has set."""


def look_at(ended: asyncio.Future[Any]) -> None:
    """Look at an error whose cause has nobody any more who would."""
    if not ended.cancelled():
        ended.exception()


def has_come(future: asyncio.Future[Any]) -> bool:
    """Tell whether what was waited for is there: a cancellation came too late."""
    return future.done() and not future.cancelled() and future.exception() is None
