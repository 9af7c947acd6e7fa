"""What lives have in common: restarts, a budget, reports, and an end.

And which errors say that something is not there (yet), rather than that it is broken.
"""

from __future__ import annotations

import asyncio
import collections
import errno
import itertools
import logging
from collections.abc import Callable, Coroutine, Iterable, Mapping
from typing import TYPE_CHECKING, Any

import attrs

from esair.actions import Behavior, Reaction, Reads
from esair.connections import ANSWERS_WITHIN, SensorChannel
from esair.exceptions import (
    BehaviorRemovedError,
    DeviceFaultError,
    DeviceLostError,
    DriverStuckError,
    EsairError,
    NotRegisteredError,
    ResourceRemovedError,
    StaleReadingError,
    UnknownNameError,
    describe,
)
from esair.journal import Journal, Kind
from esair.loop import Order, Owner, raisable
from esair.messages import Reading, Restart

if TYPE_CHECKING:
    from esair.placement import Seat


_log = logging.getLogger("esair")


_SPREAD = 0.8  # over which part of its window the restarts of a budget are spread


class Life:
    """The life of one component: it fails, and is begun anew while its budget lasts.

    Attributes:
        name: The name of the component.
        policy: How often it may be begun anew, and when.
        journal: Where it tells what becomes of it.
        restarts: How many restarts there were since the budget was full.
        retries: Whether it is spent, and the component is tried from time to time.
    """

    __slots__ = (
        "_begins",
        "_times",
        "journal",
        "name",
        "policy",
        "restarts",
        "retries",
    )

    def __init__(self, name: str, policy: Restart, journal: Journal) -> None:
        self.name: str = name
        self.policy: Restart = policy
        self.journal: Journal = journal
        self._begins = 0.0  # when the last restart has begun
        self.fill()

    def fill(self) -> None:
        """Begin anew: somebody has asked for a restart, or nothing else helps."""
        self._times: collections.deque[float] | None = None
        self.restarts: int = 0
        self.retries: bool = False

    def tell(
        self, kind: Kind, error: BaseException | None = None, text: str = ""
    ) -> None:
        self.journal.publish(kind, self.name, "", error, text)

    def pause_after(self, error: BaseException, now: float) -> float | None:
        """Take a restart from the budget, after an error."""
        pause = self.spend(now)
        told = describe(error)
        if pause is None:
            self.tell(Kind.FAILED, error, told)
            _log.error(
                "%s: failed for good, %d restarts did not help: %s",
                self.name,
                self.policy.max,
                told,
                exc_info=raisable(error),
            )
        elif self.retries:
            _log.error("%s: failed: %s; tried again in %g s", self.name, told, pause)
        return pause

    def spend(self, now: float) -> float | None:
        """Return the pause before the next restart in seconds, or None if it is spent."""
        policy = self.policy
        times = self._times = self._times or collections.deque()
        while times and now - times[0] > policy.within:
            times.popleft()
        lasted = now - self._begins > policy.within
        self.retries = self.retries and not lasted
        if self.retries or len(times) >= policy.max:
            if policy.retry is None:
                return None
            self.retries, pause = True, policy.retry
        else:
            doublings = min(len(times), 64)  # more would leave the range of a float
            pause = policy.delay * 2.0**doublings
            if times:
                pause = max(pause, _SPREAD * policy.within / policy.max)
            pause = min(pause, policy.max_delay)
        times.append(now)
        self._begins = now + pause
        self.restarts += 1
        return pause


def where(seat: Seat | None) -> tuple[str, int | None]:
    """Say where a component lives, and the number of its own process if it has one."""
    return ("task", None) if seat is None else ("process", seat.pid)


_SILENT = frozenset({errno.EREMOTEIO, errno.ENXIO, errno.ETIMEDOUT, errno.EHOSTDOWN})
"""What the system says of a part that does not answer: nobody acknowledges, say."""


class AnotherDeviceError(DeviceFaultError):
    """Where the device was is another one now; waiting for the right one may help."""


def is_silence(error: BaseException) -> bool:
    """Tell whether a device has said nothing, or is not the right one: no wrong answer.

    It has no power yet, or it is still starting: it is waited for, for ever.
    """
    if isinstance(error, TimeoutError | AnotherDeviceError):
        return True
    chain: list[BaseException] = []
    cause: BaseException | None = error
    while cause is not None and all(each is not cause for each in chain):
        if isinstance(cause, OSError) and cause.errno in _SILENT:
            return True
        chain.append(cause)
        cause = cause.__cause__  # a driver may have made a circle of them
    return False


def is_absence(error: BaseException | None) -> bool:
    """Tell whether a device could not be opened because it cannot be had now.

    It is in use, its node has other rights, or nobody answers yet: the operating
    system says all of this by an OSError, and waiting may help. A fault that the device
    itself shows has no ``errno``.
    """
    return isinstance(error, OSError) and (
        error.errno is not None or not isinstance(error, EsairError)
    )


_ABSENCE = (
    DeviceFaultError,
    DeviceLostError,
    DriverStuckError,
    ResourceRemovedError,
    UnknownNameError,
)
"""What a behavior meets where a resource that it uses is not there, or not ready."""


def absent(action: Behavior | Reaction, is_ready: Callable[[str], bool]) -> list[str]:
    """Return what a behavior declares to use, and is not there or not ready."""
    if isinstance(action, Reaction):
        return []  # it is parked meanwhile, and never raises for it
    return [
        each.resource for each in action.needs.values() if not is_ready(each.provider)
    ]


def absent_for(
    error: BaseException, action: Behavior | Reaction, is_ready: Callable[[str], bool]
) -> list[str]:
    """Return what is not there, if an error may come from that."""
    if isinstance(error, BaseExceptionGroup):  # of a behavior with tasks of its own
        each_misses = [absent_for(each, action, is_ready) for each in error.exceptions]
        return each_misses[0] if all(each_misses) else []
    if not isinstance(error, _ABSENCE):
        return []
    missing = absent(action, is_ready)
    named = error.name if isinstance(error, UnknownNameError) else error.resource
    is_there = named in {need.resource for need in action.needs.values()}
    return [] if is_there and named not in missing else missing


@attrs.define(eq=False)
class Silence:
    """A sensor that says nothing new: it is followed until it does.

    Attributes:
        channel: That of the sensor.
        limit: The greatest age of what ends it, in seconds.
        over: What is called then.
    """

    channel: SensorChannel
    limit: float
    over: Callable[[str], None]
    registration: None = None
    order: Order = Order.DEAD

    def feed(self, reading: Reading[Any]) -> None:
        if self.channel.time() - reading.time <= self.limit:
            self.over(self.channel.name)

    def changed(self, error: EsairError | None) -> None:
        """Wait on: who waits learns elsewhere that the device is back."""

    def limited(self) -> None:
        """Go by what was asked for when it began."""

    def doubt(self, error: EsairError) -> None:
        """Wait for a good value."""

    def cancel(self) -> None:
        self.channel.unfollow(self)


def silence_for(
    error: BaseException,
    action: Behavior | Reaction,
    channels: Mapping[str, SensorChannel],
    over: Callable[[str], None],
) -> Silence | None:
    """Return which sensor that a behavior declares is silent, if an error says so.

    A limit below what is declared was the call's own, and so is the error.
    """
    if isinstance(error, BaseExceptionGroup):  # of a behavior with tasks of its own
        found = [silence_for(e, action, channels, over) for e in error.exceptions]
        return found[0] if all(found) else None
    if not isinstance(error, StaleReadingError) or error.resource not in channels:
        return None
    channel = channels[error.resource]
    declared = [
        need.max_age or channel.max_age
        for need in action.needs.values()
        if isinstance(need, Reads) and need.provider == channel.name
    ]
    if not declared or error.limit < min(*declared, ANSWERS_WITHIN):
        return None
    newest = channel.newest
    if newest is not None and channel.time() - newest.time <= error.limit:
        return None  # it has spoken meanwhile
    return Silence(channel, error.limit, over)


_SECOND = 0.04
"""How long a task may take that has swallowed its cancellation, in seconds."""


def living(owner: Owner) -> list[asyncio.Task[Any]]:
    """Return the tasks of an owner that have not ended, without the one that asks."""
    tasks, me = owner.living(), asyncio.current_task()
    if me in tasks:
        tasks.remove(me)
    return tasks


async def until_ended(tasks: list[asyncio.Task[Any]], grace: float) -> None:
    """Wait for tasks that were cancelled, if there are any."""
    if tasks:
        await asyncio.wait(tasks, timeout=max(grace, 0.001))


def cancel(owner: Owner) -> None:
    """Cancel the tasks of an owner, without waiting; those that were, not again."""
    left = owner.living()
    for task in left:
        if task not in owner.told:
            task.cancel()
    owner.told = left


async def end(owners: Iterable[Owner], grace: float) -> list[Owner]:
    """Cancel the tasks of owners, twice if need be; returns those some of which live.

    What was cancelled before this is cleaning up: it is left alone until its grace is over.
    """
    for attempt in range(3):
        found: dict[Owner, list[asyncio.Task[Any]]] = {}
        for owner in owners:
            if tasks := living(owner):
                found[owner] = tasks
        owners = list(found)
        if not owners or attempt == 2:
            break
        for owner, tasks in found.items():
            for task in tasks:
                if attempt or task not in owner.told:
                    task.cancel()
            owner.told = tasks
        left = list(itertools.chain.from_iterable(found.values()))
        await until_ended(left, _SECOND if attempt else grace)
    return list(owners)


async def side_by_side(works: list[Coroutine[Any, Any, None]]) -> None:
    """Wait for some works; the only one of them needs no task of its own."""
    if len(works) == 1:
        await works[0]
    else:
        await asyncio.gather(*works)


class UserRemovedError(BehaviorRemovedError, NotRegisteredError):
    """A behavior that was removed uses a port of its: both is true."""

    def __init__(self, behavior: str) -> None:
        EsairError.__init__(
            self, f"behavior {behavior!r} was removed: it is registered for nothing"
        )
        self.behavior = behavior
        self.resource = ""
        self.data = None
