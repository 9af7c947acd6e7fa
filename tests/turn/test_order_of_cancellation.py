"""Task groups cancel their tasks in the order of a set: it is no matter of addresses."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any

import anyio
import pytest

import esair
from esair.testing import VirtualLoop

pytestmark = [pytest.mark.real_clock, pytest.mark.promise("TURN-6", "REP-2")]

TASKS = 8


async def in_asyncio(work: Callable[[int], Coroutine[Any, Any, None]]) -> None:
    async def one(number: int) -> None:
        await work(number)

    async with asyncio.TaskGroup() as group:
        for number in range(TASKS):
            group.create_task(one(number))


async def in_anyio(work: Callable[[int], Coroutine[Any, Any, None]]) -> None:
    async with anyio.create_task_group() as group:
        for number in range(TASKS):
            group.start_soon(work, number)


def cancelled(group: Any) -> list[int]:
    """Return in which order the tasks of a behavior hear that they are to end."""
    heard: list[int] = []

    async def work(number: int) -> None:
        try:
            await asyncio.sleep(100.0)
        except asyncio.CancelledError:
            heard.append(number)
            raise

    class Groups(esair.Behavior):
        async def run(self) -> None:
            await group(work)

    async def main() -> None:
        async with esair.Robot(behaviors=[Groups()]):
            await asyncio.sleep(0.1)

    with asyncio.Runner(loop_factory=VirtualLoop) as runner:
        runner.run(main())
    return heard


@pytest.mark.parametrize("group", [in_asyncio, in_anyio])
def test_it_is_the_same_in_each_run(group: Any) -> None:
    """Whatever lies in memory: here more of it each time."""
    rubbish: list[Any] = []
    orders = set()
    for count in range(12):
        rubbish += [bytearray(97 * number) for number in range(count)]
        orders.add(tuple(cancelled(group)))
        rubbish = rubbish[::2]
    assert len(orders) == 1
    assert set(*orders) == set(range(TASKS))
