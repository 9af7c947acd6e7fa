"""Who holds one actuator and until when, and what protects it from whoever writes it."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable
from typing import Any

from esair.connections._actuator_device import ActuatorDevice
from esair.connections._call import Call, End
from esair.connections._device import OfRobot, Operating
from esair.connections._driver import Guard
from esair.connections._halt import HALT, HALT_PRIORITY, Halt
from esair.connections._protection import Protection
from esair.connections._registrations import Registration
from esair.connections._weaker import is_same, weaker_of
from esair.exceptions import (
    AccessDeniedError,
    BadValueError,
    DeviceLostError,
    EsairError,
    HaltedError,
    StoppingError,
)
from esair.journal import Kind
from esair.loop import DeadMan, OneShot, Order, Scheduler
from esair.messages import Refused, ResourceState, Why
from esair.resources import HOLD, Actuator

_EARLY = 1e-6  # timers may fire a hair early
_GRACE = 1e-5  # more than that

USER = "user"  # who holds an actuator that is being replaced


class BeingReplacedError(DeviceLostError):
    """The user is about to put another device in its place; no device was lost."""


class HeldDevice(ActuatorDevice):
    """Knows whose will one actuator does, and makes it safe when nobody may move it.

    A write holds it for a time, if neither a guard nor a hold of who cannot see stops
    it; an operation holds it until it ends.
    """

    __slots__ = (
        "_asked",
        "_blind",
        "_blind_look",
        "_dead_man",
        "_guards",
        "_held_for",
        "_held_from",
        "_last_write",
        "_still",
        "_writer",
        "changes_hands",
        "fence",
        "halts",
        "holder",
        "refusals",
        "since",
        "timeouts",
    )

    # Of the channel, which checks what is written.
    _accepts: bool
    _blocks: bool
    checked: Callable[[Any], Any]
    _copied: Callable[[Any], Any]
    _ended: Callable[[Call, End], None]

    def __init__(self, actuator: Actuator[Any], robot: OfRobot) -> None:
        self.holder: Registration | None = None
        self.changes_hands = False  # who gives it back is not the last of the turn
        self.since = 0.0
        self._held_from = self._held_for = 0.0
        self.refusals = 0
        self.timeouts = 0  # how often the safe command was sent because nobody wrote
        self._writer: Registration | None = None
        self._last_write = 0.0
        self._dead_man = DeadMan(asyncio.get_running_loop(), self)
        self.halts = 0
        """Grows with each halt: a command from before is never sent after it."""
        self.fence = 0
        """Grows when it is made safe, or is gone: what was begun before leaves no more."""
        self._blind: Protection | None = None
        """The highest hold in force of those that cannot see: it refuses what any does."""
        self._guards: tuple[Protection, ...] = ()
        self._blind_look: OneShot | None = None
        super().__init__(actuator, robot)

    def attach(self, actuator: Actuator[Any]) -> None:
        self._asked: Any = None
        super().attach(actuator)

    def configured(self) -> None:
        """Take over what is safe, for protection: to stay where safe is a place to go."""
        super().configured()
        self._still = HOLD if self.actuator.safe_moves else self.actuator.safe

    @property
    def until(self) -> float:
        """When the hold is over, on the loop's clock."""
        return self._held_from + self._held_for

    @property
    def present_holder(self) -> Registration | None:
        """Who holds it now; None when the hold is over."""
        return self.holder if self.time() + _EARLY < self.until else None

    def down(self, state: ResourceState, error: EsairError) -> None:
        """The device is gone: forget who held it and what it was told."""
        self._disarm()
        super().down(state, error)
        self.operations.gone(error)

    def _disarm(self) -> None:
        self.holder = self._writer = None
        self.fence += 1
        self._dead_man.disarm()
        self._look_no_more()

    def release(self, registration: Registration) -> None:
        """Give the actuator back: lower priorities get through at once.

        What it was told stays until somebody writes or the command times out.
        """
        if self.holder is registration:
            self.holder = None
            if not self.changes_hands:
                self.keep_still()

    def drop(self, registration: Registration) -> None:
        """Make the actuator safe if what it does now is this registration's will."""
        self.operations.drop(registration)
        if self._writer is registration:
            self.make_safe()
        elif self.holder is registration:
            self.holder = None

    # Refusals.

    def lost(
        self, registration: Registration, command: Any, winner: Registration
    ) -> Refused:
        """Refuse a command that another one of the same turn has beaten."""
        self.wanted(registration, command)
        return self._refused(registration, self.holder or winner)

    def wanted(self, registration: Registration, command: Any) -> None:
        """Take note of what somebody wants sent, whatever becomes of it."""
        if self._journal.heard:
            # It is read when it may have changed; it may be an object of any class.
            with contextlib.suppress(Exception):
                command = self._copied(command)
            self._journal.publish(
                Kind.COMMAND, self.name, registration.behavior, command
            )

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

    def _turned_away(
        self, registration: Registration, command: Any, halts: int | None = None
    ) -> Refused:
        """Answer a write that may not even be looked at."""
        halt = self.registrations.halt
        if halt is None and halts is not None and halts != self.halts:
            told = "it was asked for before the robot was halted, or its computer slept"
            halt = Halt(told, self.time())
        error = self.error
        if self.latched or not registration.usable:
            raise self._refusal(registration) from None
        if halt is not None:
            refused = Refused(HALT, HALT_PRIORITY, halt.reason, halt.since, None)
        elif isinstance(error, BeingReplacedError):
            refused = Refused(USER, HALT_PRIORITY, error.detail, self.since, None)
        else:
            raise self._refusal(registration) from None
        self.wanted(registration, command)
        return self._refuse(registration, refused)

    def _refusal(self, registration: Registration) -> EsairError:
        """Make the error for a write that may not even be looked at."""
        if not registration.usable:
            return self.registrations.refusal(registration)
        if self.latched:
            return StoppingError(self.name, "stopping")
        return self.absence()

    # The safe command.

    def make_safe(self, *, stay: bool = False) -> asyncio.Task[bool]:
        """Send the safe command, before anything else; nobody holds it afterwards."""
        self._disarm()
        if self.operations.running:
            self.operations.end(self._safe_instead())
        return super().make_safe(stay=stay)

    @property
    def dies(self) -> float:
        """When it gets its safe command unless somebody writes, on the loop's clock."""
        return self._last_write + self.command_timeout

    def dead(self) -> None:
        """Make it safe, because nobody has written."""
        holder = self.holder
        self.timeouts += 1
        self.make_safe()
        self.holder = holder  # a longer hold keeps lower priorities away

    # Those that protect it.

    def protect(
        self, holds: tuple[Protection, ...], guards: tuple[Protection, ...]
    ) -> None:
        """Obey these from this moment on; the table calls it at each change."""
        self._blind = holds[0] if holds else None
        self._guards = guards
        if holds:
            self.keep_still()

    @property
    def moves(self) -> bool:
        """Whether the device was told something else than to be safe, or to stay."""
        return (
            self.state is ResourceState.READY
            and not self._told_safe
            and self._told is not HOLD
            and self._safe_task is None
            and not self.is_still(self._told)
        )

    def is_still(self, command: Any) -> bool:
        """Tell whether a command asks for what protection would send: it moves nothing."""
        return is_same(command, self._still)

    def keep_still(self) -> None:
        """Make it safe because somebody is blind, unless a higher priority moves it."""
        blind = self._blind
        if blind is None or not self.moves:
            return
        mover = self.holder
        if (
            mover is not None
            and mover is self._writer
            and self.time() - _EARLY < self.until
            and mover.priority > blind.priority
        ):
            self._look_no_more()  # that was when another one's hold ends
            # A hair later: who sees again at that very moment, sees.
            self._blind_look = Scheduler.of(self.loop).at(
                self.until + _GRACE, self._look_at_blind, order=Order.STALE
            )
            return
        self.make_safe(stay=True)

    def _look_at_blind(self, _now: float) -> None:
        self._blind_look = None
        self.keep_still()

    def _look_no_more(self) -> None:
        if self._blind_look is not None:
            Scheduler.of(self.loop).cancel(self._blind_look)
            self._blind_look = None

    def _pass_guards(
        self, command: Any, now: float
    ) -> tuple[Protection | None, str | None, Any]:
        self._asked = command
        moving, still = self.moves, self._still
        by: str | None = None
        passed = command
        for guard in self._guards:
            weighed = guard.weigh(passed, still, now, moving=moving, hand=self._copied)
            if weighed is not passed and weighed is not None:
                try:
                    weighed = self.checked(weighed)
                except BadValueError as error:  # the guard's own: it is asked no more
                    guard.crash(error)
                    weighed = None
                by = guard.component
            guard.note(weighed is None)
            if weighed is None:
                return guard, by, None
            passed = weighed
        return None, by, passed

    def _stay(self) -> None:
        """Make it safe at once because of a guard; who writes keeps the hold."""
        if self.moves:
            holder, writer = self.holder, self._writer
            self.make_safe(stay=True)
            self.holder, self._writer = holder, writer

    def review(self) -> None:
        """Put what stands to the guards again; only less than that may leave now.

        An operation is ended by one that lets nothing pass.
        """
        if self.operations.running:
            if any(guard.stops for guard in self._guards):
                self.make_safe(stay=True)
            return
        if not (self._guards and self._accepts and self.moves):
            return
        stop, _by, passed = self._pass_guards(self._asked, self.time())
        if stop is not None:
            self._stay()
            return
        if passed is self._told or self._busy:
            return  # a call in flight: it is looked at again when that ends
        less = weaker_of(self._told, passed, self._still)
        if is_same(less, self._told):
            return
        if self._journal.heard:
            self._journal.publish(Kind.SENT, self.name, "", less)
        self._told = less
        self._told_at = self.time()
        try:
            sent = self.calls.begin(
                "write",
                self._write,
                (less,),
                self.actuator.deadline,
                self._may_leave() if self._blocks else None,
            )
        except Exception as error:
            self._failed(error, "write")
            return
        if type(sent) is Call:
            sent.apply = self._ended
            self._busy = True
            self._lane = sent
            self._told_error = "it has not answered yet"
        else:
            self._took(less, sent)

    def _may_leave(self) -> Guard:
        calls, opening, fence = self.calls, self.calls.opening, self.fence
        return lambda: (
            self._accepts and opening == calls.opening and fence == self.fence
        )

    # Operations.

    def ready_for(self, operation: Operating) -> bool:
        """Tell whether an operation may begin now: what moves is made safe first."""
        right, now = operation.registration, self.time()
        if self.latched:
            raise StoppingError(self.name, "stopping")
        rule = ""
        holder, blind = self.holder, self._blind
        if blind is not None and right.priority <= blind.priority:
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
        self.since = self.time()
        self._held_from, self._held_for = operation.until, 0.0

    def operated(self, call: Call | None) -> None:
        """An operation has its outcome: nobody knows what moves, so it is made safe."""
        if call is not None and call is self._lane and call.ended is not None:
            self._lane = None
        if self._safe_task is not None:
            self._again = True
        else:
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
        holder, blind, now = self.holder, self._blind, self.time()
        halt, error = self.registrations.halt, self.error
        if holder is not None and now >= self.until:
            holder = None
        by: tuple[str, int, str, float, float | None]
        if halt is not None:
            by = HALT, HALT_PRIORITY, halt.reason, halt.since, None
            frees = "robot.resume(), by the user"
        elif isinstance(error, BeingReplacedError):
            by = USER, HALT_PRIORITY, error.detail, self.since, None
            frees = "the device that takes its place, when it is open"
        elif blind is not None and (
            holder is None or holder.priority <= blind.priority
        ):
            by = blind.component, blind.priority, blind.rule, blind.since, None
            frees = (
                f"its next decision, or a write with a priority above {blind.priority}"
            )
        elif holder is not None:
            rule = rule_of(holder)
            by = holder.behavior, holder.priority, rule, self.since, self.until
            frees = (
                f"a write with a priority above {holder.priority}, a release by "
                f"{holder.behavior}, or {self.until - now:.3g} s without its writes"
            )
        else:
            safe = "it was told its safe command"
            rule = safe if self.is_safe else "no hold is in force"
            return Why(self.name, self.state, rule=rule, last=self._told)
        return Why(self.name, self.state, *by)._replace(frees=frees, last=self._told)


def rule_of(holder: Registration) -> str:
    """Say by which rule somebody holds an actuator."""
    return (
        f"priority {holder.priority} of {holder.behavior!r} holds until it has not "
        "written for its hold; only a higher priority gets through"
    )
