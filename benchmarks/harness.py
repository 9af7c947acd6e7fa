"""How things are measured: the operation and its limit in neighboring blocks."""

from __future__ import annotations

import asyncio
import statistics
import time
from collections.abc import Awaitable, Callable
from pathlib import Path

import attrs

ROUNDS = 9

smoke = False
"""Everything once, and short: it shows that each case works, and measures nothing."""

ros_python: Path | None = None
"""A Python with rclpy, if there is one."""


@attrs.frozen
class Row:
    """One line of the table.

    Attributes:
        case: The goal's number and what was measured.
        esair: What esair took, with its unit.
        limit: What the limit took, with its unit.
        ratio: esair divided by the limit.
        goal: The greatest ratio that meets the goal; None for a row of information.
        note: What one should know.
    """

    case: str
    esair: str
    limit: str
    ratio: float
    goal: float | None
    note: str = ""
    absolute: bool = False
    """An allowance that does not depend on the ratio is kept."""

    @property
    def met(self) -> str:
        if self.goal is None:
            return ""
        return "yes" if self.ratio <= self.goal or self.absolute else "NO"


async def neighbors(
    operation: Callable[[], Awaitable[float]],
    limit: Callable[[], Awaitable[float]],
    rounds: int = ROUNDS,
) -> tuple[float, float, float]:
    """Measure two things in turn; return the median of each and of their ratios."""
    mine, other, ratios = [], [], []
    if not smoke:
        await operation()
        await limit()
    for _ in range(1 if smoke else rounds):
        a = await operation()
        b = await limit()
        mine.append(a)
        other.append(b)
        ratios.append(a / b)
    return statistics.median(mine), statistics.median(other), statistics.median(ratios)


async def future_round_trip(count: int = 4000) -> float:
    """F: one request and its answer between two tasks by bare futures, in seconds."""
    loop = asyncio.get_running_loop()
    request: asyncio.Future[asyncio.Future[int]] = loop.create_future()

    async def serve() -> None:
        nonlocal request
        while True:
            answer = await request
            request = loop.create_future()
            answer.set_result(1)

    server = asyncio.create_task(serve())
    await asyncio.sleep(0)
    begin = time.perf_counter()
    for _ in range(count):
        answer: asyncio.Future[int] = loop.create_future()
        request.set_result(answer)
        await answer
    seconds = (time.perf_counter() - begin) / count
    server.cancel()
    return seconds


def repeated(times: int) -> range:
    """Count how often a case measures what it takes the median of."""
    return range(1 if smoke else times)


async def cpu_share(seconds: float) -> float:
    """Return which part of one core this process uses during some seconds."""
    begin, cpu = time.perf_counter(), time.process_time()
    await asyncio.sleep(seconds)
    return (time.process_time() - cpu) / (time.perf_counter() - begin)


def percentile(values: list[float], share: float) -> float:
    """Return the value below which a share of the values lies."""
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, int(share * len(ordered)))]


def us(seconds: float) -> str:
    return f"{seconds * 1e6:.2f} us"


def ms(seconds: float) -> str:
    return f"{seconds * 1e3:.2f} ms"


def percent(share: float) -> str:
    return f"{share * 100:.1f} %"
