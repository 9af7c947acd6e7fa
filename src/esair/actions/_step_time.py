"""How long the steps of a reaction take, where it has a budget."""

from __future__ import annotations

import asyncio
import logging

from esair.actions._reaction import Reaction
from esair.exceptions import BehaviorFailedError
from esair.loop import ask_outside, clock_beside

_log = logging.getLogger("esair")


class StepTime:
    """Counts the steps that take longer than their budget."""

    def __init__(
        self, reaction: Reaction, loop: asyncio.AbstractEventLoop, budget: float
    ) -> None:
        self._reaction = reaction
        self._budget = budget
        self._clock = clock_beside(loop)
        self.overruns = 0  # how many have taken longer,
        self.in_row = 0  # and how many of them the last ones

    def begin(self) -> float:
        return self._clock()

    def end(self, begin: float) -> BehaviorFailedError | None:
        """Count a step that took too long; return an error if there were too many."""
        reaction = self._reaction
        # When the run was recorded, it is what the step took then.
        took = ask_outside((reaction.name, "took"), lambda: self._clock() - begin)
        if took <= self._budget:
            self.in_row = 0
            return None
        self.overruns += 1
        self.in_row += 1
        text = f"step took {took:.3g} s, its budget is {self._budget:g} s"
        if self.overruns == 1 or self.overruns % 1000 == 0:
            _log.warning("%s: overrun %d: %s", reaction.name, self.overruns, text)
        limit = reaction.overrun_limit
        if limit is None or self.in_row <= limit:
            return None
        row = f"overrun {self.in_row} in a row: {text}"
        return BehaviorFailedError(reaction.name, row)


def step_time(reaction: Reaction, loop: asyncio.AbstractEventLoop) -> StepTime | None:
    """Return what counts the steps of a reaction; only who has a budget pays for it."""
    budget = reaction.budget
    if budget is None and loop.get_debug():
        budget = loop.slow_callback_duration
    return None if budget is None else StepTime(reaction, loop, budget)
