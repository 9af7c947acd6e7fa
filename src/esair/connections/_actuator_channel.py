"""The way of commands to one actuator: who holds it, and its safe command."""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import Callable, Coroutine
from typing import Any, NamedTuple

from esair.connections._command_check import CommandCheck
from esair.connections._decision import Decision
from esair.connections._driver import Driver, Guard, is_drivers, translate
from esair.connections._halt import HALT, HALT_PRIORITY, Halt
from esair.connections._registrations import Registration, Registrations
from esair.exceptions import (
    BusyError,
    DeviceLostError,
    DriverStuckError,
    EsairError,
    ResourceRemovedError,
    StoppingError,
    describe,
)
from esair.journal import Kind
from esair.loop import CallRefused, Suspended, clock_of, finish, first_step, spawn
from esair.messages import Answer, Refused, ResourceState, Why, Written
from esair.resources import Actuator

WAITING_LIMIT = 256
"""How many writes may wait for one actuator at a time."""

SAFE_TRIES = 3
"""How often the safe command is tried before the actuator counts as unsafe."""

TURN_WITHIN = 0.3
"""How long the safe command waits at most for a write in flight, in seconds."""

_EARLY = 1e-6  # timers may fire a hair early

_log = logging.getLogger("esair")


class LastCommand(NamedTuple):
    """What an actuator was told last.

    Attributes:
        resource: The name of the actuator.
        command: The last command that was handed to its driver.
        safe: Whether that was its safe command.
        answered: Whether the driver took it without an error.
        error: The error of the driver, in words; empty if it took it.
    """

    resource: str
    command: object
    safe: bool
    answered: bool
    error: str = ""

    def __str__(self) -> str:
        answer = "answered" if self.answered else f"NOT ANSWERED ({self.error})"
        return (
            f"{self.resource}: {'safe ' if self.safe else ''}{self.command!r}: {answer}"
        )


class _Waiting:
    """A write, or something of the channel itself, that waits until it may look again."""

    __slots__ = ("registration", "withdrawn", "woken")

    def __init__(
        self, registration: Registration | None, woken: asyncio.Future[None]
    ) -> None:
        self.registration = registration
        self.woken = woken
        self.withdrawn = False

    def wake(self) -> None:
        if not self.woken.done():
            self.woken.set_result(None)


class ActuatorChannel:
    """Sends the commands of whoever holds the actuator, and the safe command.

    Every check and the call of the driver happen in one block without an await
    (`begin`), so nothing can change between the two.
    """

    # Slots: a thousand of these are touched a hundred times a second.
    __slots__ = (
        "_accepts",
        "_blocks",
        "_busy",
        "_call",
        "_check",
        "_checked",
        "_dead_man",
        "_halts",
        "_journal",
        "_last_moment",
        "_last_write",
        "_loop",
        "_on_error",
        "_opening",
        "_safe_again",
        "_safe_task",
        "_slews",
        "_take_over_turn",
        "_time",
        "_told",
        "_told_error",
        "_told_safe",
        "_waiters",
        "_writer",
        "actuator",
        "command_timeout",
        "decision",
        "driver",
        "error",
        "holder",
        "latched",
        "name",
        "refusals",
        "registrations",
        "since",
        "state",
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
    ) -> None:
        self.name = actuator.name
        self.state = ResourceState.CLOSED
        self.error: EsairError | None = None
        self._last_moment = math.inf
        """Until when the stop of the robot waits for the safe command."""
        self.latched = False
        """Set when the robot stops: from then on only the safe command leaves."""
        self.holder: Registration | None = None
        self.since = 0.0
        self.until = 0.0
        self.writes = 0
        self.refusals = 0
        self.timeouts = 0
        """How often the safe command was sent because nobody wrote."""
        self.registrations = registrations
        self._journal = registrations.journal
        self._loop = loop
        self._time = clock_of(loop)
        self._on_error = on_error
        self.decision = Decision(self, loop)
        """What reactions want of it in this turn."""
        self._writer: Registration | None = None
        self._last_write = 0.0
        self._accepts = False
        self._busy = False
        self._waiters: list[_Waiting] = []
        self._dead_man: asyncio.TimerHandle | None = None
        self._safe_task: asyncio.Task[bool] | None = None
        self._safe_again = False
        self._take_over_turn: asyncio.Future[None] | None = None
        self._halts = 0
        """Grows with each halt: a command from before is never sent after it."""
        self._opening = 0
        """Grows when the device is gone: what it answers after that is no news."""
        self._told: Any = None
        self._told_safe = False
        self._told_error = "it was never told anything"
        self.attach(actuator)

    def attach(self, actuator: Actuator[Any]) -> None:
        """Write to this actuator from now on; it is not ready yet."""
        self.actuator = actuator
        self.driver = Driver(actuator)
        self._blocks = self.driver.blocks("write")
        self._call = self.driver.call("write")
        self.configured()

    def configured(self) -> None:
        """Take over changed limits and time-outs."""
        self._check = CommandCheck(self.actuator)
        self._checked = self._check.checked
        self._slews = self._check.slews
        self.command_timeout = float(self.actuator.command_timeout)

    @property
    def _patience(self) -> float:
        """How long to wait for the safe command, in seconds."""
        return self.actuator.deadline + self._turn_within + 0.1

    @property
    def _turn_within(self) -> float:
        """How long the safe command waits for a write in flight, in seconds."""
        return min(self.actuator.deadline, self.command_timeout, TURN_WITHIN)

    @property
    def successes(self) -> int:
        """How many commands the device has taken."""
        return self.writes

    def counts(self) -> dict[str, int]:
        """Return the counters, by name."""
        return {
            "writes": self.writes,
            "refusals": self.refusals,
            "timeouts": self.timeouts,
        }

    # State, told by the supervisor.

    def up(self) -> None:
        """The device is open and was told its safe command: writes may begin."""
        self.state = ResourceState.READY
        self.error = None
        self._accepts = not self.latched and self.registrations.halt is None

    def latch(self) -> None:
        """Let nothing but safe commands leave from now on: the robot stops."""
        self.latched = True
        self._accepts = False
        self._last_moment = self._time() + self._patience
        self._wake()
        if self.state is ResourceState.READY and not self.is_safe:
            self.make_safe()

    def bar(self) -> None:
        """Let no command pass any more, from any thread; `halt` follows in the loop."""
        self._accepts = False
        self._halts += 1

    def halt(self) -> None:
        """Send the safe command, and nothing but it until `resume`."""
        self.bar()
        self._wake()
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
        self._wake()

    def down(self, state: ResourceState, error: EsairError) -> None:
        """The device is gone: forget who held it and what it was told."""
        self.state = state
        self.error = error
        self._accepts = False
        self._opening += 1
        self._disarm()
        self._wake()

    def closed(self) -> None:
        """Nobody waits for the safe command any more; a thread that has it goes on."""
        if self._safe_task is not None:
            self._safe_task.cancel()

    def removed(self) -> None:
        """The user took the actuator away."""
        self.down(ResourceState.REMOVED, ResourceRemovedError(self.name))

    def _disarm(self) -> None:
        self.holder = self._writer = None
        if self._dead_man is not None:
            self._dead_man.cancel()
            self._dead_man = None

    # The commit block.

    def begin(
        self, registration: Registration, command: Any, hold: float | None
    ) -> Written[Any] | Refused | Coroutine[Any, Any, Written[Any] | Refused]:
        """Check everything and send a command, without a wait if the driver has none.

        Returns:
            The outcome, or the rest of the work, to be awaited in the same task.

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
        holder = self.holder
        if (
            holder is not registration
            and holder is not None
            and now < self.until
            and registration.priority <= holder.priority
            and holder.behavior != registration.behavior
        ):
            return self._refused(registration, holder)
        command = self._checked(command)
        if self._busy:
            return self._when_idle(registration, command, hold)
        if self._slews:
            # After a pause it starts from the safe command, not with a jump.
            seconds = min(now - self._last_write, self.command_timeout)
            command = self._check.slewed(command, self._told, seconds)
        if holder is not registration or now >= self.until:
            self.since = now
        self.holder = self._writer = registration
        self.until = now + (hold or registration.hold or self.command_timeout)
        self._last_write = now
        self._told = command
        self._told_safe = False
        if self._dead_man is None:
            self._dead_man = self._loop.call_at(
                now + self.command_timeout, self._nobody_wrote
            )
        self._busy = True
        if journal.heard:
            journal.publish(Kind.SENT, self.name, registration.behavior, command)
        call = (
            self._call(command, guard=self._guard(registration))
            if self._blocks
            else self._call(command)
        )
        try:
            waits_for = call.send(None)
        except StopIteration as stop:  # it is done: most drivers need not wait
            self._busy = False
            self.writes += 1
            self._told_error = ""
            applied = command if stop.value is None else stop.value
            if journal.heard:
                journal.publish(Kind.APPLIED, self.name, registration.behavior, applied)
            return Written(applied)
        except BaseException as error:
            self._busy = False
            if not is_drivers(error):
                raise
            raise self._interrupted(error, command, self._opening) from error
        self._told_error = "it has not answered yet"
        return self._finish(Suspended(call, waits_for), registration, command)

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
        self.refusals += 1
        refused = Refused(
            holder.behavior, holder.priority, _rule(holder), self.since, self.until
        )
        if self._journal.heard:
            self._journal.publish(
                Kind.REFUSED, self.name, registration.behavior, refused
            )
        return refused

    def _guard(self, registration: Registration) -> Guard:
        """Return the checks that a thread makes when the turn of a command comes."""
        opening, halts = self._opening, self._halts
        return lambda: (
            registration.usable
            and self._accepts
            and opening == self._opening
            and halts == self._halts
        )

    async def _finish(
        self, suspended: Suspended, registration: Registration, command: Any
    ) -> Written[Any] | Refused:
        actuator = self.actuator
        opening, halts = self._opening, self._halts
        try:
            applied = await finish(suspended, actuator.deadline)
        except CallRefused:
            return self._turned_away(registration, command, halts)
        except TimeoutError as error:
            if isinstance(error, DriverStuckError):
                stuck = error
            else:
                stuck = DriverStuckError(self.name, "write", actuator.deadline)
            raise self._failed(stuck, opening) from error
        except BaseException as error:
            if not is_drivers(error):
                raise
            raise self._interrupted(error, command, opening) from error
        finally:
            self._idle()
        self.writes += 1
        if self._writer is registration:
            self._last_write = self._time()
        if not self._told_safe:
            self._told_error = ""
        if applied is None:
            applied = command
        if self._journal.heard:
            self._journal.publish(
                Kind.APPLIED, self.name, registration.behavior, applied
            )
        return Written(applied)

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
        if len(self._waiters) >= WAITING_LIMIT:
            raise BusyError(self.name, "number of waiting writes", WAITING_LIMIT)
        halts = self._halts
        waiting = _Waiting(registration, self._loop.create_future())
        self._waiters.append(waiting)
        try:
            while (
                self._busy
                and self._accepts
                and halts == self._halts
                and registration.usable
                and not waiting.withdrawn
            ):
                if waiting.woken.done():
                    waiting.woken = self._loop.create_future()
                await waiting.woken
        finally:
            self._waiters.remove(waiting)
        if waiting.withdrawn and registration.usable:
            return _withdrawn(registration, self._time())
        if halts != self._halts:
            return self._turned_away(registration, command, halts)
        outcome = self.begin(registration, command, hold)
        return outcome if isinstance(outcome, Answer) else await outcome

    def _idle(self) -> None:
        turn = self._take_over_turn
        if turn is not None and not turn.done():
            turn.set_result(None)  # the safe command is next, before any waiter
            return
        if self._safe_again:
            # This command may have overtaken the safe command: repeat that one.
            self._safe_again = False
            self._busy = False
            self.make_safe()
            self._wake()
            return
        self._busy = False
        self._wake()

    def _wake(self) -> None:
        """Let those that wait look again whether they may go on."""
        for waiting in self._waiters:
            waiting.wake()

    def _withdraw(self, registration: Registration) -> None:
        """Have the waiting writes of a registration end without a command."""
        for waiting in self._waiters:
            if waiting.registration is registration:
                waiting.withdrawn = True
                waiting.wake()

    def _failed(self, error: BaseException, opening: int) -> Exception:
        translated = translate(self.name, error)
        if opening == self._opening:
            self._told_error = describe(translated)
            if self._journal.heard:
                self._journal.publish(
                    Kind.UNANSWERED, self.name, "", self._told, self._told_error
                )
            self._on_error(translated)
        return translated

    def _interrupted(
        self, error: BaseException, command: Any, opening: int
    ) -> Exception:
        """Make the error for a command whose driver call has ended in an error."""
        failed = self._failed(error, opening)
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

    def drop(self, registration: Registration) -> None:
        """Make the actuator safe if what it does now is this registration's will.

        Its writes that wait for their turn are withdrawn.
        """
        self._withdraw(registration)
        if self._writer is registration:
            self.make_safe()
        elif self.holder is registration:
            self.holder = None

    # The safe command.

    def make_safe(self) -> asyncio.Task[bool]:
        """Send the safe command, before anything else; nobody holds it afterwards.

        Returns:
            The sending; its result tells whether the device took it.
        """
        self._disarm()
        task = self._safe_task
        if task is None:
            if self._busy:
                # From this moment on the end of the write in flight is its turn.
                self._take_over_turn = self._loop.create_future()
            self._busy = True
            task = self._safe_task = spawn(
                self._loop,
                self._send_safe(self._take_over_turn),
                name=f"{self.name} safe",
            )
        return task

    async def safe_now(self) -> None:
        """Wait until a safe command on its way is the last thing sent; bounded."""
        give_up = min(self._time() + self._patience, self._last_moment)
        while (self._safe_task or self._safe_again) and self._time() < give_up:
            if self._safe_task is not None:
                seconds = max(0.0, give_up - self._time())
                await asyncio.wait({self._safe_task}, timeout=seconds)
            else:  # the safe command has overtaken a write, and is repeated after it
                await self._look_again(give_up)

    async def _send_safe(self, turn: asyncio.Future[None] | None) -> bool:
        mine = turn is None or await self._take_over(turn)
        try:
            for attempt in range(SAFE_TRIES):
                if self.state is not ResourceState.READY:
                    self._told_error = describe(
                        self.error or DeviceLostError(self.name)
                    )
                    return False
                if await self._try_safe():
                    return True
                await asyncio.sleep(0.01 * attempt)
            _log.critical(
                "%s: UNSAFE: it did not take %r", self.name, self.actuator.safe
            )
            if self.state is ResourceState.READY:
                # It comes back when it takes its safe command after an opening.
                self._on_error(
                    DeviceLostError(self.name, "it does not take its safe command")
                )
            return False
        finally:
            self._safe_task = None
            if mine:
                self._idle()
            elif self._busy:
                self._safe_again = True

    async def _take_over(self, turn: asyncio.Future[None]) -> bool:
        """Wait until the write in flight has ended, but not for ever."""
        try:
            await asyncio.wait({turn}, timeout=self._turn_within)
        finally:
            self._take_over_turn = None
        return turn.done()

    async def _try_safe(self) -> bool:
        opening = self._opening
        try:
            await self._tell_safe()
        except BaseException as error:
            if not is_drivers(error):
                raise
            self._failed(error, opening)
            return False
        return True

    async def _tell_safe(self) -> None:
        actuator = self.actuator
        self._told = actuator.safe
        self._told_safe = True
        self._told_error = "it has not answered yet"
        applied = first_step(self._call(actuator.safe))
        if type(applied) is Suspended:
            await finish(applied, actuator.deadline)
        self._told_error = ""
        if self._journal.heard:
            self._journal.publish(Kind.SAFE, self.name, "", actuator.safe)

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

    async def open_safe(self) -> None:
        """Send the safe command to a device that was just opened.

        Raises:
            DeviceLostError: The device is gone again.
            DeviceFaultError: It does not take its safe command.
        """
        try:
            await self._tell_safe()
        except BaseException as error:
            self._told_error = describe(error)
            raise

    async def quiet(self) -> None:
        """Wait until no call from before a loss is in flight any more; bounded.

        What such a call still sends would come after the safe command of the opening.
        """
        give_up = self._time() + self.actuator.deadline + 0.1
        while self._busy and self._time() < give_up:
            await self._look_again(give_up)

    async def _look_again(self, give_up: float) -> None:
        """Wait until something has ended, or until a moment."""
        waiting = _Waiting(None, self._loop.create_future())
        self._waiters.append(waiting)
        try:
            await asyncio.wait(
                {waiting.woken}, timeout=max(0.0, give_up - self._time())
            )
        finally:
            self._waiters.remove(waiting)

    # What people ask.

    @property
    def is_safe(self) -> bool:
        """Whether the device was told its safe command last, and took it."""
        return self._told_safe and not self._told_error

    def not_told(self, error: BaseException) -> None:
        """Take note that the device could not be told its safe command."""
        self._told_error = describe(error)

    def told(self) -> LastCommand:
        """Tell what the device was told last."""
        return LastCommand(
            self.name,
            self._told,
            self._told_safe,
            not self._told_error,
            self._told_error,
        )

    def why(self) -> Why:
        """Tell who holds the actuator, by which rule, and what would free it."""
        holder = self.holder
        halt = self.registrations.halt
        if halt is not None:
            return Why(
                self.name,
                self.state,
                HALT,
                HALT_PRIORITY,
                halt.reason,
                halt.since,
                math.inf,
                "robot.resume(), by the user",
                self._told,
            )
        if holder is None or self._time() >= self.until:
            rule = (
                "it was told its safe command"
                if self.is_safe
                else "no hold is in force"
            )
            return Why(self.name, self.state, rule=rule, last=self._told)
        return Why(
            self.name,
            self.state,
            holder.behavior,
            holder.priority,
            _rule(holder),
            self.since,
            self.until,
            f"a write with a priority above {holder.priority}, a release by "
            f"{holder.behavior}, or {self.until - self._time():.3g} s without its writes",
            self._told,
        )


def _rule(holder: Registration) -> str:
    return (
        f"priority {holder.priority} of {holder.behavior!r} holds until it has not "
        "written for its hold; only a higher priority gets through"
    )


def _withdrawn(registration: Registration, now: float) -> Refused:
    """Answer a write whose own sender gave the actuator back before its turn came."""
    return Refused(
        registration.behavior,
        registration.priority,
        f"{registration.behavior!r} gave it back before the turn of this command came",
        now,
        now,
    )
