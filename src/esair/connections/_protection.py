"""Who keeps an actuator still: those that cannot see, and the guards.

There is one table for a robot, by component and *name* of an actuator. An entry is
older than the device, its opening, the right to use it and the run of the component,
and outlives them all: only the user ends it, by taking the component away.
"""

from __future__ import annotations

import asyncio
import copy
import logging
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

import attrs

from esair.connections._calls import Apply, Call
from esair.connections._gate import Gate, Hold, Registration, verdict
from esair.connections._values import is_opaque, is_same, is_weaker, weaker_of
from esair.connections._wire import NOT_YET, SafeCommand, Wire
from esair.exceptions import BadValueError, EsairError, NoTurnError, describe
from esair.loop import (
    NEVER,
    REACHED,
    Deadline,
    Deadlines,
    DeadMan,
    Order,
    clock_of,
    ignore,
    turn_of,
)
from esair.messages import Refused, ResourceState
from esair.resources import HOLD, REFUSE

if TYPE_CHECKING:
    from esair.connections._actuator_channel import ActuatorChannel
    from esair.connections._device import Device

HOLD_LIMIT = 999
"""The highest priority of a blind hold: an operator's own (1000) is above it."""

UNDECIDED = "it has not decided yet"  # why a component is blind that was just accepted

BLIND: Any = object()
"""What a guard's judge answers that finds, asked about a command, that it cannot see."""

Judge = Callable[[Any], Any]
"""Gets a command; returns what of it may pass, None for nothing, or `BLIND`."""

_GRACE = 1e-5  # more than `REACHED`

_log = logging.getLogger("esair")


@attrs.define(eq=False)
class Protection:
    """What one component has over one actuator."""

    component: str  # whose it is
    actuator: str  # its name
    priority: int
    """Of a hold: writes with it or less are refused. Of a guard: higher is asked earlier."""
    label: str = attrs.field(default="", kw_only=True)  # how it is called in words
    guards: bool = attrs.field(default=False, kw_only=True)
    """Whether it is a guard; else it is a hold, in force while blind."""
    latch: bool = attrs.field(default=False, kw_only=True)
    fallback: Judge | None = attrs.field(default=None, kw_only=True)
    """Of a guard: what decides while it is blind."""
    reason: str = UNDECIDED  # why it cannot decide, in words; empty if it can
    since: float = 0.0  # since when, on the event loop's clock (seconds)
    latched: str = ""  # why nothing passes until the user resets it; empty if it does
    muted_until: float = 0.0  # until when all passes, by the user's will
    muted_for: str = ""  # the user's reason, while it is muted
    judge: Judge | None = None  # of a guard that runs: what decides
    on_crash: Callable[[BaseException], None] = ignore
    """Told, outside of the commit point, what the guard has raised."""
    stopping: str = ""
    """Why the guard has refused the last command; empty if that has passed."""
    refused: Any = None  # the command that has latched the guard

    def __attrs_post_init__(self) -> None:
        self.label = self.label or self.component
        if not self.guards:
            self.priority = min(self.priority, HOLD_LIMIT)

    @property
    def rule(self) -> str:
        """Why a command does not pass, in words."""
        if self.latched:
            return f"{self.label} is latched: {self.latched}"
        if self.reason:
            return f"{self.label} is blind: {self.reason}"
        return f"{self.label} guards {self.actuator}"

    def describe(self) -> str:
        """Say what it does and how it stands, in one line."""
        if self.guards:
            told = f"{self.label} guards it with priority {self.priority}"
            told += ", latches" if self.latch else ""
        else:
            told = f"{self.label} keeps it safe while blind, up to priority {self.priority}"
        if self.latched or self.reason:
            told += f"; now: {self.rule}"
        elif self.stopping:
            told += "; now: it lets nothing pass"
        if self.is_muted:
            left = self.muted_until - _now()
            told += f"; MUTED by the user for {left:.3g} s more: {self.muted_for}"
        return told

    @property
    def stops(self) -> bool:
        """Whether nothing passes now: it is blind, latched, or has refused last."""
        return bool(
            not self.is_muted and (self.latched or self.reason or self.stopping)
        )

    @property
    def is_muted(self) -> bool:
        """Whether it lets everything pass now, by the user's will."""
        return bool(self.muted_until) and _now() + REACHED < self.muted_until

    def inherit(self, before: Protection) -> None:
        """Keep what only the user may end: the latch of what it takes the place of."""
        if self.latch and before.latched and self.actuator == before.actuator:
            self.latched, self.refused = before.latched, before.refused

    def refusal(self) -> Refused:
        """Make the answer for a command that does not pass."""
        return Refused(self.component, self.priority, self.rule, self.since, None)

    def weigh(
        self,
        command: Any,
        safe: Any,
        *,
        moving: bool,
        hand: Callable[[Any], Any],
    ) -> Any:
        """Decide, at the commit point, what of a command a guard lets pass.

        The guard is another component's code: whatever it does ends here.
        """
        if self.is_muted:
            return command
        if self.latched:
            return None
        try:
            passed: Any = BLIND
            handed: Any = None
            if self.judge is not None and not self.reason:
                handed = hand(command)
                passed = self._answer(self.judge, handed)
            if passed is BLIND:
                if moving:
                    self._latch(self.reason or "it was blind", command)
                passed = None
                if self.fallback is not None and not self.latch:
                    handed = hand(command)
                    passed = self._answer(self.fallback, handed)
            elif passed is None:
                self._latch("it has refused a command", command)
            if passed is None or passed is command:
                return passed
            if passed is handed and is_opaque(passed):
                return command
            if not is_weaker(passed, command, safe):
                raise BadValueError(
                    self.component,
                    "react",
                    f"expected {command!r:.80}, something between it and {safe!r:.80}, "
                    f"or None, not {passed!r:.80}",
                )
        except BaseException as error:  # contained: one component's failure
            if (
                command is not HOLD
            ):  # where nobody knows that, it cannot be computed with
                self.crash(error, command)
            return None
        return command if is_same(passed, command) else passed

    @staticmethod
    def _answer(judge: Judge, command: Any) -> Any:
        passed = judge(command)
        if passed is REFUSE or (passed is HOLD and command is not HOLD):
            return None
        return passed

    def note(self, stops: bool) -> None:
        """Say in the log when a guard begins and ceases to stop commands."""
        rule = self.rule if stops else ""
        if rule == self.stopping:
            return
        if stops:
            _log.warning("%s: %s lets nothing pass", self.actuator, rule)
        elif self.stopping:
            _log.info("%s: %s lets commands pass again", self.actuator, self.label)
        self.stopping = rule

    def crash(self, error: BaseException, command: Any) -> None:
        """Let nothing pass from now on; its owner hears of it outside of this step."""
        self.judge = None
        self.fallback = None
        self.reason = self.reason or f"it crashed: {describe(error)}"
        self._latch(self.reason, command)  # it has not let this pass
        asyncio.get_running_loop().call_soon(self.on_crash, error)

    def why_latched_still(self) -> str:
        """Return why it cannot be reset, in words; empty if it can."""
        if not self.latched:
            return ""
        if self.reason or self.judge is None:
            return f"it is blind: {self.reason}"
        try:
            passed = self._answer(self.judge, copy.deepcopy(self.refused))
            if passed is None or passed is BLIND:
                return f"it still refuses {self.refused!r:.80}"
        except BaseException as error:  # contained: one component's failure
            return f"it fails: {describe(error)}"
        return ""

    def _latch(self, why: str, command: Any) -> None:
        if self.latch:
            self.latched, self.since = why, _now()
            self.refused = command
            _log.warning("%s: latched: %s", self.label, why)


class Protections:
    """The one table of a robot."""

    def __init__(self, channels: Mapping[str, ActuatorChannel]) -> None:
        self._channels = channels
        self._entries: dict[str, list[Protection]] = {}
        self._ends: list[Deadline] = []  # when what is muted now is in force again

    def __iter__(self) -> Iterator[Protection]:
        return iter([each for entries in self._entries.values() for each in entries])

    def of(self, actuator: str) -> list[Protection]:
        """Return who holds or guards an actuator, by priority and name."""
        entries = self._entries.get(actuator, [])
        return sorted(entries, key=lambda each: (-each.priority, each.component))

    def enter(self, entries: Iterable[Protection]) -> None:
        """Put entries in force, all in one step."""
        now = _now()
        for entry in entries:
            entry.since = entry.since or now
            self._entries.setdefault(entry.actuator, []).append(entry)
            self._tell(entry.actuator, guards=entry.guards)

    def leave(self, entries: Iterable[Protection]) -> None:
        """End entries: by the user's will, or with the step of a behavior."""
        for entry in entries:
            there = self._entries.get(entry.actuator, [])
            if entry in there:
                there.remove(entry)
                if not there:
                    del self._entries[entry.actuator]
                self._tell(entry.actuator, guards=entry.guards)

    def blind(self, entries: Iterable[Protection], reason: str) -> None:
        """Take note why a component cannot decide; empty if it can."""
        for entry in entries:
            if entry.reason != reason:
                still = entry.reason and reason
                entry.since = entry.since if still else _now()
                entry.reason = reason
                self._tell(entry.actuator, guards=entry.guards)

    def mute(self, entries: Iterable[Protection], seconds: float, reason: str) -> None:
        """Let everything pass for a while; 0 ends that."""
        until = _now() + seconds
        for entry in entries:
            entry.muted_until = until
            entry.muted_for = reason
            self._tell(entry.actuator, guards=entry.guards)
        if seconds > 0:
            loop = asyncio.get_running_loop()
            end = Deadlines.of(loop).at(until, self._mute_is_over, order=Order.EXPIRY)
            self._ends.append(end)

    def reset(self, entries: Iterable[Protection]) -> None:
        """Take the latches of guards back."""
        for entry in entries:
            entry.latched = ""
            entry.refused = None
            self._tell(entry.actuator, guards=entry.guards)

    def appear(self, actuator: str) -> None:
        """An actuator has come: nobody has decided on it yet.

        Its channel obeys the table before anybody can write there.
        """
        for entry in self._entries.get(actuator, []):
            if not entry.reason and not entry.guards:
                entry.reason = UNDECIDED
                entry.since = _now()
        self._tell(actuator)

    def close(self) -> None:
        """Wait for no end of a mute any more: the robot has stopped."""
        for end in self._ends:
            end.cancel()

    def _mute_is_over(self) -> None:
        self._ends = [each for each in self._ends if each.when < NEVER]
        for actuator in self._entries:
            self._tell(actuator)

    def _tell(self, actuator: str, *, guards: bool = True) -> None:
        """Have a channel obey; guards that have changed look at what stands."""
        channel = self._channels.get(actuator)
        if channel is None:
            return
        entries = self.of(actuator)
        holds = (each for each in entries if not each.guards and each.reason)
        channel.protect(
            tuple(each for each in holds if not each.is_muted),
            tuple(each for each in entries if each.guards),
        )
        if guards:
            channel.review()


def _now() -> float:
    return clock_of(asyncio.get_running_loop())()


@attrs.define(eq=False)
class Guards:
    """The guards of one actuator, and what was asked of it last."""

    _wire: Wire
    all: tuple[Protection, ...] = ()  # by priority
    asked: Any = None  # what was asked for last, before a guard has weighed it

    def obey(self, guards: tuple[Protection, ...]) -> None:
        """Have these from now on; while there are none, nobody hears what is asked for."""
        self.all = guards
        if not guards:
            self.asked = None

    @property
    def standing(self) -> Any:
        """What was asked for last; what was told, if there was no guard to hear it."""
        return self._wire.told.command if self.asked is None else self.asked

    def weigh(
        self, command: Any, *, moving: bool
    ) -> tuple[Protection | None, str | None, Any]:
        """Put a command to all guards, each gets what the one before lets pass.

        Where one lets nothing pass, those after it that latch are asked all the same: one
        guard more must not keep the latch of another open.

        Returns:
            The guard that refuses it, if one does; the one that has weakened it, if one
            has; and what passes.
        """
        wire, still = self._wire, self._wire.still
        self.asked = None if command is HOLD else command
        by: str | None = None
        for number, guard in enumerate(self.all, 1):
            weighed = guard.weigh(command, still, moving=moving, hand=wire.copied)
            if weighed is not command and weighed is not None:
                try:
                    weighed = wire.check.checked(weighed)
                except BadValueError as error:  # the guard's own: it is asked no more
                    guard.crash(error, command)
                    weighed = None
                by = guard.component
            guard.note(weighed is None)
            if weighed is None:
                for later in self.all[number:]:
                    if later.latch:
                        later.weigh(command, still, moving=moving, hand=wire.copied)
                return guard, by, None
            command = weighed
        return None, by, command

    def asked_anew(self, *, moving: bool) -> Protection | None:
        """Return the first that lets nothing pass now, for the sake of an operation.

        They are asked with what was asked for last: else with what is safe, or with where
        the device stays; with `HOLD` if its driver does not say where that is.
        """
        if self.all:
            asked, told = self.asked, self._wire.told
            if asked is None:
                still = self._wire.still
                asked = still if still is not HOLD or told.place is None else told.place
            self.weigh(asked, moving=moving)
        return self.shut

    def latch_blind(self) -> None:
        """Latch those that are blind now: what was asked last has moved something."""
        for each in self.all:
            if each.latch and each.reason:
                still, hand = self._wire.still, self._wire.copied
                each.weigh(self.standing, still, moving=True, hand=hand)

    @property
    def stopping(self) -> Protection | None:
        """The first guard that has refused what it was asked last."""
        return next((guard for guard in self.all if guard.stopping), None)

    @property
    def shut(self) -> Protection | None:
        """The first guard that lets nothing pass now."""
        return next((guard for guard in self.all if guard.stops), None)


@attrs.define(eq=False)
class Stillness:
    """Makes one actuator safe when nobody may move it, or nobody has for a time."""

    _device: Device
    _gate: Gate
    _hold: Hold
    _guards: Guards
    _wire: Wire
    _safe: SafeCommand
    _turn: Any = attrs.field(init=False)
    _look: Deadline = attrs.field(init=False)
    dead_man: DeadMan = attrs.field(init=False)
    _stilled_in: int = -1  # the turn in which protection has made it safe
    timeouts: int = 0  # how often it was made safe because nobody wrote

    def __attrs_post_init__(self) -> None:
        loop = self._device.loop
        self._turn = turn_of(loop)
        self.dead_man = DeadMan(loop, self.dies, self.dead)
        # A hold is over, like a reading that is too old: that is not put off.
        self._look = Deadline(
            Deadlines.of(loop), self.keep_still, order=Order.STALE, is_patient=False
        )

    def disarm(self) -> None:
        """It is safe, or gone: nobody holds it, and what was begun before is fenced."""
        self._hold.holder = self._hold.writer = None
        self._gate.fence += 1
        self.dead_man.disarm()
        self._look.cancel()

    # The dead man.

    def dies(self) -> float:
        """Return when it gets its safe command unless somebody writes."""
        return self._hold.written + self._wire.command_timeout

    def dead(self) -> None:
        """Make it safe, because nobody has written."""
        holder = self._hold.holder
        self.timeouts += 1
        self._safe.make()
        self._hold.holder = holder  # a longer hold keeps lower priorities away

    # Those that protect it.

    def is_still(self, command: Any) -> bool:
        """Tell whether a command asks for what protection would send: it moves nothing."""
        return is_same(command, self._wire.still)

    @property
    def moves(self) -> bool:
        """Whether the device was told something else than to be safe, or to stay."""
        told = self._wire.told
        return (
            self._device.state is ResourceState.READY
            and not told.is_safe
            and told.command is not HOLD
            and self._safe.state is None
            # Also where a command that is still was not taken.
            and (not self.is_still(told.command) or told.error not in ("", NOT_YET))
        )

    def keep_still(self) -> None:
        """Make it safe because somebody is blind, unless a higher priority moves it."""
        holds, hold = self._gate.holds, self._hold
        if not (holds and self.moves):
            return
        mover = hold.holder
        if (
            mover is not None
            and mover is hold.writer
            and mover.priority > holds[0].priority
            and self._device.time() - REACHED < hold.until
        ):
            self.look_when_over()
        else:
            self._stilled_in = self._turn.number
            self._safe.make(stay=True)

    def look_when_over(self) -> None:
        """Look again when the hold is over: who is blind may keep it still then."""
        # A hair later: who sees again at that very moment, sees.
        self._look.start(self._hold.until + _GRACE)

    def stay(self) -> None:
        """Make it safe at once because of a guard; who writes keeps the hold."""
        if self.moves:
            hold = self._hold
            holder, writer = hold.holder, hold.writer
            self._stilled_in = self._turn.number
            self._safe.make(stay=True)
            hold.holder, hold.writer = holder, writer

    def not_taken(self, error: EsairError, right: Registration, now: float) -> None:
        """Make it safe if a command has failed that took over what stands.

        Nobody else feeds that any more. What has not left counts as one, whoever wrote.
        """
        if type(error) is NoTurnError or self._hold.takes_over(right, now):
            self._safe.make()

    def review(self, apply: Apply) -> None:
        """Put what stands to the guards again; only less than that may leave now."""
        guards, wire, now = self._guards, self._wire, self._device.time()
        if not (guards.all and self.moves):
            if self._stilled_in == self._turn.number:  # it has moved until this turn
                guards.latch_blind()
            return
        gate, numbers = self._gate, self._gate.numbers
        if verdict(gate, self._hold, None, now) is not None:
            return
        stop, _by, passed = guards.weigh(guards.standing, moving=True)
        if stop is not None:
            self.stay()
            return
        told = wire.told
        if passed is told.command or wire.lane is not None:
            return  # a call in flight: it is looked at again when that ends
        if self._safe.state is not None or numbers != gate.numbers:
            return  # a guard took its time, or has halted
        try:
            less = weaker_of(told.command, passed, wire.still)
            if is_same(less, told.command):
                return
            told.at = now
            guard = gate.ticket(None, None, numbers) if wire.blocks else None
            sent = wire.send(less, "", guard)
        except Exception:  # it is told to those who look after the device
            self._safe.make(stay=True)  # what stands is more than they let pass
            return
        if type(sent) is Call:
            sent.apply = apply
        else:
            wire.took(less, sent)
