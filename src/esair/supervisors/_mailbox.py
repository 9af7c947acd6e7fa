"""The mailbox of one behavior: what it can receive and give, and who waits for that."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine, Mapping
from typing import TYPE_CHECKING, Any

from esair.actions import NOTHING, Behavior, Reaction, Takes
from esair.connections import run_ended
from esair.exceptions import (
    BehaviorFailedError,
    BehaviorRemovedError,
    BehaviorUnavailableError,
    BusyError,
    EsairError,
    describe,
)
from esair.loop import Budget, Owner, speaks_for_nobody, wake, wake_one
from esair.messages import BehaviorState
from esair.supervisors._requests import (
    OrderQueue,
    Outcome,
    Request,
    RequestQueue,
    ServedQueue,
)

if TYPE_CHECKING:
    from esair.supervisors._mediator import Mediator

_NO_QUEUES: Mapping[Any, OrderQueue] = {}

_ALIVE = frozenset(
    {
        BehaviorState.STARTING,
        BehaviorState.RUNNING,
        BehaviorState.PARKED,
        BehaviorState.FINISHED,
        BehaviorState.RESTARTING,
        BehaviorState.RESTING,
    }
)


_LEAVING = frozenset({BehaviorState.STOPPING, BehaviorState.REMOVED})


class Mailbox:
    """What others see of a behavior: its state, what it can receive and give.

    It holds what was put for it and what it offers; the mediator fills it.
    """

    __slots__ = (
        "_mediator",
        "action",
        "alive",
        "askers",
        "budget",
        "carriers",
        "dropped",
        "error",
        "inbox",
        "is_leaving",
        "is_quick",
        "latest",
        "name",
        "outbox",
        "outlived",
        "owner",
        "queues",
        "receives",
        "room",
        "senders",
        "state",
        "takers",
        "turned_away",
    )

    def __init__(
        self,
        action: Behavior | Reaction,
        mediator: Mediator,
        name: str,
        owner: Owner,
    ) -> None:
        self.action: Behavior | Reaction = action
        self.name: str = name
        self.room: int = action.inbox_size if isinstance(action, Behavior) else 0
        self.outlived: bool = False
        """Tasks of a run that has ended may be there; they must not speak for it."""
        self.carriers: tuple[asyncio.Task[Any], ...] = ()
        """The tasks that only wait for its threads."""
        self.become(BehaviorState.STARTING)
        self.error: BaseException | None = None
        self.inbox: list[tuple[str, Any]] = []  # who put what
        self.latest: Any = NOTHING  # what everybody may get again and again
        self.outbox: list[Any] = []
        self.dropped: int = 0
        self.turned_away: int = 0  # how many requests and offers there was no room for
        # Puts that wait until it can receive, and gets that wait until it can send.
        self.senders: RequestQueue = RequestQueue(self)
        self.askers: ServedQueue = ServedQueue(self, "provide")
        self.queues: Mapping[Any, OrderQueue] = _NO_QUEUES
        """The requests that it takes, by their type."""
        if isinstance(action, Behavior) and action.takes:
            self.queues = {
                each.type: OrderQueue(self, each)
                for each in action.takes.values()
                if isinstance(each, Takes)
            }
        self.takers: list[asyncio.Future[None]] | None = None
        self.owner: Owner = owner
        self.budget: Budget = Budget.of(asyncio.get_running_loop())
        self._mediator = mediator

    def become(self, state: BehaviorState) -> None:
        self.state: BehaviorState = state
        self.alive: bool = state in _ALIVE
        self.is_leaving: bool = state in _LEAVING
        """Whether it is being removed, or has been: its actuators may still be."""
        self.is_quick: bool = self.alive and not self.outlived
        is_open = state is BehaviorState.RUNNING
        if self.room and state is BehaviorState.RESTING:
            is_open = self.action.open_at_rest  # type: ignore[union-attr]
        self.receives: bool = is_open and self.room > 0

    @property
    def serves(self) -> Request | None:
        """The get that it makes data for now."""
        return self.askers.current

    def failure(self) -> BehaviorFailedError:
        """Return what whoever needs it gets after it has failed for good."""
        assert self.error is not None
        return self.failed_by(self.error)

    def failed_by(self, error: BaseException) -> BehaviorFailedError:
        """Return what whoever waits for it gets when an error has ended its run."""
        failed = BehaviorFailedError(self.name, describe(error))
        failed.__cause__ = error
        return failed

    def absence(self, data: Any = None) -> EsairError:
        """Return what whoever needs it gets when it is not alive."""
        if self.state is BehaviorState.FAILED:
            return self.failure()
        return BehaviorRemovedError(self.name, data)

    def check_speaker(self) -> None:
        """Pass if the code that runs now may act in the name of the behavior."""
        if not self.alive:
            raise self.absence()
        if speaks_for_nobody():
            raise run_ended(self.name)

    # What the mediator asks.

    def has_room(self) -> bool:
        """Whether the inbox can take another piece of data."""
        if not self.receives:
            return False
        return len(self.inbox) < self.room or self.action.inbox_policy != "reject"  # type: ignore[union-attr]

    @property
    def can_receive(self) -> bool:
        """Whether a put is delivered at once."""
        return not self.senders.count and self.has_room()

    def make_room(self) -> bool:
        """Drop what its policy says from a full inbox; tells whether there is room."""
        policy = self.action.inbox_policy  # type: ignore[union-attr]
        if policy == "reject":
            return False
        drop = len(self.inbox) if policy == "latest" else 1
        del self.inbox[:drop]
        self.dropped += drop
        return True

    @property
    def can_provide(self) -> bool:
        """Whether the behavior makes data on demand, now."""
        action = self.action
        return (
            isinstance(action, Behavior)
            and action.provides
            and self.state is BehaviorState.RUNNING
        )

    @property
    def can_send(self) -> bool:
        """Whether a get is answered without waiting for a change of state."""
        return bool(self.outbox) or self.latest is not NOTHING or self.can_provide

    def deliver(self, data: Any, sender: str) -> None:
        """Put data into the inbox, which has room."""
        if len(self.inbox) >= self.room:
            self.make_room()
        self.inbox.append((sender, data))
        if self.takers:
            self.wake()

    def admit(self) -> None:
        """Take in what waits until it can receive again."""
        while self.senders.count and self.has_room():
            request = self.senders.pop()
            self.deliver(request.data, request.asker)
            request.end(Outcome.DELIVERED, request.data)

    def give(self, data: Any) -> bool:
        """Give data to whoever waits for some; tells whether somebody did."""
        if not self.askers.count:
            return False
        request = self.askers.pop()
        request.offered = self.latest is NOTHING
        # What was made for it is not needed.
        request.withdraw(Outcome.DELIVERED, data)
        return True

    def put_back(self, data: Any) -> None:
        """Give what an asker did not take, cancelled in that instant, to the next."""
        if not self.give(data):
            self.outbox.insert(0, data)

    def wake(self) -> None:
        """Wake one of those that wait in `receive`."""
        wake_one(self.takers or ())

    # What the behavior asks.

    def hand(self, receiver: str, data: Any, interval: float) -> bool:
        """Hand data over if that takes no wait; tells whether it did."""
        return self.is_quick and self._mediator.hand(
            data, self.name, receiver, interval
        )

    def take(self, sender: str, interval: float) -> Any:
        """Take data that another has offered; `NOTHING` if that has to be waited for."""
        return (
            self._mediator.take(sender, self.name, interval)
            if self.is_quick
            else NOTHING
        )

    def put(
        self, receiver: str, data: Any, interval: float
    ) -> Coroutine[Any, Any, None]:
        self.check_speaker()
        return self._mediator.put(data, self.name, receiver, interval, self)

    def get(self, sender: str, interval: float) -> Coroutine[Any, Any, Any]:
        """Ask another behavior for data."""
        self.check_speaker()
        return self._mediator.get(sender, self.name, interval, self)

    def ask(
        self,
        receiver: str,
        request: Any,
        timeout: float | None,
        progress: Callable[[Any], object] | None,
    ) -> Coroutine[Any, Any, Any]:
        """Ask another behavior, and wait for its answer."""
        self.check_speaker()
        ask = self._mediator.ask
        return ask(request, self.name, receiver, timeout, progress, self)

    def run_over(self, error: BaseException | None) -> None:
        """A run has ended: nobody works on what it had taken."""
        for queue in (self.askers, *self.queues.values()):
            queue.run_ended(error)

    async def receive(self, timeout: float | None) -> tuple[str, Any]:
        """Wait for data in the inbox, and take it; returns its sender, too."""
        loop = asyncio.get_running_loop()
        deadline = None if timeout is None else loop.time() + timeout
        while True:
            self.check_speaker()  # what a removed one has belongs to the remover
            if self.inbox:
                break
            if deadline is not None and loop.time() >= deadline:
                assert timeout is not None
                raise BehaviorUnavailableError(
                    self.name, "receive anything", timeout, self.state.value
                )
            taker = loop.create_future()
            if self.takers is None:
                self.takers = []
            self.takers.append(taker)
            timer = None
            if deadline is not None:
                timer = loop.call_at(deadline, wake, taker)
            try:
                await taker
            except asyncio.CancelledError:
                if self.inbox and not taker.cancelled():
                    self.wake()  # it was woken in the same tick: wake the next one
                raise
            finally:
                if timer is not None:
                    timer.cancel()
                self.takers.remove(taker)
                if not self.takers:
                    self.takers = None
        taken = self.inbox.pop(0)
        if self.senders.count:
            self.admit()
        return taken

    def offer(self, data: Any, latest: bool) -> None:
        """Lay data out for whoever asks for it."""
        self.check_speaker()
        self.latest = data if latest else NOTHING
        if latest:
            self.outbox.clear()
            while self.give(data):
                continue  # everybody who waits gets it
            return
        if self.give(data):
            return
        action = self.action
        assert isinstance(action, Behavior)
        if len(self.outbox) >= action.outbox_size:
            if action.outbox_policy == "reject":
                self.turned_away += 1
                raise BusyError(self.name, "outbox_size", action.outbox_size)
            drop = len(self.outbox) if action.outbox_policy == "latest" else 1
            del self.outbox[:drop]
            self.dropped += drop
        self.outbox.append(data)
