"""How a guard runs: asked about each command, and looking again at what stands."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from esair.actions._reaction import Reaction
from esair.actions._reaction_runner import ReactionRunner
from esair.connections import (
    BLIND,
    ActuatorChannel,
    Decision,
    Protection,
    Registration,
    SensorChannel,
    Sight,
)
from esair.loop import Step


class GuardRunner(ReactionRunner):
    """Runs one guard until it is stopped.

    Its ``react`` is called at the commit point of the actuator, for each command, and
    from there again when a sensor has a new reading, or at its rate: then the command
    that was asked for last is put to it.
    """

    grace = 2e-5  # what moves by the same reading is safe before: that latches nothing

    __slots__ = ("_channel", "_port", "_protection", "_sight")

    def __init__(
        self, reaction: Reaction, port: str, protection: Protection, **hooks: Any
    ) -> None:
        super().__init__(reaction, **hooks)
        self._port = port
        self._protection = protection
        self._channel: ActuatorChannel | None = None
        self._sight: Sight | None = None

    def guard(
        self,
        channel: ActuatorChannel,
        inputs: Mapping[str, tuple[SensorChannel, Registration, float | None]],
    ) -> None:
        """Begin to follow the sensors, and to judge the commands of an actuator."""
        self._channel = channel
        protection = self._protection
        protection.judge = self._judge
        protection.fallback = self._fallback
        protection.on_crash = self._crashed
        self.start(inputs, {})

    def _join(self, polled: tuple[SensorChannel, ...]) -> None:
        for decision, priority in self.moved:
            decision.leave(self._sight)
            self._sight = Sight(priority, polled)
            decision.join(self._sight)

    @property
    def moved(self) -> list[tuple[Decision, float]]:
        """All guards of the actuator look together."""
        return [] if self._channel is None else [(self._channel.decision, math.inf)]

    def stop(self) -> None:
        """Judge no command any more: while its entry is in the table none passes."""
        super().stop()
        if self._channel is not None:
            self._channel.decision.leave(self._sight)
        if self._protection.judge == self._judge:
            self._protection.judge = None

    @property
    def _turn(self) -> Step:
        return self._step if self.every is None else self._step_on_each

    def _unpark(self) -> None:
        super()._unpark()
        self.blind = False
        self._on_sight()

    def _step(self, now: float) -> None:
        if not self._sees(now) or (self._until is not None and self._is_over()):
            return
        if self._channel is None:
            return
        if self.every:  # another reading waits, so this one has a look of its own
            self._channel.review()
        else:
            self._channel.decision.look()

    def _judge(self, command: Any) -> Any:
        began = self._time()
        if self.missing or began >= self.stale_at:
            self.job.soon()  # it is parked in a step of its own
            return BLIND
        self.steps += 1
        timed = self._step_time
        first = timed.begin() if timed is not None else 0.0
        self._clock.step(began)
        stepping = self._stepping
        stepping.stepper, before = self, stepping.stepper
        try:
            passed = self.reaction.react(**self.readings(), **{self._port: command})
        finally:
            stepping.stepper = before
        if timed is None:
            return passed
        failed = timed.end(first)
        if failed is not None:
            raise failed
        return BLIND if timed.in_row else passed

    def _fallback(self, command: Any) -> Any:
        return self.reaction.blind(**{self._port: command})

    def _crashed(self, error: BaseException) -> None:
        if not self.stopped:
            self._crash(error)
