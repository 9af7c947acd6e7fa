"""What a running reaction decides: at most one wish for each of its actuators in a turn."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Awaitable, Mapping
from typing import TYPE_CHECKING, Any

from esair.connections import (
    ActuatorChannel,
    Decision,
    Registration,
    SensorChannel,
    Sight,
)
from esair.exceptions import BadValueError, EsairError, describe
from esair.messages import Refused, Written

if TYPE_CHECKING:
    from esair.actions._reaction_runner import ReactionRunner

_log = logging.getLogger("esair")


class Output:
    """One actuator of a running reaction, and what it decided for it in this turn."""

    __slots__ = (
        "_outputs",
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
    )

    def __init__(
        self,
        outputs: Outputs,
        name: str,
        channel: ActuatorChannel,
        registration: Registration,
    ) -> None:
        self._outputs = outputs
        self.name: str = name
        self.channel: ActuatorChannel = channel
        self.decision: Decision = channel.decision
        self.registration: Registration = registration
        self._sight: Sight | None = None
        self.command: Any = None
        """What it decided in this turn; None to give the actuator back."""
        self.checked: Any = None  # the same as it may be sent
        self.decided: bool = False  # it takes part in the decision of this turn
        self.active: bool = False  # it may hold the actuator
        self.pending: bool = False  # a write is on its way
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
                check = self.channel.checked  # hot: by itself
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
                self._outputs.conflated += 1
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
            self._outputs.refused += 1
            self.active = True  # what a guard stops has taken the actuator
        else:
            self.active = self.pending = True
            return True, self._settle(outcome)  # type: ignore[arg-type]
        return True, None

    async def _settle(self, rest: Awaitable[Written[Any] | Refused]) -> None:
        outputs, task = self._outputs, asyncio.current_task()
        assert task is not None
        outputs.settling.add(task)
        try:
            if not await rest:
                outputs.refused += 1
        except EsairError as error:
            self.reject(error)
            self.later = None
        finally:
            outputs.settling.discard(task)
            self.pending = False
            command, self.later = self.later, None
        if command is None or outputs.runner.stopped:
            return
        if self.decided:  # in this turn, and newer
            outputs.conflated += 1
        else:
            with contextlib.suppress(BadValueError):  # by limits that are new
                self.decide(command)

    def reject(self, error: EsairError) -> None:
        """Count what cannot be sent; who wants what is bad by itself is blind."""
        outputs, runner = self._outputs, self._outputs.runner
        outputs.rejected += 1
        if outputs.rejected == 1 or outputs.rejected % 1000 == 0:
            _log.warning(
                "%s: command %d for %s was rejected: %s",
                runner.reaction.name,
                outputs.rejected,
                self.name,
                describe(error),
            )
        if isinstance(error, BadValueError):
            runner.flawed(error)

    def lost(self, winner: Registration) -> None:
        """Count a command that another one of the same turn has beaten."""
        command, self.command = self.command, None
        self.decided = False
        self._outputs.refused += 1
        self.channel.lost(self.registration, command, winner)

    def release(self) -> None:
        """Give the actuator back; what it was told times out unless somebody writes."""
        self.active = False
        self.later = None
        self.channel.release(self.registration)

    def forget(self) -> None:
        """Send nothing more of what was decided."""
        self.command = self.later = None


class Outputs:
    """The actuators of a running reaction, and what became of its commands."""

    __slots__ = (
        "all",
        "conflated",
        "refused",
        "rejected",
        "runner",
        "settling",
        "single",
    )

    def __init__(self, runner: ReactionRunner) -> None:
        self.runner: ReactionRunner = runner
        self.all: dict[str, Output] = {}
        self.single: Output | None = None
        """The only one, if there is but one."""
        self.refused: int = 0
        self.rejected: int = 0
        """How many commands were no good, or met a device that is not there."""
        self.conflated: int = 0
        """How many commands were replaced by a newer one before they could leave."""
        self.settling: set[asyncio.Task[Any]] = set()
        """The tasks of writes whose drivers wait."""

    def begin(
        self, outputs: Mapping[str, tuple[ActuatorChannel, Registration]]
    ) -> None:
        """Have these actuators from now on."""
        self.all = {name: Output(self, name, *terms) for name, terms in outputs.items()}
        self.single = next(iter(self.all.values())) if len(self.all) == 1 else None

    def join(self, polled: tuple[SensorChannel, ...]) -> None:
        for output in self.all.values():
            output.join(polled)

    @property
    def moved(self) -> list[tuple[Decision, float]]:
        """The decisions in which it takes part, each with its priority there."""
        outputs = self.all.values()
        return [(each.decision, each.registration.priority) for each in outputs]

    def decide(self, result: Any) -> None:
        """Want what ``react`` has returned sent, or given back.

        Raises:
            BadValueError: It must not be sent; the reaction is blind now.
        """
        single = self.single
        if single is not None and not (type(result) is dict and single.name in result):
            if result is not None or single.active:
                single.decide(result)  # its commands may be dictionaries
            return
        commands = {} if result is None else result
        if type(commands) is not dict or not commands.keys() <= self.all.keys():
            expected = ", ".join(self.all) or "nothing"
            told = f"expected a dictionary with commands for {expected}, not {result!r:.80}"
            name = self.runner.reaction.name
            self.runner.crash(BadValueError(name, "react", told))
            return
        for name, output in self.all.items():
            command = commands.get(name)
            if command is not None or output.active:
                output.decide(command)

    def forget(self) -> None:
        """Drop the commands that have not left yet."""
        for output in self.all.values():
            output.forget()

    def drop(self) -> None:
        """Give all of them back at once, for it cannot decide."""
        for output in self.all.values():
            output.forget()
            output.active = False
            output.channel.drop(output.registration)

    def stop(self) -> None:
        """Send nothing more, and have no say. What it wrote is the caller's to undo."""
        for output in self.all.values():
            output.leave()
        for task in tuple(self.settling):
            task.cancel()
