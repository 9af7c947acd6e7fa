"""What a turn may take: who spends it gives way, and nobody else by chance."""

from __future__ import annotations

import asyncio
import time

import pytest
from tests.turn.loops import LOOPS, Make, run

from esair.loop import READ_COST, Budget, Owner, spawn, turn_of
from esair.loop._budget import LASTS
from esair.testing import VirtualLoop

SPENDABLE = round(LASTS / READ_COST)


def test_a_task_that_is_new_is_not_mistaken_for_one_that_has_ended() -> None:
    """Their ids may be equal: then a run would depend on addresses, and not repeat."""

    async def main() -> None:
        budget = Budget.of(asyncio.get_running_loop())
        others = 0
        gave_way: list[bool] = []

        def beside() -> None:
            nonlocal others
            others += 1

        async def spends() -> None:
            before = others
            asyncio.get_running_loop().call_soon(beside)
            await budget.give_way()
            gave_way.append(others > before)

        for _ in range(20):
            asyncio.create_task(spends())  # noqa: RUF006 - freed, so that the next has its place
            await asyncio.sleep(0)
            await asyncio.sleep(0)
        assert gave_way == [False] * 20

    run(VirtualLoop, main())


def test_who_finds_it_spent_twice_gives_way_where_time_stands_still() -> None:
    """The second time in a row it was the task itself."""

    async def main() -> None:
        budget = Budget.of(asyncio.get_running_loop())
        ran: list[bool] = []
        asyncio.get_running_loop().call_soon(ran.append, True)
        await budget.give_way()
        assert not ran
        await budget.give_way()
        assert ran

    run(VirtualLoop, main())


@pytest.mark.promise("TURN-4")
@pytest.mark.parametrize("make", LOOPS.values(), ids=LOOPS)
def test_a_task_alone_gives_way_each_few_awaits(make: Make) -> None:
    """Not at each: a turn of the loop costs more than ten reads."""

    async def main() -> int:
        loop, turns, over = asyncio.get_running_loop(), 0, False

        def turn() -> None:
            nonlocal turns
            turns += 1
            if not over:
                loop.call_soon(turn)

        loop.call_soon(turn)
        for _ in range(20 * SPENDABLE):
            await Budget.spend()
        over = True
        return turns

    assert 9 <= run(make, main()) <= 6 * SPENDABLE


@pytest.mark.promise("TURN-4", "TURN-7")
@pytest.mark.real_clock
@pytest.mark.parametrize("make", LOOPS.values(), ids=LOOPS)
def test_who_computes_gives_way_at_its_next_await(make: Make) -> None:
    """What is due meanwhile comes between two stretches without an await."""

    async def main() -> list[int]:
        loop, passes = asyncio.get_running_loop(), 0
        if turn_of(loop).virtual:
            pytest.skip("time passes only when nothing is left to be done")

        def count() -> None:
            nonlocal passes
            passes += 1
            loop.call_soon(count)

        loop.call_soon(count)
        between: list[int] = []
        for _ in range(20):
            before = passes
            end = time.monotonic() + 2 * LASTS
            while time.monotonic() < end:
                pass
            await Budget.spend()
            between.append(passes - before)
        return between

    async def owned() -> list[int]:
        return await spawn(
            asyncio.get_running_loop(), main(), name="owned", owner=Owner()
        )

    first, *others = run(make, owned())
    assert all(others), (first, others)
