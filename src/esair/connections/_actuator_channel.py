"""The way of commands to one actuator: who holds it, and what leaves."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Generator
from typing import TYPE_CHECKING, Any, NamedTuple

from esair.connections._calls import OPERATE, Call, End, Guard, Method
from esair.connections._device import Device, OfRobot, Operating
from esair.connections._gate import (
    BeingReplacedError,
    Gate,
    Hold,
    LastCommand,
    Registration,
    explain,
    lateness,
    rule_of,
    shut,
    verdict,
)
from esair.connections._protection import Guards, Protection, Stillness
from esair.connections._turns import (
    Decision,
    Sent,
    WaitingWrite,
    WaitingWrites,
    Wish,
)
from esair.connections._wire import NOT_YET, SafeCommand, Wire
from esair.exceptions import (
    AccessDeniedError,
    DeviceFaultError,
    EsairError,
    HaltedError,
    NoTurnError,
    ResourceRemovedError,
    StoppingError,
    describe,
)
from esair.journal import Kind
from esair.loop import REACHED, CallRefused
from esair.messages import Answer, Refused, ResourceState, Why, Written
from esair.resources import HOLD, Actuator

if TYPE_CHECKING:
    from esair.connections._sensor_channel import AppliedChannel

_new = Written.__new__  # hot

COMMAND, APPLIED = Kind.COMMAND, Kind.APPLIED  # hot

SENT: Written[Any] = Written(None)  # the answer to who does not look at it


class Sending(NamedTuple):
    """A write that waits for the device: await it for its outcome."""

    channel: ActuatorChannel
    call: Call
    registration: Registration
    command: Any
    asked: Any
    by: str | None
    halts: int  # how many there were when it left

    def __await__(self) -> Generator[Any, Any, Written[Any] | Refused]:
        return self.channel.finish(self).__await__()


class ActuatorChannel(Device):
    """Sends the commands of whoever holds the actuator, and the safe command.

    Every check and the call of the driver happen in one block without an await
    (`begin`), so nothing can change between the two. Each part knows those below it:
    the channel those that keep the actuator still, they its safe command, that the wire.
    """

    # Slots: a thousand of these are touched a hundred times a second.
    __slots__ = (
        "_dead_man",
        "_is_plain",
        "_waiting",
        "checked",
        "decision",
        "gate",
        "guards",
        "hold",
        "refusals",
        "safe",
        "stillness",
        "wire",
        "writes",
    )

    def __init__(self, actuator: Actuator[Any], robot: OfRobot) -> None:
        super().__init__(actuator.name, robot)
        self.writes: int = 0
        self.refusals: int = 0
        self._is_plain = False
        """Whether only a void right, or a holder, can be in a command's way, and no code of
        others runs before it leaves."""
        self.gate: Gate = Gate(self)
        self.hold: Hold = Hold()
        wire = Wire(self)
        self.wire: Wire = wire
        self.guards: Guards = Guards(wire)
        self.safe: SafeCommand = SafeCommand(wire, self)
        self.stillness: Stillness = Stillness(
            self, self.gate, self.hold, self.guards, wire, self.safe
        )
        self._dead_man = self.stillness.dead_man
        self._waiting = WaitingWrites(self)
        self.decision: Decision = Decision(self)  # what reactions want in this turn
        self.attach(actuator)

    def attach(self, actuator: Actuator[Any]) -> None:
        """Write to this actuator from now on; it is not ready yet."""
        self.take(actuator, self, self._late)
        self.guards.asked = None
        self.wire.attach(actuator)
        self.safe.attach()
        self.checked: Callable[[Any], Any] = self.wire.check.checked

    def configured(self) -> None:
        """Take over changed limits and time-outs."""
        self.wire.configured()
        self.checked = self.wire.check.checked
        self._settle()
        self._dead_man.hurry()

    # What others ask.

    @property
    def actuator(self) -> Actuator[Any]:
        return self.wire.actuator

    @property
    def is_safe(self) -> bool:
        """Whether the device was told its safe command last, took it, and is settled."""
        told = self.wire.told
        return told.is_safe and not told.error and self.wire.unsettled() is None

    @property
    def successes(self) -> int:
        """How many commands the device has taken."""
        return self.writes

    def told(self) -> LastCommand:
        """Report what it was told, and whether that is what it does."""
        told, error = self.wire.told, self.wire.told.error
        if told.is_undone and not error:
            error = "a motion, begun before it, has ended after it"
        earlier = self.wire.unsettled()
        if earlier is not None and not (error and earlier.kind == "safe"):
            error = f"{earlier}, begun before it, has not ended"
        return LastCommand(self.name, told.command, told.is_safe, not error, error)

    def not_told(self, error: BaseException) -> None:
        """Take note that the device could not be told its safe command."""
        self.wire.told.error = describe(error)

    def counts(self) -> dict[str, int]:
        return {
            "writes": self.writes,
            "refusals": self.refusals,
            "turned_away": self._waiting.turned_away,
            "timeouts": self.stillness.timeouts,
            "abandoned": self.calls.abandoned,
            "late": self.calls.late,
        }

    def tell_applied(self, channel: AppliedChannel) -> None:
        """Give each command that is applied to its readers from now on."""
        wire = self.wire
        wire.applied = channel
        if self.state is ResourceState.READY:
            channel.up()
            if not wire.told.error:
                wire.took(wire.told.place, None)
        elif self.error is not None:
            channel.down(self.state, self.error)

    # State, told by the supervisor.

    def _settle(self) -> None:
        """Look, once, whether anything shuts the gate: called at each change of that."""
        gate, halts = self.gate, self.gate.halts
        slow = self.guards.all or self.wire.check.takes_time
        self._is_plain = gate.is_plain and not slow
        if halts != gate.halts:  # a thread has halted the robot meanwhile
            self._is_plain = False

    def up(self) -> None:
        """The device is open and was told its safe command: writes may begin."""
        self.state = ResourceState.READY
        self.error = None
        if self.wire.applied is not None:
            self.tell_applied(self.wire.applied)
        self.safe.up()
        self._settle()

    def down(self, state: ResourceState, error: EsairError) -> None:
        """The device is gone: forget who held it and what it was told."""
        self._is_plain = False
        self.stillness.disarm()
        wire, told = self.wire, self.wire.told
        self.state: ResourceState = state
        self.error = error
        goes = state is ResourceState.REMOVED or type(error) is BeingReplacedError
        if told.error == "" and not (goes and told.is_safe):
            told.error = f"it is {state.value}"
        wire.lane = None
        if wire.applied is not None:
            wire.applied.down(state, error)
        self.calls.next_opening(error)
        self.idle()
        self.operations.gone(error)

    def removed(self) -> None:
        """The user took the device away."""
        self.down(ResourceState.REMOVED, ResourceRemovedError(self.name))

    def leaving(self, error: BeingReplacedError) -> None:
        """The device is about to go: only its safe command may leave, no write that waits."""
        self.error = error
        self.gate.since = self.time()
        self.gate.fence += 1
        self._settle()
        self._look()

    def latch(self) -> None:
        """Let nothing but safe commands leave from now on: the robot stops."""
        self.gate.latched = True
        self.gate.fence += 1
        self._settle()
        self.safe.latch(self.time() + self.wire.patience)
        self._look()
        if self.state is ResourceState.READY and not self.is_safe:
            self.make_safe()

    def bar(self) -> None:
        """Let no command pass any more, from any thread; `halt` follows in the loop."""
        self.gate.halts += 1
        self._is_plain = False

    def withdraw(self) -> None:
        """Let nothing leave that was asked for until now."""
        self.gate.halts += 1
        self._look()

    def halt(self) -> None:
        """Send the safe command, and nothing but it until `resume`."""
        self.bar()
        self._look()
        if self.state is ResourceState.READY:
            self.make_safe()

    def resume(self) -> None:
        """Let commands pass again; the device was told its safe command last."""
        self._settle()

    def protect(
        self, holds: tuple[Protection, ...], guards: tuple[Protection, ...]
    ) -> None:
        """Obey these from this moment on; the table calls it at each change."""
        self.gate.holds = holds
        self.guards.obey(guards)
        self._settle()
        self.stillness.keep_still()

    # The safe command.

    def make_safe(self, *, stay: bool = False) -> asyncio.Task[bool]:
        """Send the safe command, before anything else; nobody holds it afterwards."""
        return self.safe.make(stay=stay)

    def made_safe(self) -> None:
        """It gets its safe command: what was begun, and who held it, is over."""
        self.stillness.disarm()
        if self.operations.running:
            self.operations.end(self._safe_instead())

    def keep_still(self) -> None:
        """Make it safe if somebody is blind, unless a higher priority moves it."""
        self.stillness.keep_still()

    def review(self) -> None:
        """Put what stands to the guards again; only less than that may leave now.

        An operation is ended by one that lets nothing pass.
        """
        if not self.operations.running:
            self.stillness.review(self._ended)
        elif self.guards.asked_anew(moving=True) is not None:
            self.make_safe(stay=True)

    # The commit block.

    def begin(
        self,
        registration: Registration,
        command: Any,
        hold: float | None,
        wish: Wish | None = None,
        ready: Any = None,
        now: float | None = None,
        again: bool = False,
        expires: float | None = None,
    ) -> Sent:
        """Check everything and send a command, without a wait if the driver has none.

        What is ``ready`` is the command as `checked` has returned it in this turn,
        ``now`` is when the turn has begun: all that decide in it share one number.
        The ``wish`` that it is of is told no more than that it is sent, and may be renewed.
        ``again``: it has waited for its turn, and the journal has heard of it. After
        the moment when it ``expires`` it does not leave any more, however it has waited.
        """
        if now is None:
            time = self.time  # hot
            now = time()
        held, heard = self.hold, self._journal.heard
        holder, numbers = held.holder, None
        # One shortcut: what nothing stands in the way of needs no verdict.  # hot
        if not (
            self._is_plain
            and registration.usable
            and (holder is registration or holder is None)
        ):
            numbers = self.gate.numbers
            refused = verdict(self.gate, held, registration, now)
            if refused is not None:
                return self._kept_away(registration, command, refused, now, again)
        if heard.command and not again:
            self.wanted(registration, command)
        asked = command
        if ready is None:
            checked = self.checked  # hot
            command = checked(command)
        else:
            command = ready
        wire = self.wire
        # Late: between this look and the driver only guards take time, and then once more.
        if expires is not None and (late := lateness(self, expires)) > 0.0:
            return self._expired(registration, late)
        if wire.lane is not None or self.safe.state is not None:
            halts = self.gate.halts if numbers is None else numbers[0]
            waits = WaitingWrite(registration, command, hold, halts, expires, wish)
            return self._when_idle(waits)
        if wire.slews:
            command = self._slewed(command, now)
        # `Hold` takes it here, in place.  # hot
        if holder is not registration or now + REACHED >= held.begun + held.seconds:
            held.since, held.before = now, getattr(held.writer, "number", 0)
        held.holder = held.writer = registration
        held.begun = held.written = now
        held.seconds = hold or registration.hold or wire.command_timeout
        by = None
        if numbers is not None:
            stop, by, command = self._protected(command)
            if stop is not None:
                return self.refuse(registration, stop.refusal())
            # The code of a check, or a guard, takes its time, and may have halted.
            if numbers != self.gate.numbers or not registration.usable:
                return self._fenced(registration, numbers[0])
            if expires is not None and (late := lateness(self, expires)) > 0.0:
                self.make_safe()  # what it took over is nobody's any more
                return self._expired(registration, late)
        if not self._dead_man.armed:
            self._dead_man.arm()
        guard: Guard | None = None
        if wire.blocks:
            guard = self.gate.ticket(registration, expires, numbers)
        try:
            sent = wire.send(command, registration.behavior, guard)
        except (NoTurnError, DeviceFaultError) as error:
            self.stillness.not_taken(error, registration, now)
            raise
        if sent is not None or wire.applied is not None:
            return self._sent(sent, registration, command, asked, by, expires, now)
        # Most drivers say nothing.
        self.writes += 1
        if heard.applied:
            self._journal.publish(APPLIED, self.name, registration.behavior, command)
        if wish is not None:
            return SENT
        written = _new(Written)
        written.command, written.asked, written.by = command, asked, by
        return written

    def _expired(self, registration: Registration, late: float) -> Refused:
        expired = self._too_late(registration, f"it expired {late:.3g} s ago")
        return self.refuse(registration, expired)

    def _sent(
        self,
        sent: Any,
        right: Registration,
        command: Any,
        asked: Any,
        by: str | None,
        expires: float | None = None,
        now: float | None = None,
    ) -> Sent:
        """Return what comes of a command that the driver has."""
        if type(sent) is Call:
            sent.owner, sent.apply = right, self._ended
            sent.takes_over = self.hold.takes_over(right, now)
            if expires is not None:
                self.calls.withdraw_at(expires, sent)
            return Sending(self, sent, right, command, asked, by, self.gate.halts)
        self.writes += 1
        self.wire.took(command, sent)
        return self._applied(right, command, sent, asked, by)

    def _slewed(self, command: Any, now: float) -> Any:
        """Bound how fast commands change."""
        wire = self.wire
        # After a pause it starts from the safe command, not with a jump.
        seconds = now - max(self.hold.begun, wire.told.at)
        return wire.slewed(command, min(seconds, wire.command_timeout))

    def _kept_away(
        self,
        registration: Registration,
        command: Any,
        refused: Refused | EsairError,
        now: float,
        again: bool,
    ) -> Sent:
        """Answer what the verdict is against, but for what asks to be safe."""
        if not isinstance(refused, Refused):
            raise refused
        if self._journal.heard.command and not again:
            self.wanted(registration, command)
        gate = self.gate
        if gate.holds and self.stillness.is_still(command):
            held = self.hold
            if verdict(gate, held, registration, now, is_still=True) is None:
                still = self.checked(command)
                if self.stillness.is_still(still):
                    return self._send_still(registration, still)
        return self.refuse(registration, refused)

    def _send_still(self, registration: Registration, command: Any) -> Sent:
        """Send what is safe past the blind holds: it moves nothing, and holds nothing."""
        wire = self.wire
        if wire.lane is not None or self.safe.state is not None:
            halts = self.gate.halts
            return self._when_idle(WaitingWrite(registration, command, None, halts))
        moved = self.stillness.moves
        guard = self.gate.ticket(registration) if wire.blocks else None
        sent = wire.send(command, registration.behavior, guard)
        if moved and type(sent) is not Call:  # else nobody knows yet whether it came
            self.stillness.disarm()  # that motion is over, and its time-out with it
            if wire.watch is not None:
                wire.watch.is_safe()
        return self._sent(sent, registration, command, command, None)

    def _protected(self, command: Any) -> tuple[Protection | None, str | None, Any]:
        """Return the guard that refuses a command, who has weakened it, and what passes."""
        guards, stillness = self.guards, self.stillness
        stop: Protection | None = None
        by: str | None = None
        if guards.all and command is not HOLD:  # what is safe passes no guard
            stop, by, command = guards.weigh(command, moving=stillness.moves)
            if stop is not None:
                stillness.stay()
                return stop, by, None
        if self.gate.holds:
            stillness.look_when_over()
        return stop, by, command

    def _ended(self, call: Call, end: End) -> None:
        """Apply the outcome of a write that has waited for the device."""
        wire, is_over = self.wire, end.error is None
        if end.error is None:
            self.writes += 1
            if self.hold.writer is call.owner:
                self.hold.written = self.time()
            if not wire.told.is_safe:
                wire.told.error = ""
            wire.took(call.args[0], end.value)
        elif isinstance(end.error, CallRefused):
            right = call.owner if isinstance(call.owner, Registration) else None
            # It was told as sent; who waits for it takes that back, or has gone.
            if right is None or call.cancelled:  # None: less of what stands, by a guard
                self.refuse(right, self._overtaken(right))
        elif call.cancelled:
            wire.unknown()
        elif type(wire.failed(end.error, "write")) is not NoTurnError:
            # Who wrote hears of it; no guard does, nor who held it before.
            is_over = call.owner is not None and not call.takes_over
            self.keep_still()
        if not (is_over or self.safe.state or self.safe.overtaken(call)):
            if isinstance(end.error, CallRefused):
                wire.told.command = wire.told.base
            self.make_safe(stay=call.owner is None)  # what it took over is nobody's
        if call.ended is not None:  # else its driver still has the device
            self._lane_free(call)

    async def finish(self, sending: Sending) -> Written[Any] | Refused:
        """Wait for the outcome of a write that is on its way."""
        right, command = sending.registration, sending.command
        try:
            applied = await self.calls.outcome(sending.call)
        except CallRefused:
            return self._fenced(right, sending.halts)
        except Exception as error:
            failed = self.wire.in_doubt(self.wire.translated(error), command)
            raise failed from failed.__cause__
        return self._applied(right, command, applied, sending.asked, sending.by)

    def _fenced(self, right: Registration, halts: int) -> Refused:
        """Refuse a command that was on its way when something shut the gate."""
        refused = shut(self.gate, right, self.time(), halts)
        if refused is None:
            refused = self._overtaken(right)
        if not isinstance(refused, Refused):
            raise refused from None
        return self.refuse(right, refused)

    def _overtaken(self, right: Registration | None) -> Refused:
        """Answer a write that the safe command came before, in the driver's lane."""
        holds = self.gate.holds
        stops = holds[0] if holds else self.guards.stopping
        if stops is not None:
            return stops.refusal()
        return self._too_late(
            right, "it was made safe, or this expired, before its turn came"
        )

    def _too_late(self, right: Registration | None, told: str) -> Refused:
        """Answer a write whose turn did not come in time, for which nobody is to blame."""
        now = self.time()
        who = ("", 0) if right is None else (right.behavior, right.priority)
        return Refused(*who, told, now, now)

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
        elif (wrong := self.wire.unsound(command, applied)) is not None:
            raise wrong
        if self._journal.heard.applied:
            self._journal.publish(APPLIED, self.name, registration.behavior, applied)
        return Written(applied, asked, by)

    # Refusals.

    def lost(
        self, registration: Registration, command: Any, winner: Registration
    ) -> Refused:
        """Refuse a command that another one of the same turn has beaten."""
        if self._journal.heard.command:
            self.wanted(registration, command)
        refused = self.hold.refusal(self.hold.holder or winner)
        return self.refuse(registration, refused)

    def wanted(self, registration: Registration, command: Any) -> None:
        """Tell what somebody wants sent, whatever becomes of it."""
        if self.wire.copies:
            # It is read when it may have changed; it may be an object of any class.
            with contextlib.suppress(Exception):
                command = self.wire.copied(command)
        self._journal.publish(COMMAND, self.name, registration.behavior, command)

    def refuse(self, right: Registration | None, refused: Refused) -> Refused:
        self.refusals += 1
        if self._journal.heard.refused:
            behavior = "" if right is None else right.behavior
            self._journal.publish(Kind.REFUSED, self.name, behavior, refused)
        return refused

    # Writes that wait until the device is free.

    async def _when_idle(self, write: WaitingWrite) -> Written[Any] | Refused:
        current = self.operations.current
        if current is not None and current.call is not None:
            right, told = current.registration, rule_of(write.registration)
            if write.registration.priority > right.priority:  # that is finished first
                denied = AccessDeniedError(right.behavior, self.name, OPERATE, told)
                self.operations.end(denied)
                self.make_safe(stay=True)
        sent = await self._waiting.turn(write)
        return sent if isinstance(sent, Answer) else await sent

    def _look(self) -> None:
        """Give those that wait their turn: the highest priority first, then the oldest.

        Whoever loses to it is refused, and never sent.
        """
        waiting = self._waiting
        if not waiting:
            return
        for write in waiting:
            right = write.registration
            refused = shut(self.gate, right, self.time(), write.halts)
            if refused is not None:
                waiting.remove(write)
                if isinstance(refused, Refused):
                    self.refuse(right, refused)
                write.end(refused)
        while waiting and self.wire.lane is None and self.safe.state is None:
            write = waiting.first()
            if write.turn.done():
                continue
            try:
                right, command, hold = write.registration, write.command, write.hold
                until = write.expires
                write.end(self.begin(right, command, hold, again=True, expires=until))
            except Exception as error:
                write.end(error)

    def renew(self, wish: Wish, command: Any) -> bool:
        """Let its write that waits be of a newer command; tell whether one waits."""
        for write in self._waiting:
            if write.wish is wish and not write.turn.done():
                if self._journal.heard.command:
                    self.wanted(write.registration, command)
                write.command = command
                return True
        return False

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
                    else self.registrations.refusal(registration)
                )

    # Giving back.

    def release(self, registration: Registration) -> None:
        """Give the actuator back: lower priorities get through at once.

        What it was told stays until somebody writes or the command times out. A write
        that still waits for its turn is withdrawn.
        """
        self._withdraw(registration)
        if self.hold.holder is registration:
            self.hold.holder = None
            if not self.decision.changes_hands:
                self.keep_still()

    def drop(self, registration: Registration) -> None:
        """Make the actuator safe if what it does now is this registration's will.

        Its writes that wait for their turn are withdrawn.
        """
        self._withdraw(registration)
        self.operations.drop(registration)
        if self.hold.writer is registration:
            self.make_safe()
        elif self.hold.holder is registration:
            self.hold.holder = None

    # Calls that have ended.

    def _late(self, call: Call) -> None:
        """A call has ended whose outcome was out before: who knows what it did."""
        if call is self.wire.lane:
            self._lane_free(call)
        elif call.may_move:
            self.safe.repeat()
            if self.state is ResourceState.LOST:  # because that did not end
                self.actuator.report_arrived()
        self.safe.pulse()

    def _lane_free(self, call: Call) -> None:
        if call is self.wire.lane:
            self.wire.lane = None
        if call.may_move and self.safe.overtaken(call):
            self.safe.repeat()
        self.idle()

    def idle(self) -> None:
        """Something has ended: let those that wait look again."""
        self.safe.pulse()
        self.operations.look()
        if self.guards.all:
            self.review()
        self._look()

    # Operations, and calls between two commands.

    def between(
        self, method: Method, told: Callable[[End], None], limit: float
    ) -> Call | bool:
        """Call the driver between two commands; returns what is false if it is not free."""
        wire = self.wire
        if wire.lane is not None or self.safe.state is not None or self.calls.alive:
            return False

        def ended(call: Call, end: End) -> None:
            told(end)
            if call.ended is not None and call is wire.lane:
                self._lane_free(call)

        waits = self.calls.attempt(method, limit, told, ended)
        if waits is not None:
            wire.lane = waits
        return waits or True

    def ready_for(self, operation: Operating) -> bool:
        """Tell whether an operation may begin now: what moves is made safe first."""
        right = operation.registration
        now, wire = self.time(), self.wire
        refused = verdict(self.gate, self.hold, right, now, operates=True)
        if (above := self._waiting.above(right.priority)) and refused is None:
            refused = self.hold.refusal(above)
        if refused is None:
            if wire.lane is not None or self.safe.state is not None:
                return False
            moving = self.stillness.moves
            if (guard := self.guards.asked_anew(moving=moving)) is not None:
                refused = guard.refusal()
            elif self.safe.is_refused:
                refused = Refused(self.name, 0, wire.told.error, now, None)
        if isinstance(refused, Refused):
            raise AccessDeniedError(
                right.behavior, self.name, f"operate ({operation.name})", refused.rule
            )
        if refused is not None:
            raise refused
        if moving:
            self.make_safe(stay=True)
            return False
        wire.about_to_move()
        return True

    def operating(self, operation: Operating, call: Call) -> None:
        """The device has begun with an operation: whoever asked for it holds it."""
        wire, hold = self.wire, self.hold
        wire.lane = call
        wire.told.command, wire.told.is_safe = operation, False
        wire.told.error = NOT_YET
        hold.holder = hold.writer = operation.registration
        hold.since = self.time()
        hold.begun, hold.seconds = operation.until, 0.0

    def operated(self, call: Call | None) -> None:
        """An operation has its outcome: nobody knows what moves, so it is made safe."""
        if call is not None and call is self.wire.lane and call.ended is not None:
            self.wire.lane = None
        self.safe.after_operation()
        self.idle()

    def _safe_instead(self) -> EsairError:
        """Make the error for an operation that the safe command has ended."""
        halt, holds = self.registrations.halt, self.gate.holds
        if halt is not None:
            return HaltedError(self.name, halt.reason)
        if self.gate.latched:
            return StoppingError(self.name, "stopping")
        current = self.operations.current
        stops = holds[0] if holds else self.guards.shut
        return AccessDeniedError(
            "" if current is None else current.registration.behavior,
            self.name,
            "operate",
            "it was made safe meanwhile" if stops is None else stops.rule,
        )

    # What people ask.

    def why(self) -> Why:
        """Tell who holds the actuator, by which rule, and what would free it."""
        now, told = self.time(), self.wire.told.command
        there = getattr(self.actuator, "refused", None)  # by the robot that has it
        if not isinstance(there, Refused):
            there = None
        return explain(
            self.gate, self.hold, now, told, is_safe=self.is_safe, there=there
        )
