"""The way of commands to one actuator: who holds it, and what leaves."""

from __future__ import annotations

import asyncio
import copy
import math
from collections.abc import Callable, Generator
from typing import Any

from esair.connections._answers import rule_of, why, withdrawn
from esair.connections._call import Call, End
from esair.connections._command_check import CommandCheck
from esair.connections._decision import Decision
from esair.connections._driver import Guard
from esair.connections._halt import HALT, HALT_PRIORITY, Halt
from esair.connections._operations import Operating, Operations
from esair.connections._protected_device import ProtectedDevice
from esair.connections._registrations import Registration, Registrations
from esair.connections._waiting_writes import Sent, WaitingWrites
from esair.exceptions import (
    AccessDeniedError,
    DeviceLostError,
    EsairError,
    HaltedError,
    StoppingError,
)
from esair.journal import Kind
from esair.loop import CallRefused
from esair.messages import Answer, Refused, ResourceState, Why, Written
from esair.resources import HOLD, Actuator

_EARLY = 1e-6  # timers may fire a hair early


class _Sending:
    """A write that waits for the device: await it for its outcome."""

    __slots__ = (
        "asked",
        "by",
        "call",
        "channel",
        "command",
        "fence",
        "halts",
        "registration",
    )

    def __init__(
        self,
        channel: ActuatorChannel,
        call: Call,
        registration: Registration,
        command: Any,
        asked: Any,
        by: str | None,
    ) -> None:
        self.channel = channel
        self.call = call
        self.registration = registration
        self.command = command
        self.asked = asked
        self.by = by
        self.halts = channel.halts
        self.fence = channel.fence

    def __await__(self) -> Generator[Any, Any, Written[Any] | Refused]:
        return self.channel.finish(self).__await__()


class ActuatorChannel(ProtectedDevice):
    """Sends the commands of whoever holds the actuator, and the safe command.

    Every check and the call of the driver happen in one block without an await
    (`begin`), so nothing can change between the two.
    """

    # Slots: a thousand of these are touched a hundred times a second.
    __slots__ = (
        "_accepts",
        "_begin_call",
        "_blocks",
        "_check",
        "_checked",
        "_dead_man",
        "_deadline",
        "_halts",
        "_last_write",
        "_slews",
        "_waiting",
        "decision",
        "operations",
        "refusals",
        "since",
        "timeouts",
        "until",
        "writes",
    )

    def __init__(
        self,
        actuator: Actuator[Any],
        registrations: Registrations,
        loop: asyncio.AbstractEventLoop,
        on_error: Callable[[Exception], None],
        left: set[Call] | None = None,
    ) -> None:
        self.holder: Registration | None = None
        self.since = 0.0
        self.until = 0.0
        self.writes = 0
        self.refusals = 0
        self.timeouts = 0
        """How often the safe command was sent because nobody wrote."""
        self._writer: Registration | None = None
        self._last_write = 0.0
        self._accepts = False
        self._waiting = WaitingWrites(actuator.name, loop)
        self._dead_man: asyncio.TimerHandle | None = None
        self._halts = 0
        """Grows with each halt: a command from before is never sent after it."""
        self.decision = Decision(self, loop)
        """What reactions want of it in this turn."""
        self.operations = Operations(self, loop, on_error)
        super().__init__(actuator, registrations, loop, on_error, left)

    def attach(self, actuator: Actuator[Any]) -> None:
        """Write to this actuator from now on; it is not ready yet."""
        super().attach(actuator)
        self._blocks = self._write.executor is not None
        self._begin_call = self.calls.begin

    def configured(self) -> None:
        """Take over changed limits and time-outs."""
        super().configured()
        self._deadline = self.actuator.deadline
        self._check = CommandCheck(self.actuator)
        self._checked = self._check.checked
        self._slews = self._check.slews

    @property
    def successes(self) -> int:
        """How many commands the device has taken."""
        return self.writes

    @property
    def halts(self) -> int:
        """How often it was halted."""
        return self._halts

    @property
    def fence(self) -> int:
        """Grows with each safe command: what was begun before it leaves no more."""
        return self._fence

    def counts(self) -> dict[str, int]:
        """Return the counters, by name."""
        return {
            "writes": self.writes,
            "refusals": self.refusals,
            "timeouts": self.timeouts,
            "abandoned": self.calls.abandoned,
            "late": self.calls.late,
        }

    # State, told by the supervisor.

    def up(self) -> None:
        """The device is open and was told its safe command: writes may begin."""
        super().up()
        self._accepts = not self.latched and self.registrations.halt is None

    def latch(self) -> None:
        """Let nothing but safe commands leave from now on: the robot stops."""
        self.latched = True
        self._accepts = False
        patience = self._turn_within + self.actuator.deadline + 0.1
        self._last_moment = self._time() + patience
        self._look()
        if self.state is ResourceState.READY and not self.is_safe:
            self.make_safe()

    def bar(self) -> None:
        """Let no command pass any more, from any thread; `halt` follows in the loop."""
        self._accepts = False
        self._halts += 1

    def halt(self) -> None:
        """Send the safe command, and nothing but it until `resume`."""
        self.bar()
        self._look()
        if self.state is ResourceState.READY:
            self.make_safe()

    def resume(self) -> None:
        """Let commands pass again; the device was told its safe command last."""
        ready = self.state is ResourceState.READY and self.error is None
        self._accepts = ready and not self.latched

    def leaving(self, error: EsairError) -> None:
        """The device is about to go: only its safe command may leave, no write that waits."""
        self.error = error
        self._accepts = False
        self._look()

    def down(self, state: ResourceState, error: EsairError) -> None:
        """The device is gone: forget who held it and what it was told."""
        self._accepts = False
        self._disarm()
        super().down(state, error)
        self.operations.gone(error)

    def _disarm(self) -> None:
        self.holder = self._writer = None
        if self._dead_man is not None:
            self._dead_man.cancel()
            self._dead_man = None
        self._look_no_more()

    # The commit block.

    def begin(
        self, registration: Registration, command: Any, hold: float | None
    ) -> Sent:
        """Check everything and send a command, without a wait if the driver has none.

        Returns:
            The outcome, or what to await for it.

        Raises:
            NotRegisteredError: The registration is not valid (any more).
            DeviceLostError: The device is not there.
            StoppingError: The robot is stopping.
            BadValueError: The command must not be sent.
            DeviceFaultError: The device did not take it.
        """
        if not (registration.usable and self._accepts):
            return self._turned_away(registration, command)
        now = self._time()
        journal = self._journal
        if journal.heard:
            journal.publish(Kind.COMMAND, self.name, registration.behavior, command)
        blind = self._blind
        if (
            blind is not None
            and registration.priority <= blind.priority
            and blind.is_against(registration.behavior)
        ):
            return self._refuse(registration, blind.refusal())
        holder = self.holder
        if (
            holder is not registration
            and holder is not None
            and now < self.until
            and registration.priority <= holder.priority
            and holder.behavior != registration.behavior
        ):
            return self._refused(registration, holder)
        asked = command
        command = self._checked(command)
        if self._busy:
            return self._when_idle(registration, command, hold)
        if self.watch is not None and not self.watch.may_move():
            raise StoppingError(self.name, "made safe by the watchdog")
        if self._slews:
            # After a pause it starts from the safe command, not with a jump.
            seconds = min(now - self._last_write, self.command_timeout)
            command = self._slewed(command, seconds)
        if holder is not registration or now >= self.until:
            self.since = now
        self.holder = self._writer = registration
        self.until = now + (hold or registration.hold or self.command_timeout)
        self._last_write = now
        by = None
        if self._guards:
            stop, by, command = self._pass_guards(command, now)
            if stop is not None:
                self._stay()
                return self._refuse(registration, stop.refusal())
        # A copy of its own: who has the answer may change what is in it.
        self._told = copy.deepcopy(command) if self._check.copies else command
        self._told_safe = False
        if self._dead_man is None:
            self._dead_man = self._loop.call_at(
                now + self.command_timeout, self._nobody_wrote
            )
        self._busy = True
        if journal.heard:
            journal.publish(Kind.SENT, self.name, registration.behavior, command)
        guard = self._guard(registration) if self._blocks else None
        try:
            sent = self._begin_call(
                "write", self._write, (command,), self._deadline, self._ended, guard
            )
        except Exception as error:
            self._busy = self._lane is not None or self._safe_task is not None
            raise self._interrupted(error, command) from error
        if type(sent) is Call:
            sent.owner = registration
            self._lane = sent
            self._told_error = "it has not answered yet"
            return _Sending(self, sent, registration, command, asked, by)
        # Done: most drivers need not wait.
        self._busy = self._safe_task is not None
        self.writes += 1
        self._told_error = ""
        if sent is None and not journal.heard:  # most drivers say nothing
            return Written(command, asked, by)
        return self._applied(registration, command, sent, asked, by)

    def _slewed(self, command: Any, seconds: float) -> Any:
        before = self._base if self._told is HOLD else self._told
        if before is None or before is HOLD:
            return command  # nobody knows where it stays: its driver has not said
        return self._check.slewed(command, before, seconds)

    def lost(
        self, registration: Registration, command: Any, winner: Registration
    ) -> Refused:
        """Refuse a command that another one of the same turn has beaten."""
        if self._journal.heard:
            self._journal.publish(
                Kind.COMMAND, self.name, registration.behavior, command
            )
        return self._refused(registration, self.holder or winner)

    def _refused(self, registration: Registration, holder: Registration) -> Refused:
        return self._refuse(
            registration,
            Refused(
                holder.behavior,
                holder.priority,
                rule_of(holder),
                self.since,
                self.until,
            ),
        )

    def _refuse(self, registration: Registration, refused: Refused) -> Refused:
        self.refusals += 1
        if self._journal.heard:
            self._journal.publish(
                Kind.REFUSED, self.name, registration.behavior, refused
            )
        return refused

    def _guard(self, registration: Registration) -> Guard:
        """Return the checks that a thread makes when the turn of a command comes."""
        halts, may_leave = self._halts, self._may_leave()
        return lambda: registration.usable and halts == self._halts and may_leave()

    def _ended(self, call: Call, end: End) -> None:
        """Apply the outcome of a write that has waited for the device."""
        if end.error is None:
            self.writes += 1
            if self._writer is call.owner:
                self._last_write = self._time()
            if not self._told_safe:
                self._told_error = ""
        elif not (call.cancelled or isinstance(end.error, CallRefused)):
            self._failed(end.error, "write")
        if call.ended is not None:  # else its driver still has the device
            self._lane_free(call)

    async def finish(self, sending: _Sending) -> Written[Any] | Refused:
        """Wait for the outcome of a write that is on its way."""
        registration, command = sending.registration, sending.command
        try:
            applied = await self.calls.outcome(sending.call)
        except CallRefused:
            if (
                sending.fence != self._fence
                and sending.halts == self._halts
                and registration.usable
                and self._accepts
            ):
                return self._overtaken(registration)
            return self._turned_away(registration, command, sending.halts)
        except Exception as error:
            raise self._in_doubt(self._translated(error), command) from error
        return self._applied(registration, command, applied, sending.asked, sending.by)

    def _overtaken(self, registration: Registration) -> Refused:
        """Answer a write that the safe command came before, in the driver's lane."""
        stops = self._blind or next((g for g in self._guards if g.stopping), None)
        if stops is not None:
            return self._refuse(registration, stops.refusal())
        now = self._time()
        told = "it was made safe before the turn of this command came"
        return self._refuse(
            registration,
            Refused(registration.behavior, registration.priority, told, now, now),
        )

    def _applied(
        self,
        registration: Registration,
        command: Any,
        applied: Any,
        asked: Any,
        by: str | None,
    ) -> Written[Any] | Refused:
        if isinstance(applied, Refused):
            return applied  # the device itself has said no
        if isinstance(applied, Written):
            applied = applied.command
        if applied is None:
            applied = command
        if self._journal.heard:
            self._journal.publish(
                Kind.APPLIED, self.name, registration.behavior, applied
            )
        return Written(applied, asked, by)

    def _turned_away(
        self, registration: Registration, command: Any, halts: int | None = None
    ) -> Refused:
        """Answer a write that may not even be looked at.

        Args:
            registration: Who writes.
            command: What.
            halts: How many halts there were when the write began to wait.

        Raises:
            EsairError: It is not the halt that keeps it.
        """
        halt = self.registrations.halt
        if halt is None and halts is not None and halts != self._halts:
            halt = Halt("it was asked for before the robot was halted", self._time())
        if halt is None or self.latched or not registration.usable:
            raise self._refusal(registration) from None
        self.refusals += 1
        refused = Refused(HALT, HALT_PRIORITY, halt.reason, halt.since, math.inf)
        if self._journal.heard:
            self._journal.publish(
                Kind.COMMAND, self.name, registration.behavior, command
            )
            self._journal.publish(
                Kind.REFUSED, self.name, registration.behavior, refused
            )
        return refused

    def _refusal(self, registration: Registration) -> EsairError:
        """Make the error for a write that may not even be looked at."""
        if not registration.usable:
            return self.registrations.refusal(registration)
        if self.latched:
            return StoppingError(self.name, "stopping")
        error = self.error or DeviceLostError(self.name, f"it is {self.state.value}")
        # Anew: else each who asks would leave its frames in the traceback.
        return error.with_traceback(None)

    async def _when_idle(
        self, registration: Registration, command: Any, hold: float | None
    ) -> Written[Any] | Refused:
        sent = await self._waiting.turn(registration, command, hold, self._halts)
        return sent if isinstance(sent, Answer) else await sent

    def _idle(self) -> None:
        super()._idle()
        self.operations.look()
        if self._guards:
            self.review()
        self._look()

    def _look(self) -> None:
        """Give those that wait their turn: the highest priority first, then the oldest.

        Whoever loses to it is refused, and never sent.
        """
        waiting = self._waiting
        if not waiting:
            return
        for write in waiting:
            accepts = self._accepts and write.halts == self._halts
            if not (write.registration.usable and accepts):
                waiting.remove(write)
                try:
                    write.end(
                        self._turned_away(
                            write.registration, write.command, write.halts
                        )
                    )
                except EsairError as error:
                    write.end(error)
        while waiting and not self._busy:
            write = waiting.first()
            if write.turn.done():
                continue
            try:
                write.end(self.begin(write.registration, write.command, write.hold))
            except Exception as error:
                write.end(error)

    def _withdraw(self, registration: Registration) -> None:
        """Have the waiting writes of a registration end without a command."""
        for write in self._waiting:
            if write.registration is registration:
                self._waiting.remove(write)
                write.end(
                    withdrawn(registration, self._time())
                    if registration.usable
                    else self._refusal(registration)
                )

    def _interrupted(self, error: Exception, command: Any) -> Exception:
        """Make the error for a command whose driver call has ended in an error."""
        return self._in_doubt(self._failed(error, "write"), command)

    def _in_doubt(self, failed: Exception, command: Any) -> Exception:
        if not isinstance(failed, DeviceLostError):
            return failed
        doubt = f"it is unknown whether {command!r:.80} was applied, it is not repeated"
        return DeviceLostError(
            self.name, f"{failed.detail}; {doubt}" if failed.detail else doubt
        )

    # Giving back.

    def release(self, registration: Registration) -> None:
        """Give the actuator back: lower priorities get through at once.

        What it was told stays until somebody writes or the command times out. A
        write of this registration that still waits for its turn is withdrawn.
        """
        self._withdraw(registration)
        if self.holder is registration:
            self.holder = None
            if self._blind is not None:
                self._keep_still()

    def drop(self, registration: Registration) -> None:
        """Make the actuator safe if what it does now is this registration's will.

        Its writes that wait for their turn are withdrawn.
        """
        self._withdraw(registration)
        self.operations.drop(registration)
        if self._writer is registration:
            self.make_safe()
        elif self.holder is registration:
            self.holder = None

    # The safe command.

    def make_safe(self, *, stay: bool = False) -> asyncio.Task[bool]:
        """Send the safe command, before anything else; nobody holds it afterwards.

        Args:
            stay: Tell it to stay instead, if its safe command is a place to go.

        Returns:
            The sending; its result tells whether the device took it.
        """
        self._disarm()
        if self.operations.running:
            self.operations.end(self._safe_instead())
        return super().make_safe(stay=stay)

    def _nobody_wrote(self) -> None:
        self._dead_man = None
        due = self._last_write + self.command_timeout
        if self._time() + _EARLY < due:
            self._dead_man = self._loop.call_at(due, self._nobody_wrote)
            return
        holder, until = self.holder, self.until
        self.timeouts += 1
        self.make_safe()
        if holder is not None and self._time() + _EARLY < until:
            self.holder = holder  # a longer hold keeps lower priorities away

    # Operations.

    def review(self) -> None:
        """Put what stands to the guards again; an operation is ended by a blind one."""
        if not self.operations.running:
            super().review()
        elif any(guard.stops for guard in self._guards):
            self.make_safe(stay=True)

    def ready_for(self, operation: Operating) -> bool:
        """Tell whether an operation may begin now: what moves is made safe first.

        Raises:
            AccessDeniedError: Somebody else holds the actuator, or is blind.
            StoppingError: The robot is stopping.
        """
        right, now = operation.registration, self._time()
        if self.latched:
            raise StoppingError(self.name, "stopping")
        rule = ""
        holder, blind = self.holder, self._blind
        if (
            blind is not None
            and right.priority <= blind.priority
            and blind.is_against(right.behavior)
        ):
            rule = blind.rule
        elif (stop := next((g for g in self._guards if g.stops), None)) is not None:
            rule = stop.rule
        elif (
            holder is not None
            and now < self.until
            and right.priority <= holder.priority
            and holder.behavior != right.behavior
        ):
            rule = rule_of(holder)
        if rule:
            raise AccessDeniedError(
                right.behavior, self.name, f"operate ({operation.name})", rule
            )
        if self._busy:
            return False
        if self.moves:
            self.make_safe(stay=True)
            return False
        if self.watch is not None and not self.watch.may_move():
            raise StoppingError(self.name, "made safe by the watchdog")
        return True

    def operating(self, operation: Operating, call: Call) -> None:
        """The device has begun with an operation: whoever asked for it holds it."""
        self._lane, self._busy = call, True
        self._told, self._told_safe = operation, False
        self._told_error = "it has not answered yet"
        self.holder = self._writer = operation.registration
        self.since, self.until = self._time(), operation.until

    def operated(self, call: Call | None) -> None:
        """An operation has its outcome: nobody knows what moves, so it is made safe."""
        if call is not None and call is self._lane and call.ended is not None:
            self._lane = None
        if self._safe_task is not None:
            self._again = True
        elif self.state is ResourceState.READY:
            self.make_safe(stay=True)
        self._idle()

    def _safe_instead(self) -> EsairError:
        """Make the error for an operation that the safe command has ended."""
        halt = self.registrations.halt
        if halt is not None:
            return HaltedError(self.name, halt.reason)
        if self.latched:
            return StoppingError(self.name, "stopping")
        right = self.operations.current
        stops = self._blind or next((g for g in self._guards if g.stops), None)
        return AccessDeniedError(
            "" if right is None else right.registration.behavior,
            self.name,
            "operate",
            "it was made safe meanwhile" if stops is None else stops.rule,
        )

    # What people ask.

    def why(self) -> Why:
        """Tell who holds the actuator, by which rule, and what would free it."""
        return why(self, self._time())
