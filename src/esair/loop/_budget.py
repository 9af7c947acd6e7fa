"""The budget: nobody takes the loop by awaiting what is there already."""

from __future__ import annotations

import asyncio

from esair.loop._of_loop import of_loop

SPENDABLE = 24
"""How many awaits of esair may end without a wait; a task gives way by the second time."""


WRITE_COST = 2
"""How many of them a write counts for: it takes longer than the others."""


class Budget:
    """Counts awaits that need not wait; a task that makes too many gives way.

    An await that is answered at once never gives the loop back, so a task that loops
    over such awaits would have it for itself. A counter costs next to nothing, and
    unlike a clock it repeats.

    Example:
        >>> budget.left -= 1
        >>> if budget.left < 0:
        ...     await budget.give_way()
    """

    __slots__ = ("_spender", "left")

    def __init__(self, _loop: asyncio.AbstractEventLoop) -> None:
        self.left = SPENDABLE
        self._spender = 0

    @classmethod
    def of(cls, loop: asyncio.AbstractEventLoop) -> Budget:
        """Return that of a loop."""
        return of_loop(loop, cls)

    @classmethod
    async def spend(cls, cost: int = 1) -> None:
        """Count one await of the running loop, and give way if all is spent."""
        budget = cls.of(asyncio.get_running_loop())
        budget.left -= cost
        if budget.left < 0:
            await budget.give_way()

    async def give_way(self) -> None:
        """Let everybody else go on first, if it is this task that has spent all.

        The counter is shared, which makes it cheap: who finds it spent was perhaps not
        the one who spent it. If it finds it spent twice in a row, it was.
        """
        self.left = SPENDABLE
        task = id(asyncio.current_task())
        if task != self._spender:
            self._spender = task
            return
        await asyncio.sleep(0)
