"""What a turn may take: who awaits something after that gives way to a new turn first.

An await that is answered at once never gives the loop back, and the clock of the turns
stands still meanwhile: a task that computes, or loops over such awaits, would have the loop
for itself, and would take for new what was known when its turn began.
"""

from __future__ import annotations

import asyncio
import math
import weakref
from collections.abc import Callable
from typing import TYPE_CHECKING, Final

from esair.loop._of_loop import OfTurn
from esair.loop._ownership import is_outside
from esair.loop._tape import First, Player, Tag, TapeWriter

if TYPE_CHECKING:
    from esair.loop._turn import Turn

LASTS: Final = 0.005
"""For how long a turn may last before an await gives way, in seconds."""

READ_COST: Final = LASTS / 96
"""What an await costs beside the time it takes: where time stands still nothing else does."""

WRITE_COST: Final = 3 * READ_COST
"""What a write costs: it takes about three times as long as a read."""

PUT_COST: Final = 2 * READ_COST
"""What handing data over costs."""

VERB_COST: Final = 16 * READ_COST
"""What costs that changes more than that: an operation, a step, a command of the user."""

_TAG: Final[Tag] = ("turn", "gave way")


class Budget(OfTurn):
    """What is left of a turn. There is one for each event loop.

    Example:
        >>> budget.late -= READ_COST
        >>> if budget.clock() > budget.late:
        ...     await budget.give_way()
    """

    __slots__ = (
        "_at",
        "_awaits",
        "_found",
        "_next",
        "_spender",
        "_turn",
        "beside",
        "clock",
        "is_counted",
        "late",
    )

    def __init__(self, turn: Turn, *, is_beside: bool = False) -> None:
        self._turn = turn
        self.beside: Budget | None = None if is_beside else Budget(turn, is_beside=True)
        """What is left for what is outside of the robot; only its awaits count."""
        self.clock: Callable[[], float] = float if is_beside else turn.clock
        """Reads the time amid the turn; who reads it has to give way if it is late."""
        self.late: float = LASTS
        """From when on an await gives way in this turn; the border sets it."""
        self.is_counted: bool = False
        """Whether `late` is of this turn, on a loop that has no border in each pass."""
        self._at = 0  # the turn whose awaits are counted
        self._awaits = 0
        self._next: tuple[int, int, int] | None = None
        """Who gives way next in a replay: in which turn, by which await, for how long."""
        self._found = 0  # the turn in which somebody has found that it lasts too long
        self._spender: Callable[[], object] = _nobody

    @classmethod
    async def spend(cls, cost: float = READ_COST) -> None:
        """Pay for one await in the running loop, and give way if all is spent."""
        budget = cls.of(asyncio.get_running_loop())
        if is_outside():
            # It may not change who of the robot gives way: a replay has none of it.
            beside = budget.beside
            assert beside is not None
            beside.late -= cost
            if beside.late < 0.0 and beside.is_of_one():
                await asyncio.sleep(0)
            return
        budget.late -= cost
        if budget.clock() > budget.late:
            await budget.give_way()

    async def give_way(self, tries: int = 2, most: int = 3) -> None:
        """Let everybody else go on first, for so many passes: the turn has lasted too long.

        Who finds first that it has lasted, and did not only await much in it, goes on after
        those whom the next turn lets go on. One of them may make its turn last as long.
        """
        turn = self._turn
        if not turn.has_lasted():
            return
        if self._next is None:
            has_lasted = turn.clock() > turn.time() + LASTS
            passes = most if has_lasted and turn.number != self._found else 1
            self._found = turn.number
            if isinstance(turn.door.tape, TapeWriter):
                gave_way = turn.number, self._awaits, passes
                turn.door.tape.first(_TAG, First(value=gave_way))
        else:
            passes, self._next = self._next[2], None
        for _ in range(passes):
            await asyncio.sleep(0)
        turn.count()
        if tries and self.clock() > self.late:
            await self.give_way(tries - 1)

    def is_of_one(self) -> bool:
        """Tell whether one task alone has spent it, where time stands still.

        Who finds it spent was perhaps not the one who spent it. If it finds it spent twice
        in a row, it was.
        """
        self.late = self.clock() + LASTS
        task, spender = asyncio.current_task(), self._spender()
        self._spender = _nobody
        if task is not None and spender is not task:
            # Not its id: another task may get that, and the run would not repeat.
            self._spender = weakref.ref(task)
        return spender is task

    def keep(self) -> None:
        """Count from now on: a tape tells by its number which await gave way."""
        self._at = -1
        self.clock = self._counting

    def play(self) -> None:
        """Have those give way from now on who did when the run was kept."""
        self._at = -1
        self.clock = self._repeating

    def _count(self) -> int:
        number = self._turn.number
        if number != self._at:
            self._at, self._awaits = number, 0
        self._awaits += 1
        return number

    def _counting(self) -> float:
        self._count()
        return self._turn.clock()

    def _repeating(self) -> float:
        player = self._turn.door.tape
        if not isinstance(player, Player) or player.is_over:
            self.clock = self._turn.time  # time is hurried on
            return self.clock()
        number = self._count()
        if self._next is None and player.has_first(_TAG):
            self._next = tuple(player.first(_TAG)[1].value)
        if self._next is None or self._next[:2] > (number, self._awaits):
            return -math.inf
        return math.inf


def _nobody() -> object:
    return Budget  # what no task is
