"""The rest of a coroutine under a deadline, as `asyncio.timeout` would have it."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from esair.loop import Suspended, finish, first_step
from esair.testing._clock import VirtualLoop

Limit = Callable[[float, Callable[[], Awaitable[object]]], Awaitable[object]]


async def ours(seconds: float, work: Callable[[], Awaitable[object]]) -> object:
    async def begun() -> object:
        return await work()

    step = first_step(begun())
    if type(step) is Suspended:
        return await finish(step, seconds)
    return step


async def theirs(seconds: float, work: Callable[[], Awaitable[object]]) -> object:
    async with asyncio.timeout(seconds):
        return await work()


MOMENTS = st.sampled_from([0.25, 0.5, 0.75, 1.0])
ENDS = st.sampled_from(["returns", "raises", "passes it on"])


async def outcome(
    limit: Limit,
    limits: list[float],
    takes: float,
    at_a_cancel: str,
    cleanup: float,
    cancelled_at: float | None,
) -> tuple[object, int, float]:
    """What comes of some work within some limits, and when."""
    loop = asyncio.get_running_loop()
    begin = loop.time()

    async def work() -> object:
        try:
            await asyncio.sleep(takes)
        except asyncio.CancelledError:
            if cleanup:
                await asyncio.sleep(cleanup)
            if at_a_cancel == "returns":
                return "swallowed"
            if at_a_cancel == "raises":
                raise LookupError("in the clean-up") from None
            raise
        return "done"

    def within(number: int) -> Callable[[], Awaitable[object]]:
        if number == len(limits):
            return work

        async def bounded() -> object:
            return await limit(limits[number], within(number + 1))

        return bounded

    async def caller() -> tuple[object, int]:
        me = asyncio.current_task()
        assert me is not None
        try:
            ended: object = await within(0)()
        except (Exception, asyncio.CancelledError) as error:
            ended = type(error)
        return ended, me.cancelling()

    task = asyncio.create_task(caller())
    if cancelled_at is not None:
        loop.call_at(begin + cancelled_at, task.cancel)
    return *await task, loop.time() - begin


@given(
    limits=st.lists(MOMENTS, min_size=1, max_size=3),
    takes=MOMENTS,
    at_a_cancel=ENDS,
    cleanup=st.sampled_from([0.0, 0.125, 0.25]),
    cancelled_at=st.none() | st.sampled_from([0.3, 0.6, 0.9]),
)
def test_it_ends_as_under_a_timeout_of_asyncio(
    limits: list[float],
    takes: float,
    at_a_cancel: str,
    cleanup: float,
    cancelled_at: float | None,
) -> None:
    """The same outcome at the same moment, and the same count of cancellations."""
    told = []
    for limit in (ours, theirs):
        with asyncio.Runner(loop_factory=VirtualLoop) as runner:
            told.append(
                runner.run(
                    outcome(limit, limits, takes, at_a_cancel, cleanup, cancelled_at)
                )
            )

    assert told[0] == told[1]


@pytest.mark.virtual_clock
async def test_what_needs_no_wait_needs_no_deadline() -> None:
    """Its first step is all of it."""

    async def quick() -> int:
        return 7

    assert first_step(quick()) == 7
