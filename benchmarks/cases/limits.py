"""The limits: the least that anybody could do, without a single check."""

from __future__ import annotations

import asyncio
import contextlib
import os
import time
from collections.abc import AsyncIterator, Callable

from esair.loop._turn import timerfd

Step = Callable[[float], None]


@contextlib.asynccontextmanager
async def sleeping_tasks(count: int, period: float) -> AsyncIterator[list[float]]:
    """Tasks that sleep until they are due; yields how late each wake-up was."""
    late: list[float] = []

    async def tick() -> None:
        due = time.monotonic()
        while True:
            due += period
            await asyncio.sleep(due - time.monotonic())
            late.append(time.monotonic() - due)

    tasks = [asyncio.create_task(tick()) for _ in range(count)]
    try:
        yield late
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


@contextlib.asynccontextmanager
async def bare_wheel(steps: list[Step], period: float) -> AsyncIterator[None]:
    """Functions that one timerfd calls, spread over four phases of the period."""
    loop = asyncio.get_running_loop()
    phases = [steps[number::4] for number in range(4)] if len(steps) > 4 else [steps]
    begin = time.monotonic() + 0.01
    turn = 0

    def due() -> float:
        return begin + turn * period / len(phases)

    def call() -> None:
        nonlocal turn
        now = due()
        for step in phases[turn % len(phases)]:
            step(now)
        while due() <= time.monotonic():
            turn += 1
        settime(round(1e9 * due()))

    def expired() -> None:
        os.read(timer, 8)
        call()

    timer, settime = timerfd()
    loop.add_reader(timer, expired)
    settime(round(1e9 * begin))
    try:
        yield
    finally:
        loop.remove_reader(timer)
        os.close(timer)
