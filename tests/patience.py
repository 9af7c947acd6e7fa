"""Limits of real time that hold on a busy computer too."""

from __future__ import annotations

from collections.abc import Awaitable, Callable

Lived = tuple[int, list[str], str, float]
"""What became of a process: its exit code, its log, its errors, its seconds."""

TRIES = 3


async def in_time(limit: float, live: Callable[[], Awaitable[Lived]]) -> Lived:
    """Run a process; again if it took longer than a limit in seconds, twice at most.

    Other work makes it late some time, a defect each time.
    """
    for _ in range(TRIES):
        lived = await live()
        if lived[-1] < limit:
            break
    return lived
