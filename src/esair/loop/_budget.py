"""The budget: nobody takes the loop by awaiting what is there already."""

from __future__ import annotations

import asyncio
import weakref
from collections.abc import Callable

from esair.loop._of_loop import OfLoop
from esair.loop._ownership import is_outside

SPENDABLE = 48
"""What a task may spend on awaits that end without a wait: it gives way by twice this."""

WRITE_COST = 3
"""What a write costs: it takes about three times as long as a read, which costs 1."""

PUT_COST = 2  # what handing data over costs

VERB_COST = 16
"""What costs that changes more than that: an operation, a step, a command of the user."""


class Budget(OfLoop):
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
        self._spender: Callable[[], object] = _nobody

    @classmethod
    async def spend(cls, cost: int = 1) -> None:
        """Count one await of the running loop, and give way if all is spent."""
        loop = asyncio.get_running_loop()
        # What is outside of the robot may not change who of it gives way.
        budget = _BudgetBeside.of(loop) if is_outside() else cls.of(loop)
        budget.left -= cost
        if budget.left < 0:
            await budget.give_way()

    async def give_way(self) -> None:
        """Let everybody else go on first, if it is this task that has spent all.

        The counter is shared, which makes it cheap: who finds it spent was perhaps not
        the one who spent it. If it finds it spent twice in a row, it was.
        """
        self.left = SPENDABLE
        task = asyncio.current_task()
        if self._spender() is not task:
            # Not its id: another task may get that, and the run would not repeat.
            self._spender = _nobody if task is None else weakref.ref(task)
            return
        self._spender = _nobody
        await asyncio.sleep(0)


class _BudgetBeside(Budget):
    """The budget of what is outside of the robot."""

    __slots__ = ()


def _nobody() -> object:
    return Budget  # what no task is
