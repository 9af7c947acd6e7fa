"""How a reaction runs whose ``react`` is in a child: it is asked, and decides on the answer."""

from __future__ import annotations

from typing import Any, Final

from esair.actions import Hooks, Reaction, ReactionRunner, StepClock
from esair.exceptions import BadValueError, ProcessDiedError
from esair.loop import Deadlines, Job, Owner, Step
from esair.placement._seat import Seat, StepSeat

PATIENCE: Final = 0.2
"""How long an answer may take if no actuator says by its ``command_timeout``, in s."""


class PlacedRunner(ReactionRunner):
    """Runs one reaction in a child, until it is stopped.

    A step takes effect in the turn in which its answer comes, if what it needs is still
    there and fresh. One that owes an answer for longer than a command may stand is blind.
    """

    __slots__ = (
        "_again",
        "_answer",
        "_asks",
        "_began",
        "_late_at",
        "_owes",
        "_seat",
        "_taking",
    )

    def __init__(
        self,
        reaction: Reaction,
        seat: Seat | StepSeat,
        hooks: Hooks,
        *,
        began: float = 0.0,
        owner: Owner | None = None,
    ) -> None:
        self._seat = seat
        self._owes = self._again = False
        self._answer: Any = None
        self._began = 0.0
        self._asks = StepClock(began)
        super().__init__(reaction, hooks, began=began, owner=owner)
        self._react = self._take
        self._taking: Job = self.scheduler.on_demand(self._decide, name=reaction.name)
        self._late_at = Deadlines.of(seat.loop).idle(self._owes_for_too_long)

    def start(self, inputs: Any, outputs: Any) -> None:
        self._seat.sit(self.owner)
        self._seat.begin(self._died)
        super().start(inputs, outputs)

    def stop(self) -> None:
        super().stop()
        self._taking.stop()
        self._late_at.cancel()
        self._seat.end()

    @property
    def patience(self) -> float:
        """How long it may owe an answer, in seconds."""
        all_ = self.outputs.all.values()
        found = (each.channel.actuator.command_timeout for each in all_)
        return min((each for each in found if each is not None), default=PATIENCE)

    @property
    def _turn(self) -> Step:
        return self._ask

    def _ask(self, now: float) -> None:
        """Have it decide on the newest readings; one step at a time."""
        if self._owes:
            self._again = True
            return
        senses = self.senses
        if not senses.see(now):
            return
        if senses.waiting:
            place, value = senses.waiting.popleft()
            senses.values[place] = value
        self._again = False
        clock = self._asks
        clock.step(now)
        step = (list(senses.values), clock.now_ms, clock.elapsed_ms)
        try:
            self._seat.decide(step, self._answered)
        except Exception as error:
            self.crash(error)
            return
        self._owes, self._began = True, now
        self._late_at.start(now + self.patience)

    def _answered(self, value: Any, error: BaseException | None) -> None:
        if self.stopped:
            return
        self._owes = False
        self._late_at.cancel()
        if isinstance(error, ProcessDiedError):
            return  # told by the death itself
        if error is not None:
            self.crash(error)
        elif self.time() - self._began > self.patience:
            self.outputs.rejected += 1
            self.job.soon()
        else:
            self._answer = value
            self._taking.soon()

    def _decide(self, now: float) -> None:
        self._step(now)
        self._answer = None
        if (self._again or self.senses.waiting) and not self.stopped:
            self.job.soon()

    def _take(self, *_: Any) -> Any:
        return self._answer

    def _owes_for_too_long(self) -> None:
        told = f"it owes an answer for {self.patience:g} s"
        self.park(told)
        self.flaw = BadValueError(self.reaction.name, "react", told)

    def _died(self, error: ProcessDiedError) -> None:
        if not self.stopped:
            self.crash(error)
