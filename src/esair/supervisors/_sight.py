"""Whether one component sees, as the robot's table of protection is told."""

from __future__ import annotations

import asyncio
import logging

from esair.actions import Guards, Need
from esair.actions import ProfiledAction as Action
from esair.connections import UNDECIDED, Protection, Protections
from esair.exceptions import AccessDeniedError, BadValueError
from esair.loop import wake
from esair.supervisors._rules import only_the_user
from esair.values import check_duration, printable

_log = logging.getLogger("esair")


class Sight:
    """Keeps the entries of one component in the table, from its acceptance on."""

    def __init__(
        self, table: Protections, action: Action, name: str, *, step_of: str = ""
    ) -> None:
        self._table = table
        self._action = action
        label = f"step {name} of {step_of}" if step_of else name
        self.name = name
        self.entries: tuple[Protection, ...] = tuple(
            _entry(action, need, step_of or name, label)
            for need in action.needs.values()
            if action.holds_when_blind(need)
        )
        self.reason: str = UNDECIDED  # why it cannot decide; empty if it can
        self._decided: asyncio.Future[None] | None = None

    @property
    def guard(self) -> Protection:
        return self.entries[0]

    def accept(self) -> None:
        """Enter the table: it is blind until its first decision."""
        self.blind(UNDECIDED)
        self._decided = None
        # A latch has stayed while its guard rested.
        self._table.enter(each for each in self.entries if not each.latched)

    def rest(self) -> None:
        """Leave the table for a while; a latch stays, which only the user ends."""
        self._table.leave(each for each in self.entries if not each.latched)

    def stand_by(self) -> None:
        """Enter the table where the one whose place it will take has no entry."""
        there = {
            entry.actuator for entry in self._table if entry.component == self.name
        }
        self._table.enter(each for each in self.entries if each.actuator not in there)

    def take_over(self, old: Sight) -> None:
        there = set(self._table)
        self._table.enter(each for each in self.entries if each not in there)
        for each in self.entries:
            for before in old.entries:
                each.inherit(before)
        self._table.leave(old.entries)

    def blind(self, reason: str) -> None:
        """Take note why it cannot decide; empty if it can."""
        self.reason = reason
        self._table.blind(self.entries, reason)

    def sees(self) -> None:
        self.blind("")
        wake(self._decided)

    def leave(self) -> None:
        self._table.leave(self.entries)

    def removed(self) -> None:
        """Leave the table because the user took the component away."""
        self.leave()
        for entry in self.entries:
            doing = "guards" if entry.guards else "keeps safe, when blind,"
            _log.info(
                "%s: removed; it no longer %s %s", self.name, doing, entry.actuator
            )

    def decided(self) -> asyncio.Future[None]:
        """Return a future that is done when it has decided for the first time."""
        if self._decided is None:
            self._decided = asyncio.get_running_loop().create_future()
            if not self.reason:
                self._decided.set_result(None)
        return self._decided

    # What the user may do.

    def mute(self, seconds: float, reason: str) -> None:
        """Let everything pass for a while."""
        only_the_user(self.name, "mute", "lets pass what is protected")
        self._check_protects("mute")
        check_duration(self.name, "seconds", seconds)
        limit = getattr(self._action, "mute_limit", 0.0)
        if seconds > limit:
            told = f"expected {limit:g} s at most (its mute_limit), not {seconds:g}"
            raise BadValueError(self.name, "seconds", told)
        if not isinstance(reason, str) or not reason.strip():
            raise BadValueError(self.name, "reason", "say why in a few words")
        self._table.mute(self.entries, seconds, reason)
        told = printable(reason)
        _log.warning("%s: muted for %g s by the user: %s", self.name, seconds, told)

    def reset(self) -> None:
        """End the latch of a guard."""
        only_the_user(self.name, "reset", "ends a latch")
        self._check_protects("reset")
        for entry in self.entries:
            if not entry.latch:
                told = "it has no latch: esair.guards(..., latch=True)"
                raise BadValueError(self.name, "reset", told)
            why = entry.why_latched_still()
            if why:
                raise AccessDeniedError("user", self.name, "reset", why)
        self._table.reset(self.entries)
        _log.warning("%s: reset by the user", self.name)

    def _check_protects(self, field: str) -> None:
        if not self.entries:
            raise BadValueError(self.name, field, "it protects no actuator")


def _entry(action: Action, need: Need, component: str, label: str) -> Protection:
    guards = isinstance(need, Guards)
    return Protection(
        component,
        need.resource,
        need.priority,
        label=label,
        guards=guards,
        latch=isinstance(need, Guards) and need.latch,
    )
