"""One decision for each actuator in each turn, whoever decided first."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from esair.connections._registrations import Registration
from esair.loop import Scheduler

if TYPE_CHECKING:
    from esair.connections._actuator_channel import ActuatorChannel
    from esair.connections._sensor_channel import SensorChannel


class Wish(Protocol):
    """What somebody wants of an actuator in this turn."""

    @property
    def name(self) -> str:
        """Decides among equals of one behavior."""

    @property
    def registration(self) -> Registration:
        """The right by which it is wanted."""

    @property
    def command(self) -> Any:
        """What it wants sent; None to give the actuator back."""

    def commit(self, now: float) -> tuple[bool, Awaitable[object] | None]:
        """Do it at the turn's moment; return whether it was its turn, and what is left."""

    def lost(self, winner: Registration) -> None:
        """Learn that somebody else was first."""


class Sight(NamedTuple):
    """What somebody sees who decides about an actuator."""

    priority: float  # of what they want of it; that of a guard is above all
    sensors: tuple[SensorChannel, ...]  # which are asked for what they decide on


class Decision:
    """The wishes of one turn for one actuator; at most one command leaves.

    All steps of a turn decide before anything is sent. Then those who give the
    actuator back do so, and the highest priority wins (among equals the holder, then
    the name), whatever the order in which they decided.
    """

    __slots__ = (
        "_channel",
        "_looks",
        "_others",
        "_scheduler",
        "_wish",
        "changes_hands",
        "sights",
    )

    def __init__(
        self, channel: ActuatorChannel, loop: asyncio.AbstractEventLoop
    ) -> None:
        self._channel = channel
        self._scheduler = Scheduler.of(loop)
        self.sights: list[Sight] = []  # what those see who have a say in it
        self._wish: Wish | None = None
        self._others: tuple[Wish, ...] = ()
        self._looks = False  # the guards see something new in this turn
        self.changes_hands = False  # who gives it back is not the last of the turn

    def join(self, sight: Sight) -> None:
        """Let those who decide with them wait for what they see."""
        self.sights.append(sight)

    def leave(self, sight: Sight | None) -> None:
        """Wait for it no more. Also fine when it was never there."""
        self.sights = [each for each in self.sights if each is not sight]

    def look(self) -> None:
        """Have the guards look at what stands, before anything of this turn leaves.

        Not in their own step: what somebody who steps after them makes safe in this turn
        stands no more.
        """
        if not self._looks:
            self._looks = True
            if self._wish is None:
                self._scheduler.decide(self)

    def add(self, wish: Wish) -> None:
        """Take part in the decision of this turn; the wish commits at its end."""
        if self._wish is None:
            self._wish = wish
            scheduler = self._scheduler
            if self._looks:
                pass  # it is called anyway
            elif scheduler.in_turn:  # as mostly: `Scheduler.decide` in its place
                scheduler.decided.append(self)
            else:
                scheduler.decide(self)
        else:
            self._others += (wish,)

    def function(self, now: float) -> Awaitable[object] | None:
        """Decide. Called by the scheduler when all steps of the turn have run."""
        wish, self._wish = self._wish, None
        if self._looks:
            self._looks = False
            self._channel.review()
        if wish is None:
            return None
        if not self._others:
            return wish.commit(now)[1]
        wishes, self._others = [wish, *self._others], ()
        wishes.sort(key=self._rank)
        winner: Wish | None = None
        rest: Awaitable[object] | None = None
        self.changes_hands = True
        try:
            for wish in wishes:
                if winner is not None:
                    wish.lost(winner.registration)
                    continue
                decided, rest = wish.commit(now)
                winner = wish if decided else None
        finally:
            self.changes_hands = False
            self._channel.keep_still()
        return rest

    def _rank(self, wish: Wish) -> tuple[bool, int, bool, str, int, str]:
        registration = wish.registration
        holder = self._channel.present_holder
        return (
            wish.command is not None,  # who gives it back comes first
            -registration.priority,
            holder is None or registration.behavior != holder.behavior,
            registration.behavior,
            -registration.number,  # who takes the place of another comes before it
            wish.name,
        )
