"""The two sides of a running reaction: what it is fed with, what it decides."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Awaitable
from typing import Any, ClassVar, Protocol

from esair.actions._reaction import Reaction
from esair.connections import ActuatorChannel, Registration, SensorChannel, Sight
from esair.exceptions import (
    BadValueError,
    DeviceLostError,
    EsairError,
    ResourceRemovedError,
    describe,
)
from esair.loop import Job
from esair.messages import Reading, Refused, Written

FOR_EVER = float("inf")

_log = logging.getLogger("esair")


class Runner(Protocol):
    """What runs a reaction, as its two sides see it."""

    reaction: Reaction
    job: Job
    grace: ClassVar[float]
    values: list[Any]
    settling: set[asyncio.Task[Any]]
    on_reading: bool
    stopped: bool
    missing: int
    steps: int
    skipped: int
    conflated: int
    refused: int
    rejected: int

    def arrived(self) -> None: ...
    def flawed(self, error: BadValueError) -> None: ...
    def forget(self) -> None: ...
    def park(self, reason: str, *, missing: int = 0) -> None: ...
    def queue(self, place: int, value: Any) -> None: ...
    def refresh(self, fed: Input) -> None: ...
    def resample(self) -> None: ...


class Input:
    """One sensor of a running reaction."""

    __slots__ = (
        "channel",
        "every",
        "max_age",
        "name",
        "optional",
        "place",
        "ready",
        "registration",
        "runner",
        "seen",
        "stale_at",
    )

    def __init__(
        self,
        runner: Runner,
        name: str,
        place: int,
        channel: SensorChannel,
        registration: Registration,
        max_age: float | None,
        *,
        optional: bool,
        every: bool = False,
    ) -> None:
        self.runner = runner
        self.name = name
        self.place = place  # where its value is among those of the reaction
        self.channel = channel
        self.registration = registration
        self.max_age = max_age
        """The greatest age of a reading; the sensor's own limit if it is None."""
        self.optional = optional
        self.every = every  # whether each single reading has a step
        self.seen = -1  # how many steps there were when it was fed last
        self.ready = False
        self.stale_at = FOR_EVER

    def feed(self, reading: Reading[Any]) -> None:
        """Take a new reading; the reaction's next step decides on it."""
        runner = self.runner
        # By their places: a name in a tuple takes three times as long.
        value = runner.values[self.place] = reading[0]
        limit = self.max_age
        if limit is None:
            limit = self.channel.max_age
        if limit < FOR_EVER:
            self.stale_at = reading[1] + limit + runner.grace
            runner.refresh(self)
        if not self.ready:
            self.ready = True
            if not self.optional:
                runner.arrived()
        if runner.missing:
            self.seen = runner.steps
            return
        if self.every:
            runner.queue(self.place, value)
        elif self.seen == runner.steps:
            runner.skipped += 1
        self.seen = runner.steps
        if runner.on_reading:
            runner.job.soon()

    @property
    def limit(self) -> float:
        """The greatest age of a reading that the reaction decides on, in seconds."""
        return self.channel.max_age if self.max_age is None else self.max_age

    def changed(self, error: EsairError | None) -> None:
        """Park the reaction when the sensor is gone; feeding it wakes it up."""
        if error is None:
            self.runner.resample()
        else:
            self.lose(_in_short(self.name, error))

    @property
    def grace(self) -> float:
        return self.runner.grace

    def limited(self) -> None:
        """Have the newest reading for as long as is said now, where the sensor says it."""
        newest = self.channel.newest
        if self.ready and self.max_age is None and newest is not None:
            self.stale_at = newest[1] + self.limit + self.runner.grace
            self.runner.refresh(self)

    def doubt(self, error: EsairError) -> None:
        """Park it at a bad reading, if nothing else tells how old the last good one is."""
        if self.limit == FOR_EVER:
            self.lose(f"{self.name} is bad: {error}")

    def lose(self, reason: str) -> None:
        """Have no reading any more; without one that it needs the reaction is blind."""
        if not self.ready:
            return
        self.ready = False
        self.stale_at = FOR_EVER
        self.runner.forget()
        if self.optional:
            self.runner.values[self.place] = None
            if self.runner.on_reading:
                self.runner.job.soon()
        else:
            self.runner.park(reason, missing=1)


class Output:
    """One actuator of a running reaction, and what it decided for it in this turn."""

    __slots__ = (
        "_sight",
        "active",
        "channel",
        "checked",
        "command",
        "decided",
        "decision",
        "later",
        "name",
        "pending",
        "registration",
        "runner",
    )

    def __init__(
        self,
        runner: Runner,
        name: str,
        channel: ActuatorChannel,
        registration: Registration,
    ) -> None:
        self.runner = runner
        self.name = name
        self.channel = channel
        self.decision = channel.decision
        self.registration = registration
        self._sight: Sight | None = None
        self.command: Any = None
        """What it decided in this turn; None to give the actuator back."""
        self.checked: Any = None  # the same as it may be sent
        self.decided = False  # it takes part in the decision of this turn
        self.active = False  # it may hold the actuator
        self.pending = False  # a write is on its way
        self.later: Any = None  # the newest command, while an older one is on its way

    def join(self, sensors: tuple[SensorChannel, ...]) -> None:
        """Have a say in what the actuator does, by what these sensors see."""
        self.decision.leave(self._sight)
        self._sight = Sight(self.registration.priority, sensors)
        self.decision.join(self._sight)

    def leave(self) -> None:
        """Send nothing more of what was decided, and have no say."""
        self.forget()
        self.decision.leave(self._sight)

    def decide(self, command: Any) -> None:
        """Want a command sent at the end of the turn, or None.

        Raises:
            BadValueError: It must not be sent; the reaction is blind now.
        """
        if command is not None:
            try:
                check = self.channel.checked  # by itself: see the scheduler
                self.checked = check(command)
            except BadValueError as error:
                self.channel.wanted(self.registration, command)
                self.reject(error)
                raise
        self.command = command
        if not self.decided:
            self.decided = True
            self.decision.add(self)

    def commit(self, now: float) -> tuple[bool, Awaitable[object] | None]:
        """Send what was decided; return whether it left, and the rest of the work."""
        command, self.command = self.command, None
        self.decided = False
        if command is None:
            if self.active:
                self.release()
            return False, None
        if self.pending:
            if self.later is not None:
                self.runner.conflated += 1
            self.later = command
            return True, None
        try:
            outcome = self.channel.begin(
                self.registration, command, None, False, self.checked, now
            )
        except EsairError as error:
            self.reject(error)
            return False, None
        if type(outcome) is Written:
            self.active = True
        elif type(outcome) is Refused:
            self.runner.refused += 1
            self.active = True  # what a guard stops has taken the actuator
        else:
            self.active = self.pending = True
            return True, self._settle(outcome)  # type: ignore[arg-type]
        return True, None

    async def _settle(self, rest: Awaitable[Written[Any] | Refused]) -> None:
        runner, task = self.runner, asyncio.current_task()
        assert task is not None
        runner.settling.add(task)
        try:
            if not await rest:
                runner.refused += 1
        except EsairError as error:
            self.reject(error)
            self.later = None
        finally:
            runner.settling.discard(task)
            self.pending = False
            command, self.later = self.later, None
        if command is None or runner.stopped:
            return
        if self.decided:  # in this turn, and newer
            runner.conflated += 1
        else:
            with contextlib.suppress(BadValueError):  # by limits that are new
                self.decide(command)

    def reject(self, error: EsairError) -> None:
        """Count what cannot be sent; who wants what is bad by itself is blind."""
        runner = self.runner
        runner.rejected += 1
        if runner.rejected == 1 or runner.rejected % 1000 == 0:
            _log.warning(
                "%s: command %d for %s was rejected: %s",
                runner.reaction.name,
                runner.rejected,
                self.name,
                describe(error),
            )
        if isinstance(error, BadValueError):
            runner.flawed(error)

    def lost(self, winner: Registration) -> None:
        """Count a command that another one of the same turn has beaten."""
        command, self.command = self.command, None
        self.decided = False
        self.runner.refused += 1
        self.channel.lost(self.registration, command, winner)

    def release(self) -> None:
        """Give the actuator back; what it was told times out unless somebody writes."""
        self.active = False
        self.later = None
        self.channel.release(self.registration)

    def forget(self) -> None:
        """Send nothing more of what was decided."""
        self.command = self.later = None


def _in_short(sensor: str, error: EsairError) -> str:
    """Say in a few words why there is no reading of a sensor."""
    if isinstance(error, ResourceRemovedError):
        return f"{sensor} removed"
    if isinstance(error, DeviceLostError):
        return f"{sensor} lost: {error.detail}" if error.detail else f"{sensor} lost"
    return f"{sensor}: {error}"
