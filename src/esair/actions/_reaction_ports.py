"""The two sides of a running reaction: what it is fed with, what it decides."""

from __future__ import annotations

from collections.abc import Awaitable
from typing import TYPE_CHECKING, Any

from esair.connections import ActuatorChannel, Registration, SensorChannel
from esair.exceptions import EsairError
from esair.messages import Reading

if TYPE_CHECKING:
    from esair.actions._reaction_runner import ReactionRunner

FOR_EVER = float("inf")


class Input:
    """One sensor of a running reaction."""

    __slots__ = (
        "channel",
        "max_age",
        "name",
        "ready",
        "registration",
        "runner",
        "stale_at",
    )

    def __init__(
        self,
        runner: ReactionRunner,
        name: str,
        channel: SensorChannel,
        registration: Registration,
        max_age: float | None,
    ) -> None:
        self.runner = runner
        self.name = name
        self.channel = channel
        self.registration = registration
        self.max_age = FOR_EVER if max_age is None else max_age
        self.ready = False
        self.stale_at = FOR_EVER

    def feed(self, reading: Reading[Any]) -> None:
        """Take a new reading; the reaction's next step decides on it."""
        runner = self.runner
        runner.values[self.name] = reading.value
        if self.max_age < FOR_EVER:
            self.stale_at = reading.time + self.max_age
            runner.refresh()
        if not self.ready:
            self.ready = True
            runner.arrived()
        if runner.on_reading and not runner.missing:
            runner.job.soon()

    def changed(self, error: EsairError | None) -> None:
        """Park the reaction when the sensor is gone; feeding it wakes it up."""
        if error is not None and self.ready:
            self.ready = False
            self.runner.park(f"{self.name}: {error}", missing=1)


class Output:
    """One actuator of a running reaction, and what it decided for it in this turn."""

    __slots__ = (
        "active",
        "channel",
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
        runner: ReactionRunner,
        name: str,
        channel: ActuatorChannel,
        registration: Registration,
    ) -> None:
        self.runner = runner
        self.name = name
        self.channel = channel
        self.decision = channel.decision
        self.registration = registration
        self.command: Any = None
        """What it decided in this turn; None to give the actuator back."""
        self.decided = False
        """It takes part in the decision of this turn."""
        self.active = False
        """It may hold the actuator."""
        self.pending = False
        """A write is on its way."""
        self.later: Any = None
        """The newest command, while an older one is on its way."""

    def decide(self, command: Any) -> None:
        """Want a command sent at the end of the turn, or None."""
        self.command = command
        if not self.decided:
            self.decided = True
            self.decision.add(self)

    def commit(self) -> tuple[bool, Awaitable[object] | None]:
        """Send what was decided; return whether it left, and the rest of the work."""
        command, self.command = self.command, None
        self.decided = False
        if command is None:
            if self.active:
                self.release()
            return False, None
        return self.runner.write(self, command)

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
