"""Whose turn it is: among the wishes of one turn, and among the writes that wait."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Iterator
from functools import partial
from operator import attrgetter
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import attrs

from esair.connections._gate import Registration
from esair.exceptions import BusyError, NoTurnError
from esair.loop import Deadline, Deadlines, Scheduler, fail, has_come
from esair.messages import Refused, Written

if TYPE_CHECKING:
    from esair.connections._actuator_channel import ActuatorChannel
    from esair.connections._sensor_channel import SensorChannel

WAITING_LIMIT = 256  # how many writes may wait for one actuator at a time

Sent = Written[Any] | Refused | Awaitable[Written[Any] | Refused]
"""What comes of a write: its outcome, or what to await for it."""


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


@attrs.define(eq=False)
class Decision:
    """The wishes of one turn for one actuator; at most one command leaves.

    All steps of a turn decide before anything is sent. Then those who give the
    actuator back do so, and the highest priority wins (among equals the holder, then
    the name), whatever the order in which they decided.
    """

    _channel: ActuatorChannel
    _scheduler: Scheduler = attrs.field(init=False)
    sights: list[Sight] = attrs.field(factory=list)  # of those who have a say in it
    _wish: Wish | None = None
    _others: tuple[Wish, ...] = ()
    _looks: bool = False  # the guards see something new in this turn
    changes_hands: bool = False  # who gives it back is not the last of the turn

    def __attrs_post_init__(self) -> None:
        self._scheduler = Scheduler.of(self._channel.loop)

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
            if not self._looks:  # else it is called anyway
                self._scheduler.decide(self)
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
        registration, channel = wish.registration, self._channel
        holder = channel.hold.present(channel.time())
        return (
            wish.command is not None,  # who gives it back comes first
            -registration.priority,
            holder is None or registration.behavior != holder.behavior,
            registration.behavior,
            -registration.number,  # who takes the place of another comes before it
            wish.name,
        )


@attrs.define(eq=False)
class WaitingWrite:
    """A write that waits for its turn."""

    registration: Registration
    command: Any
    hold: float | None
    halts: int
    expires: float | None = None
    wish: Wish | None = None  # that may renew it; None if somebody waits for its end
    turn: asyncio.Future[Sent] = attrs.field(init=False)
    deadline: Deadline | None = None

    def end(self, end: Sent | Exception) -> None:
        if isinstance(end, Exception):
            fail(self.turn, end)
        elif not self.turn.done():
            self.turn.set_result(end)


@attrs.define(eq=False)
class WaitingWrites:
    """Keeps writes in order: the highest priority goes first, then the oldest."""

    _channel: ActuatorChannel
    _writes: list[WaitingWrite] = attrs.field(factory=list)
    turned_away: int = 0

    def __bool__(self) -> bool:
        return bool(self._writes)

    def __iter__(self) -> Iterator[WaitingWrite]:
        return iter(tuple(self._writes))

    async def turn(self, write: WaitingWrite) -> Sent:
        """Wait until somebody has said what becomes of a write; what leaves late is old."""
        if len(self._writes) >= WAITING_LIMIT:
            self.turned_away += 1
            name = self._channel.name
            raise BusyError(name, "number of waiting writes", WAITING_LIMIT)
        loop, limit = self._channel.loop, self._channel.actuator.deadline
        turn: asyncio.Future[Sent] = loop.create_future()
        write.turn = turn
        self._writes.append(write)
        write.deadline = Deadlines.of(loop).after(limit, self._expire, write, limit)
        try:
            return await turn
        except asyncio.CancelledError:
            if has_come(turn):
                sent = turn.result()  # its turn came in the same tick
                call = getattr(sent, "call", None)
                if call is not None:
                    call.cancel()
            raise
        finally:
            write.deadline.cancel()
            self.remove(write)

    def _expire(self, write: WaitingWrite, limit: float, *, last: bool = False) -> None:
        """End a wait; but once what has made it so long may end, and others have a turn."""
        channel, right = self._channel, write.registration
        seconds = limit if channel.safe.state else channel.wire.busy_for()
        if seconds > 0.0 and not last:
            over = partial(self._expire, write, limit, last=True)
            deadlines = Deadlines.of(channel.loop)
            write.deadline = deadlines.after(seconds + limit, over)
        elif channel.hold.keeps_away(right, channel.time()):  # it has lost to that
            assert channel.hold.holder is not None
            write.end(channel.refuse(right, channel.hold.refusal(channel.hold.holder)))
        else:
            write.end(NoTurnError(channel.name, "write", limit))

    def above(self, priority: int) -> Registration | None:
        """Return by which right of a higher priority one waits."""
        rights = (each.registration for each in self._writes if not each.turn.done())
        return next((right for right in rights if right.priority > priority), None)

    def first(self) -> WaitingWrite:
        """Take out the one whose turn it is."""
        first = max(self._writes, key=attrgetter("registration.priority"))
        self._writes.remove(first)
        return first

    def remove(self, write: WaitingWrite) -> None:
        if write in self._writes:
            self._writes.remove(write)
