"""The budget of awaits: who spends it gives way, and nobody else by chance."""

from __future__ import annotations

import asyncio

from esair.loop import SPENDABLE, Budget


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

    asyncio.run(main())


def test_who_finds_it_spent_twice_gives_way() -> None:
    """The second time in a row it was the task itself."""

    async def main() -> None:
        budget = Budget.of(asyncio.get_running_loop())
        ran: list[bool] = []
        asyncio.get_running_loop().call_soon(ran.append, True)
        await budget.give_way()
        assert not ran
        await budget.give_way()
        assert ran

    asyncio.run(main())


def test_a_task_alone_gives_way_by_twice_the_budget() -> None:
    """Not at each spent budget: a turn of the loop costs more than ten reads."""

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

    assert 8 <= asyncio.run(main()) <= 12
