"""What a thread has done for it in the loop, while it waits."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from typing import Any, TypeVar

T = TypeVar("T")


async def in_loop(function: Callable[..., T], *args: Any, **options: Any) -> T:
    """Call a plain function where it belongs: in the loop."""
    return function(*args, **options)


async def forever() -> None:
    """Wait until it is cancelled."""
    await asyncio.get_running_loop().create_future()


async def next_of(values: AsyncIterator[T]) -> T:
    return await anext(values)
