"""Limits of real time: they are held where nobody else needs the computer."""

from __future__ import annotations

from collections.abc import Awaitable, Callable

Lived = tuple[int, list[str], str, float]
"""What became of a process: its exit code, its log, its errors, its seconds."""

TRIES = 3

measures = False
"""Whether this run looks how long something takes: with --esair-long, or --esair-soak. Every
other run may be on a computer that does something else, and looks what happens, in which
order."""


def within(limit: float, seconds: float) -> bool:
    """Tell whether something took less than a limit in seconds, where that counts."""
    return seconds < limit or not measures


async def in_time(limit: float, live: Callable[[], Awaitable[Lived]]) -> Lived:
    """Run a process; again if it took longer than a limit in seconds, twice at most.

    Other work makes it late some time, a defect each time.
    """
    for _ in range(TRIES):
        lived = await live()
        if within(limit, lived[-1]):
            break
    return lived
