"""Driving by hand: a lease that only fresh input renews."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, Protocol

import attrs

from esair.connections import ActuatorChannel, ActuatorConnection, Registration
from esair.exceptions import BadValueError, DeviceLostError, EsairError
from esair.loop import Job, Scheduler, clock_of, spawn, turn_of
from esair.messages import Access, Answer, Refused, Written
from esair.supervisors import ResourceSupervisor, admit
from esair.values import check_duration

SECONDS = 0.5
"""How long a lease lasts without fresh input, unless its taker says otherwise, in s."""

LONGEST = 2.0  # How long a lease may last without fresh input, in seconds

BEAT = 0.1
"""How often a client that drives is told the beat that its input answers, in s."""

BEATS = 64  # How many beats are remembered; input that answers an older one is old


class Beats:
    """Numbers that grow with time: what answers one cannot be older than it."""

    def __init__(self, time: Callable[[], float]) -> None:
        self._time = time
        self._numbers = itertools.count(1)
        self._sent: dict[int, float] = {}

    def next(self) -> int:
        """Return a new beat."""
        number = next(self._numbers)
        self._sent[number] = self._time()
        while len(self._sent) > BEATS:
            del self._sent[next(iter(self._sent))]
        return number

    def forget(self) -> None:
        """Know no beat any more: what answers one is old."""
        self._sent.clear()

    def time_of(self, number: object) -> float | None:
        """Return when a beat was sent; None if nobody knows any more."""
        return self._sent.get(number) if type(number) is int else None


class Driver(Protocol):
    """Who drives by hand."""

    def beat(self, number: int) -> object:
        """Hear a beat, to be answered by what is pressed then."""

    def lapsed(self, lease: Lease) -> object:
        """Hear that a lease is over."""


@attrs.define(eq=False)
class Lease:
    """The right of one session to drive one actuator, as long as it has fresh input."""

    number: int  # Grows: what has lapsed never comes back
    registration: Registration  # The right by which it writes
    seconds: float  # How long it lasts after the beat that the last input answers
    owner: Driver
    until: float  # When it lapses unless input renews it; on the loop's clock
    channel: ActuatorChannel
    fence: int = 0  # Of the actuator when the last input came: it was not safe since
    halts: int = 0  # Of the actuator then: nothing from before a halt leaves after it
    command: Any = None  # What it was told last; None before that
    timer: asyncio.TimerHandle | None = None
    repeats: Job | None = None
    writing: bool = False
    newest: tuple[Any, asyncio.Future[Any]] | None = None

    @property
    def actuator(self) -> str:
        """The name of the actuator."""
        return self.registration.resource


class Leases:
    """All leases of a robot; one for each actuator at a time."""

    def __init__(
        self,
        resources: ResourceSupervisor,
        actuators: ActuatorConnection,
        name: str,
        priority: int,
    ) -> None:
        self._resources = resources
        self._actuators = actuators
        self._name = name
        self._priority = priority
        self._numbers = itertools.count(1)
        self._live: dict[int, Lease] = {}
        self._loop = asyncio.get_running_loop()
        self._time = clock_of(self._loop)
        self._next_beat: asyncio.TimerHandle | None = None
        self.beats: Beats = Beats(self._time)
        suspends = turn_of(self._loop).suspends
        suspends.listen(self._slept)
        self._undo = partial(suspends.forget, self._slept)
        self.lapses: int = 0  # How many leases have lapsed for want of fresh input
        self.stale: int = 0  # How many inputs came too late and were not done

    def __iter__(self) -> Iterator[Lease]:
        return iter(tuple(self._live.values()))

    def take(self, actuator: str, seconds: float, owner: Driver) -> Lease:
        """Give somebody the lease of an actuator; whoever has it loses it."""
        channel = self._actuators.channel(actuator)
        check_duration("drive", "seconds", seconds)
        if seconds > LONGEST:
            raise BadValueError("drive", "seconds", f"expected at most {LONGEST:g}")
        for other in self:
            if other.actuator == actuator:
                self.end(other)
        registration = admit(
            self._resources, self._name, actuator, Access.WRITE, priority=self._priority
        )
        until = self._time() + seconds
        lease = Lease(next(self._numbers), registration, seconds, owner, until, channel)
        self._live[lease.number] = lease
        self._watch(lease)
        if self._next_beat is None:
            self._next_beat = self._loop.call_later(BEAT, self._beat)
        return lease

    async def drive(
        self, number: int, owner: Driver, beat: int, command: Callable[[Any], Any]
    ) -> Written[Any] | Refused:
        """Write what fresh input says, and renew the lease."""
        lease, now = self._live.get(number), self._time()
        if lease is not None and now >= lease.until:
            self._lapse(lease)
            lease = None
        if lease is None or lease.owner is not owner:
            self.stale += 1
            told = f"lease {number} has lapsed: nothing was moved, take it again"
            raise BadValueError("drive", "lease", told)
        sent = self.beats.time_of(beat)
        if sent is None or now >= sent + lease.seconds:
            self.stale += 1
            told = f"beat {beat} is older than {lease.seconds:g} s: nothing was moved"
            raise BadValueError("drive", "beat", told)
        resource = self._resources.get(lease.actuator)
        lease.command = command(resource)
        lease.until = max(lease.until, sent + lease.seconds)
        lease.channel = self._actuators.channel(lease.actuator)
        lease.fence, lease.halts = lease.channel.gate.fence, lease.channel.gate.halts
        if lease.repeats is None:
            pause = lease.channel.wire.command_timeout / 3
            lease.repeats = Scheduler.of(self._loop).every(
                pause, lambda _now: self._repeat(lease)
            )
        return await self._write(lease)  # type: ignore[no-any-return]

    def end(self, lease: Lease) -> None:
        """Give the actuator back; it is made safe if it does what the lease told it."""
        if self._live.pop(lease.number, None) is None:
            return
        if lease.timer is not None:
            lease.timer.cancel()
        if lease.repeats is not None:
            lease.repeats.stop()
        self._resources.revoke(
            lease.registration,
            lambda: DeviceLostError(lease.actuator, f"lease {lease.number} is over"),
        )
        if lease.newest is not None:
            _settle(lease.newest[1], _superseded(lease, self._time()))
            lease.newest = None
        lease.owner.lapsed(lease)

    def close(self) -> None:
        """The robot stops: give back what is driven."""
        self._undo()
        self.end_all()

    def end_all(self, owner: Driver | None = None) -> None:
        """End the leases of somebody who is gone; all of them unless given."""
        for lease in self:
            if owner is None or lease.owner is owner:
                self.end(lease)

    # Inside.

    def _slept(self, _seconds: float) -> None:
        """The computer slept, whose clock stood still: all input is from before."""
        self.beats.forget()
        for lease in self:
            self._lapse(lease)

    def _beat(self) -> None:
        """Tell a beat to those who drive: in a replay too, where nobody hears it."""
        self._next_beat = None
        if self._live:
            number = self.beats.next()
            for owner in dict.fromkeys(lease.owner for lease in self):
                owner.beat(number)
            self._next_beat = self._loop.call_later(BEAT, self._beat)

    def _watch(self, lease: Lease) -> None:
        if self._time() >= lease.until:
            self._lapse(lease)
            return
        lease.timer = self._loop.call_at(lease.until, self._watch, lease)

    def _lapse(self, lease: Lease) -> None:
        self.lapses += 1
        self.end(lease)

    def _repeat(self, lease: Lease) -> None:
        """Keep what was told alive within the lease: an actuator forgets sooner."""
        if self._time() >= lease.until:
            self._lapse(lease)
        elif not lease.writing and lease.channel.gate.fence == lease.fence:
            self._write(lease)

    def _write(self, lease: Lease) -> asyncio.Future[Any]:
        """Send the newest command; one at a time, and one waits: never more."""
        waiting: asyncio.Future[Any] = self._loop.create_future()
        waiting.add_done_callback(lambda done: done.cancelled() or done.exception())
        if lease.newest is not None:
            _settle(lease.newest[1], _superseded(lease, self._time()))
        lease.newest = (lease.command, waiting)
        if not lease.writing:
            lease.writing = True
            spawn(self._loop, self._writes(lease), name=f"drive {lease.actuator}")
        return waiting

    async def _writes(self, lease: Lease) -> None:
        try:
            while lease.newest is not None:
                (command, waiting), lease.newest = lease.newest, None
                try:
                    _settle(waiting, await self._send(lease, command))
                except EsairError as error:
                    if not waiting.done():
                        waiting.set_exception(error)
        finally:
            lease.writing = False

    async def _send(self, lease: Lease, command: Any) -> Written[Any] | Refused:
        if lease.halts != lease.channel.gate.halts:
            return _superseded(lease, self._time(), "the robot was halted meanwhile")
        hold = max(lease.until - self._time(), 0.001)
        return await self._actuators.write(lease.registration, command, hold=hold)


def _settle(waiting: asyncio.Future[Any], answer: Any) -> None:
    if not waiting.done():
        waiting.set_result(answer)


def _superseded(
    lease: Lease,
    now: float,
    told: str = "newer input came before the device was ready for this one",
) -> Refused:
    me = lease.registration
    return Refused(me.behavior, me.priority, told, now, now)


def answer_of(answer: Answer) -> dict[str, Any]:
    """Return what a write was answered with, as JSON has it."""
    from esair.recording import plain

    if isinstance(answer, Refused):
        return {"written": False, "holder": answer.holder, "rule": answer.rule}
    assert isinstance(answer, Written)
    return {"written": True, "command": plain(answer.command), "by": answer.by}
