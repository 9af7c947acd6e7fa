"""The way of commands to one actuator: who holds it, and what leaves."""

from __future__ import annotations

import asyncio
import copy
from collections.abc import Generator
from typing import Any

import attrs

from esair.connections._call import Call, End
from esair.connections._command_check import CommandCheck
from esair.connections._decision import Decision
from esair.connections._device import OfRobot
from esair.connections._driver import Guard
from esair.connections._held_device import BeingReplacedError, HeldDevice
from esair.connections._registrations import Registration
from esair.connections._waiting_writes import Sent, WaitingWrites
from esair.exceptions import DeviceLostError, EsairError, StoppingError
from esair.journal import Kind
from esair.loop import CallRefused
from esair.messages import Answer, Refused, ResourceState, Written
from esair.resources import HOLD, Actuator

_EARLY = 1e-6  # timers may fire a hair early


_new = Written.__new__
"""Makes an answer to be filled in, in half of the time."""

_SENT: Written[Any] = Written(None)  # the answer to who does not look at it


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
        self.halts: int = channel.halts
        self.fence = channel.fence

    def __await__(self) -> Generator[Any, Any, Written[Any] | Refused]:
        return self.channel.finish(self).__await__()


class ActuatorChannel(HeldDevice):
    """Sends the commands of whoever holds the actuator, and the safe command.

    Every check and the call of the driver happen in one block without an await
    (`begin`), so nothing can change between the two.
    """

    # Slots: a thousand of these are touched a hundred times a second.
    __slots__ = (
        "_accepts",
        "_blocks",
        "_check",
        "_copies",
        "_deadline",
        "_slews",
        "_waiting",
        "checked",
        "decision",
        "writes",
    )

    def __init__(self, actuator: Actuator[Any], robot: OfRobot) -> None:
        loop = asyncio.get_running_loop()
        self.writes = 0
        self._accepts = False
        self._waiting = WaitingWrites(actuator.name, loop)
        self.decision = Decision(self, loop)  # what reactions want of it in this turn
        super().__init__(actuator, robot)

    def attach(self, actuator: Actuator[Any]) -> None:
        """Write to this actuator from now on; it is not ready yet."""
        super().attach(actuator)
        self._blocks = self._write.executor is not None

    def configured(self) -> None:
        """Take over changed limits and time-outs."""
        super().configured()
        self._deadline = self.actuator.deadline
        self._check = CommandCheck(self.actuator)
        self.checked = self._check.checked
        self._slews = self._check.slews
        self._write = write = self.driver.method("write")
        self._copies = self._check.copies
        if self._copies:
            # The driver's and the guards' code may change what is in theirs.
            self._write = attrs.evolve(
                write, function=lambda command: write.function(copy.deepcopy(command))
            )

    @property
    def successes(self) -> int:
        """How many commands the device has taken."""
        return self.writes

    def counts(self) -> dict[str, int]:
        return {
            "writes": self.writes,
            "refusals": self.refusals,
            "turned_away": self._waiting.turned_away,
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
        self._last_moment = self.time() + patience
        self._look()
        if self.state is ResourceState.READY and not self.is_safe:
            self.make_safe()

    def bar(self) -> None:
        """Let no command pass any more, from any thread; `halt` follows in the loop."""
        self._accepts = False
        self.halts += 1

    def withdraw(self) -> None:
        """Let nothing leave that was asked for until now."""
        self.halts += 1
        self._look()

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

    def leaving(self, error: BeingReplacedError) -> None:
        """The device is about to go: only its safe command may leave, no write that waits."""
        self.error = error
        self.since = self.time()
        self._accepts = False
        self._look()

    def down(self, state: ResourceState, error: EsairError) -> None:
        """The device is gone: forget who held it and what it was told."""
        self._accepts = False
        super().down(state, error)

    # The commit block.

    def begin(
        self,
        registration: Registration,
        command: Any,
        hold: float | None,
        told: bool = True,
        ready: Any = None,
        now: float | None = None,
    ) -> Sent:
        """Check everything and send a command, without a wait if the driver has none.

        What is ``ready`` is the command as `checked` has returned it in this turn,
        ``now`` is when the turn has begun: all that decide in it share one number.
        """
        if not (registration.usable and self._accepts):
            return self._turned_away(registration, command)
        if now is None:
            time = self.time  # by itself: called in place it is sought as a method
            now = time()
        journal = self._journal
        if journal.heard:
            self.wanted(registration, command)
        blind = self._blind
        barred = blind is not None and registration.priority <= blind.priority
        if barred and blind is not None and not self.is_still(command):
            return self._refuse(registration, blind.refusal())
        holder = self.holder
        if (
            holder is not registration
            and holder is not None
            and now + _EARLY < self.until
            and registration.priority <= holder.priority
            and holder.behavior != registration.behavior
        ):
            return self._refused(registration, holder)
        asked = command
        if ready is None:
            checked = self.checked
            command = checked(command)
        else:
            command = ready
        if self._busy:
            return self._when_idle(registration, command, hold)
        if self.watch is not None and not self.watch.may_move():
            raise StoppingError(self.name, "made safe by the watchdog")
        if self._slews and not barred:  # safe is at once
            # After a pause it starts from the safe command, not with a jump.
            seconds = now - max(self._last_write, self._told_at)
            seconds = min(seconds, self.command_timeout)
            command = self._slewed(command, seconds)
        # What is safe passes a blind hold, and holds nothing then.
        if not barred:
            # Two numbers that others have too: their sum would be one more in memory.
            if holder is not registration or now >= self._held_from + self._held_for:
                self.since = now
            self.holder = self._writer = registration
            self._held_from = self._last_write = now
            self._held_for = hold or registration.hold or self.command_timeout
        by = None
        if self._guards:
            stop, by, command = self._pass_guards(command, now)
            if stop is not None:
                self._stay()
                return self._refuse(registration, stop.refusal())
        # A copy of its own: who has the answer may change what is in it.
        self._told = copy.deepcopy(command) if self._copies else command
        self._told_safe = False
        if blind is not None:
            self.keep_still()  # when this one holds it no longer
        if not (self._dead_man.armed or barred):
            self._dead_man.arm()
        self._busy = True
        if journal.heard:
            journal.publish(Kind.SENT, self.name, registration.behavior, command)
        guard = self._guard(registration) if self._blocks else None
        try:
            sent = self.calls.begin(
                "write", self._write, (command,), self._deadline, guard
            )
        except Exception as error:
            self._busy = self._lane is not None or self._safe_task is not None
            failed = self._interrupted(error, command)
            raise failed from failed.__cause__
        if sent is not None and type(sent) is Call:
            sent.apply = self._ended
            sent.owner = registration
            self._lane = sent
            self._told_error = "it has not answered yet"
            return _Sending(self, sent, registration, command, asked, by)
        # Done: most drivers need not wait.
        self._busy = self._safe_task is not None
        self.writes += 1
        self._told_error = ""
        if sent is None and self.applied is None and not journal.heard:
            # Most drivers say nothing.
            if not told:
                return _SENT
            written = _new(Written)
            written.command, written.asked, written.by = command, asked, by
            return written
        self._took(command, sent)
        return self._applied(registration, command, sent, asked, by)

    def _copied(self, command: Any) -> Any:
        """Return a command that nobody but its holder can change."""
        return copy.deepcopy(command) if self._copies else command

    def _slewed(self, command: Any, seconds: float) -> Any:
        before = self._base if self._told is HOLD else self._told
        if before is None or before is HOLD:
            return command  # nobody knows where it stays: its driver has not said
        if command is HOLD:
            self._base = before
            return command
        return self._check.slewed(command, before, seconds)

    def _guard(self, registration: Registration) -> Guard:
        """Return the checks that a thread makes when the turn of a command comes."""
        halts, may_leave = self.halts, self._may_leave()
        return lambda: registration.usable and halts == self.halts and may_leave()

    def _ended(self, call: Call, end: End) -> None:
        """Apply the outcome of a write that has waited for the device."""
        if end.error is None:
            self.writes += 1
            if self._writer is call.owner:
                self._last_write = self.time()
            if not self._told_safe:
                self._told_error = ""
            self._took(call.args[0], end.value)
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
                sending.fence != self.fence
                and sending.halts == self.halts
                and registration.usable
                and self._accepts
            ):
                return self._overtaken(registration)
            return self._turned_away(registration, command, sending.halts)
        except Exception as error:
            failed = self._in_doubt(self._translated(error), command)
            raise failed from failed.__cause__
        return self._applied(registration, command, applied, sending.asked, sending.by)

    def _overtaken(self, registration: Registration) -> Refused:
        """Answer a write that the safe command came before, in the driver's lane."""
        stops = self._blind or next((g for g in self._guards if g.stopping), None)
        if stops is not None:
            return self._refuse(registration, stops.refusal())
        told = "it was made safe before the turn of this command came"
        return self._refuse(registration, self._too_late(registration, told))

    def _too_late(self, registration: Registration, told: str) -> Refused:
        """Answer a write whose turn did not come in time, for which nobody is to blame."""
        now = self.time()
        return Refused(registration.behavior, registration.priority, told, now, now)

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

    async def _when_idle(
        self, registration: Registration, command: Any, hold: float | None
    ) -> Written[Any] | Refused:
        sent = await self._waiting.turn(registration, command, hold, self.halts)
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
            accepts = self._accepts and write.halts == self.halts
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
                told = (
                    f"{registration.behavior!r} gave it back before the turn of this "
                    "command came"
                )
                write.end(
                    self._too_late(registration, told)
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
        doubtful = DeviceLostError(
            self.name, f"{failed.detail}; {doubt}" if failed.detail else doubt
        )
        doubtful.__cause__ = failed
        return doubtful

    # Giving back.

    def release(self, registration: Registration) -> None:
        """Give the actuator back; a write that still waits for its turn is withdrawn."""
        self._withdraw(registration)
        super().release(registration)

    def drop(self, registration: Registration) -> None:
        """Make the actuator safe if what it does now is this registration's will.

        Its writes that wait for their turn are withdrawn.
        """
        self._withdraw(registration)
        super().drop(registration)
