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
from typing import Any, Protocol

from esair.connections._values import is_opaque, is_same, is_weaker
from esair.exceptions import BadValueError, describe
from esair.loop import OneShot, Order, Scheduler, clock_of, ignore
from esair.messages import Refused
from esair.resources import HOLD

HOLD_LIMIT = 999
"""The highest priority of a blind hold: an operator's own (1000) is above it."""

UNDECIDED = "it has not decided yet"  # why a component is blind that was just accepted

BLIND: Any = object()
"""What a guard's judge answers that finds, asked about a command, that it cannot see."""

Judge = Callable[[Any], Any]
"""Gets a command; returns what of it may pass, None for nothing, or `BLIND`."""

_EARLY = 1e-6  # timers may fire a hair early

_log = logging.getLogger("esair")


class Protected(Protocol):
    """An actuator's channel, as the table knows it."""

    def protect(
        self, holds: tuple[Protection, ...], guards: tuple[Protection, ...]
    ) -> None:
        """Obey these from this moment on: holds in force, and all guards."""

    def review(self) -> None:
        """Put what stands to the guards again."""


class Protection:
    """What one component has over one actuator.

    Attributes:
        component: Whose it is.
        actuator: The name of the actuator.
        priority: Of a hold: writes with it or less are refused. Of a guard: higher is
            asked earlier.
        guards: Whether it is a guard; else it is a hold, in force while blind.
        reason: Why the component cannot decide, in words; empty if it can.
        since: Since when, on the event loop's clock (seconds).
        latched: Why nothing passes until the user resets it; empty if it is not.
        muted_until: Until when it lets everything pass, by the user's will.
    """

    def __init__(
        self,
        component: str,
        actuator: str,
        priority: int,
        *,
        label: str | None = None,
        guards: bool = False,
        latch: bool = False,
        fallback: Judge | None = None,
    ) -> None:
        self.component = component
        self.actuator = actuator
        self.priority = priority if guards else min(priority, HOLD_LIMIT)
        self.label = label or component
        self.guards = guards
        self.latch = latch
        self.reason = UNDECIDED
        self.since = 0.0
        self.latched = ""
        self.muted_until = 0.0
        self.muted_for = ""  # the user's reason, while it is muted
        self.judge: Judge | None = None
        """Of a guard: what decides; None while the guard does not run."""
        self.fallback = fallback  # of a guard: what decides while it is blind
        self.on_crash: Callable[[BaseException], None] = ignore
        """Told, outside of the commit point, what the guard has raised."""
        self.stopping = ""
        """Why the guard has refused the last command; empty if that has passed."""
        self.refused: Any = None  # the command that has latched the guard

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
        now = _now()
        if self.guards:
            told = f"{self.label} guards it with priority {self.priority}"
            told += ", latches" if self.latch else ""
        else:
            told = f"{self.label} keeps it safe while blind, up to priority {self.priority}"
        if self.latched or self.reason:
            told += f"; now: {self.rule}"
        elif self.stopping:
            told += "; now: it lets nothing pass"
        if now < self.muted_until:
            left = self.muted_until - now
            told += f"; MUTED by the user for {left:.3g} s more: {self.muted_for}"
        return told

    @property
    def stops(self) -> bool:
        """Whether nothing passes now: it is blind, latched, or has refused last."""
        if asyncio.get_running_loop().time() < self.muted_until:
            return False
        return bool(self.latched or self.reason or self.stopping)

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
        now: float,
        *,
        moving: bool,
        hand: Callable[[Any], Any],
    ) -> Any:
        """Decide, at the commit point, what of a command a guard lets pass.

        The guard is another component's code: whatever it does ends here.
        """
        if now + _EARLY < self.muted_until:
            return command
        if self.latched:
            return None
        try:
            passed: Any = BLIND
            handed: Any = None
            if self.judge is not None and not self.reason:
                handed = hand(command)
                passed = self.judge(handed)
            if passed is BLIND:
                if moving:
                    self._latch(self.reason or "it was blind", command)
                passed = None
                if self.fallback is not None and not self.latch:
                    handed = hand(command)
                    passed = self.fallback(handed)
            elif passed is None:
                self._latch("it has refused a command", command)
            if passed is None or passed is command:
                return passed
            if passed is HOLD:
                return None
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
            self.crash(error)
            return None
        return command if is_same(passed, command) else passed

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

    def crash(self, error: BaseException) -> None:
        """Let nothing pass from now on; its owner hears of it outside of this step."""
        self.judge = None
        self.fallback = None
        self.reason = self.reason or f"it crashed: {describe(error)}"
        asyncio.get_running_loop().call_soon(self.on_crash, error)

    def why_latched_still(self) -> str:
        """Return why it cannot be reset, in words; empty if it can."""
        if not self.latched:
            return ""
        if self.reason or self.judge is None:
            return f"it is blind: {self.reason}"
        try:
            passed = self.judge(copy.deepcopy(self.refused))
            if passed is None or passed is BLIND:
                return f"it still refuses {self.refused!r:.80}"
        except Exception as error:  # contained: one component's failure
            return f"it fails: {describe(error)}"
        return ""

    def _latch(self, why: str, command: Any) -> None:
        if self.latch:
            self.latched = why
            self.refused = command
            _log.warning("%s: latched: %s", self.label, why)


class Protections:
    """The one table of a robot."""

    def __init__(self, channels: Mapping[str, Protected]) -> None:
        self._channels = channels
        self._entries: dict[str, list[Protection]] = {}
        self._ends: list[OneShot] = []  # when what is muted now is in force again

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
            end = Scheduler.of(loop).at(until, self._tell_all, order=Order.EXPIRY)
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
        scheduler = Scheduler.of(asyncio.get_running_loop())
        for end in self._ends:
            scheduler.cancel(end)

    def _tell_all(self, _moment: float) -> None:
        for actuator in self._entries:
            self._tell(actuator)

    def _tell(self, actuator: str, *, guards: bool = True) -> None:
        """Have a channel obey; guards that have changed look at what stands."""
        channel = self._channels.get(actuator)
        if channel is None:
            return
        now = _now()
        entries = self.of(actuator)
        channel.protect(
            tuple(
                each
                for each in entries
                if not each.guards and each.reason and now + _EARLY >= each.muted_until
            ),
            tuple(each for each in entries if each.guards),
        )
        if guards:
            channel.review()


def _now() -> float:
    return clock_of(asyncio.get_running_loop())()
