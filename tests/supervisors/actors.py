"""The behaviors and helpers that tests of the supervisors share."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable
from typing import Any

import pytest

import esair
from esair.testing import FakeActuator

seeds = [pytest.param(n, marks=pytest.mark.virtual_clock(seed=n)) for n in range(6)]


State = esair.BehaviorState


class Idle(esair.Behavior):
    """Does nothing: tests act in its name."""


class Ticker(esair.Behavior):
    """Notes when it runs, a hundred times a second."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.ticks: list[float] = []

    async def run(self) -> None:
        async for _ in esair.every(0.01):
            self.ticks.append(asyncio.get_running_loop().time())

    def missed(self) -> int:
        gaps = zip(self.ticks, self.ticks[1:], strict=False)
        return sum(abs(after - before - 0.01) > 1e-6 for before, after in gaps)


class Driver(esair.Behavior):
    """Writes its speed all the time."""

    wheels = esair.writes(float)
    speed = 1.0

    async def run(self) -> None:
        async for _ in esair.every(0.05):
            await self.wheels.write(self.speed)


class Scripted(esair.Behavior):
    """Runs functions that a test gives it."""

    def __init__(
        self,
        run: Callable[[esair.Behavior], Awaitable[None]],
        *,
        setup: Callable[[esair.Behavior], Awaitable[None]] | None = None,
        teardown: Callable[[esair.Behavior], Awaitable[None]] | None = None,
        restart: esair.Restart | None = None,
        **options: Any,
    ) -> None:
        super().__init__(**options)
        self._script = {"run": run, "setup": setup, "teardown": teardown}
        self.begun: list[float] = []
        if restart is not None:
            self.restart = restart

    async def _do(self, what: str) -> None:
        script = self._script[what]
        if script is not None:
            await script(self)

    async def setup(self) -> None:
        await self._do("setup")

    async def run(self) -> None:
        self.begun.append(asyncio.get_running_loop().time())
        await self._do("run")

    async def teardown(self) -> None:
        await self._do("teardown")


def wheels(**options: Any) -> FakeActuator[float]:
    return FakeActuator("wheels", safe=0.0, **options)


async def turns(count: int = 5) -> None:
    """Let the loop turn a few times."""
    for _ in range(count):
        await asyncio.sleep(0)


async def soon(work: Any) -> asyncio.Task[Any]:
    """Start a request and let it begin to wait."""
    task: asyncio.Task[Any] = asyncio.ensure_future(work)
    await turns()
    return task


async def for_ever(_behavior: object = None) -> None:
    await asyncio.get_running_loop().create_future()


async def swallow(_behavior: object = None) -> None:
    """Ignore every cancellation for a minute."""
    end = asyncio.get_running_loop().time() + 60.0
    while asyncio.get_running_loop().time() < end:
        with contextlib.suppress(asyncio.CancelledError):
            await asyncio.sleep(60.0)


def raises(error: BaseException) -> Callable[[object], Awaitable[None]]:
    async def script(_behavior: object) -> None:
        raise error

    return script


def registered(robot: esair.Robot) -> dict[str, int]:
    found: dict[str, int] = {}
    for registration in robot._resources.registrations:
        found[registration.behavior] = found.get(registration.behavior, 0) + 1
    return found


async def raises_nothing(_behavior: object) -> None:
    """Return at once."""
