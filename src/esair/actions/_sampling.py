"""How a step at a rate waits for the sensors that are asked at the same moment.

For its own, and for those of who has as much to say about what it moves: the guards, and
whoever writes it with its priority or a higher one. So all decide together, on what there
is to see at that moment.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence

from esair.actions._reaction_ports import Input
from esair.connections import Decision, SensorChannel
from esair.loop import Job, OneShot, Order, Scheduler, Step


def polled_for(inputs: Sequence[Input]) -> tuple[SensorChannel, ...]:
    """Return the sensors that are asked for what is decided on, each once."""
    asked = [each for one in inputs for each in one.channel.sampled]
    return tuple(dict.fromkeys(asked))


class Sampling:
    """Has a step wait for the polls of its own instant, half a period at most.

    A sensor that lately took longer than that is not waited for.
    """

    def __init__(
        self,
        scheduler: Scheduler,
        polled: tuple[SensorChannel, ...],
        moved: Sequence[tuple[Decision, float]],
        step: Step,
        name: str,
        rate: float,
    ) -> None:
        self._scheduler = scheduler
        self._polled = polled
        self._moved = moved
        self._half = 0.5 / rate
        self._deferred: Job = scheduler.on_demand(step, name=name)
        self._awaits = 0  # for how many samples it waits,
        self._sampled_in = 0  # and of which turn they are; 0 if it waits for none
        self._patience: OneShot | None = None

    def waits(self, now: float) -> bool:
        """Tell whether the step waits; then it comes when its samples are there."""
        turn, half = self._scheduler.turns, self._half
        bearing = list(self._polled)
        for decision, priority in self._moved:
            for sight in decision.sights:
                if sight.priority >= priority:
                    bearing += sight.sensors
        awaited = [
            each
            for each in dict.fromkeys(bearing)
            if each.awaited_in == turn and each.latency <= half
        ]
        if not awaited:
            return False
        self._awaits = len(awaited)
        self._sampled_in = turn
        for each in awaited:
            each.when_answered(functools.partial(self._answered, turn))
        self._lose_patience()
        self._patience = self._scheduler.at(
            now + half, self._wait_no_longer, order=Order.EXPIRY
        )
        return True

    def stop(self) -> None:
        self._deferred.stop()
        self._lose_patience()

    def _answered(self, turn: int) -> None:
        """A sample has come; step when all have."""
        if turn == self._sampled_in:
            self._awaits -= 1
            if self._awaits == 0:
                self._wait_no_longer(0.0)

    def _wait_no_longer(self, _now: float) -> None:
        self._sampled_in = 0
        self._lose_patience()
        self._deferred.soon()

    def _lose_patience(self) -> None:
        if self._patience is not None:
            self._scheduler.cancel(self._patience)
            self._patience = None
