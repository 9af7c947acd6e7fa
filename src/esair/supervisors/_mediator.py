"""The mediator: all data between behaviors passes here, and only on request.

A mailbox is what others see of one behavior: what it can receive and give, and who waits for
that. A request that would wait for itself is refused at once: two behaviors that ask each
other wait for nobody as long as one of them has somebody free to answer.
"""

from __future__ import annotations

import asyncio
import collections
import sys
from collections.abc import Callable, Coroutine, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import attrs

from esair.actions import NOTHING, Behavior, Reaction, Takes
from esair.actions import Request as Asked
from esair.connections import run_ended
from esair.exceptions import (
    BadValueError,
    BehaviorFailedError,
    BehaviorRemovedError,
    BehaviorUnavailableError,
    BusyError,
    CircularRequestError,
    EsairError,
    RefusedError,
    StoppingError,
    UnknownNameError,
    describe,
)
from esair.journal import Journal, Kind
from esair.loop import Budget, Deadlines, Owner, speaks_for_nobody, wake_one
from esair.messages import PEOPLE, BehaviorState
from esair.supervisors._requests import (
    Order,
    OrderQueue,
    Outcome,
    Request,
    RequestQueue,
    chain,
    wait_among,
)
from esair.values import is_positive

if TYPE_CHECKING:
    from esair.placement import Seat

_NO_QUEUES: Mapping[Any, OrderQueue] = {}
_NO_DATA: list[Any] = []  # shared by all that offer nothing
_NO_TAKERS: list[asyncio.Future[None]] = []  # hot: shared by all where nobody waits

_LEAVING = frozenset({BehaviorState.STOPPING, BehaviorState.REMOVED})

_ALIVE = frozenset(BehaviorState) - _LEAVING - {BehaviorState.FAILED}


@attrs.define(eq=False, repr=False)
class Mailbox:
    """What others see of a behavior: its state, what it can receive and give.

    It holds what was put for it and what it offers; the mediator fills it.
    """

    action: Behavior | Reaction
    mediator: Mediator
    name: str
    owner: Owner
    room: int = 0
    outlived: bool = False
    """Tasks of a run that has ended may be there; they must not speak for it."""
    carriers: tuple[asyncio.Task[Any], ...] = ()
    """The tasks that only wait for its threads."""
    seat: Seat | None = None
    """Where it lives, if it has a process of its own."""
    error: BaseException | None = None
    inbox: list[tuple[str, Any]] = attrs.field(factory=list)  # who put what
    latest: Any = NOTHING  # what everybody may get again and again
    outbox: list[Any] = _NO_DATA
    dropped: int = 0
    turned_away: int = 0  # how many requests and offers there was no room for
    # Puts that wait until it can receive, and gets that wait until it can send.
    senders: RequestQueue = attrs.field(init=False)
    askers: RequestQueue = attrs.field(init=False)
    queues: Mapping[Any, OrderQueue] = _NO_QUEUES
    """The requests that it takes, by their type."""
    takers: list[asyncio.Future[None]] = _NO_TAKERS
    budget: Budget = attrs.field(init=False)
    state: BehaviorState = BehaviorState.STARTING
    alive: bool = True
    is_quick: bool = True
    receives: bool = False
    is_near: bool = False
    """Whether it receives, and lives in this process: any data fits."""

    def __attrs_post_init__(self) -> None:
        self.senders = RequestQueue(self)
        self.askers = RequestQueue(self, "provide")
        self.budget = Budget.of(asyncio.get_running_loop())
        if isinstance(self.action, Behavior):
            asked_alone = getattr(self.action, "asked_alone", "")
            self.room = 0 if asked_alone else self.action.inbox_size
            if takes := self.action.takes:
                good = [each for each in takes.values() if isinstance(each, Takes)]
                self.queues = {each.type: OrderQueue(self, each) for each in good}

    def become(self, state: BehaviorState) -> None:
        self.state = state
        self.alive = state in _ALIVE
        self.is_quick = self.alive and not self.outlived
        is_open = state is BehaviorState.RUNNING
        if self.room and state is BehaviorState.RESTING:
            is_open = self.action.open_at_rest  # type: ignore[union-attr]
        self.receives = is_open and self.room > 0
        self.is_near = self.receives and self.seat is None

    def failure(self, error: BaseException | None = None) -> BehaviorFailedError:
        """Return what whoever needs it gets: it has failed for good, or by this error."""
        error = error or self.error
        assert error is not None
        failed = BehaviorFailedError(self.name, describe(error))
        failed.__cause__ = error
        return failed

    def absence(self, data: Any = None) -> EsairError:
        """Return what whoever needs it gets when it is not alive."""
        if self.state is BehaviorState.FAILED:
            return self.failure()
        return BehaviorRemovedError(self.name, data)

    def check_fits(self, verb: str, data: Any) -> None:
        """Pass if data can reach it where it lives.

        Raises:
            BadValueError: It cannot cross to its process: which field, and why.
        """
        if self.seat is not None:
            self.seat.pack(verb, data)

    def check_carries(self) -> None:
        """Pass if data can be put there, and got from there.

        Raises:
            RefusedError: It is a reaction, or at another robot.
        """
        is_reaction = isinstance(self.action, Reaction)
        told = "a reaction takes and gives no data" if is_reaction else ""
        if told := getattr(self.action, "asked_alone", told):
            raise RefusedError(told, self.name)

    def check_speaker(self) -> None:
        """Pass if the code that runs now may act in the name of the behavior."""
        if not self.alive:
            raise self.absence()
        if speaks_for_nobody():
            raise run_ended(self.name)

    # What the mediator asks.

    @property
    def is_leaving(self) -> bool:
        """Whether it is being removed, or has been: its actuators may still be."""
        return self.state in _LEAVING

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
            wake_one(self.takers)

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
        # What was made for it is not needed.
        request.withdraw(Outcome.DELIVERED, data)
        return True

    # What the behavior asks.

    def hand(self, receiver: str, data: Any, interval: float) -> bool:
        """Hand data over if that takes no wait; tells whether it did."""
        return self.is_quick and self.mediator.hand(data, self.name, receiver, interval)

    def take(self, sender: str, interval: float) -> Any:
        """Take data that another has offered; `NOTHING` if that has to be waited for."""
        return (
            self.mediator.take(sender, self.name, interval)
            if self.is_quick
            else NOTHING
        )

    def put(
        self, receiver: str, data: Any, interval: float
    ) -> Coroutine[Any, Any, None]:
        self.check_speaker()
        return self.mediator.put(data, self.name, receiver, interval, self)

    def get(
        self, sender: str, interval: float, *, is_taken: bool = True
    ) -> Coroutine[Any, Any, Any]:
        """Ask another behavior for data; if it is not taken yet, `got` tells when."""
        self.check_speaker()
        return self.mediator.get(sender, self.name, interval, self, is_taken=is_taken)

    def ask(
        self,
        receiver: str,
        request: Any,
        timeout: float | None,
        progress: Callable[[Any], object] | None,
    ) -> Coroutine[Any, Any, Any]:
        """Ask another behavior, and wait for its answer."""
        self.check_speaker()
        ask = self.mediator.ask
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
            if not self.takers:
                self.takers = []
            await wait_among(self.takers, deadline)
        taken = self.inbox.pop(0)
        if self.senders.count:
            self.admit()
        return taken

    def untake(self, taken: tuple[str, Any]) -> None:
        """Have again, before all others, what did not reach who has received it."""
        self.inbox.insert(0, taken)
        wake_one(self.takers)

    def got(self, sender: str, data: Any) -> None:
        """What was asked of another has been taken."""
        self.mediator.record("get", sender, self.name, _DELIVERED, data)

    def give_back(self, sender: str, data: Any) -> None:
        """Let the next one have what did not reach who has asked for it."""
        self.mediator.give_back(sender, self.name, data)

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
        if not self.outbox:
            self.outbox = []
        self.outbox.append(data)


def circle_of_ask(
    order: Request, busy: Sequence[Request | None], member: Mailbox
) -> list[str]:
    links = list(chain())
    peer = order.peer
    if busy:
        if all(any(each is link for link in links) for each in busy):
            return _path(links, peer)
        return []
    # Nobody takes such requests now: can anybody begin to?
    waits = [link.task for link in links if link.asker == peer]
    if order.asker == peer:
        waits.append(order.task)
    if not waits or not _all_wait(member, waits):
        return []
    return _path(links, peer)


def circle_of_get(
    asker: str,
    giver: str,
    members: Mapping[str, Mailbox],
    pending: Mapping[str, Iterable[Request]],
) -> list[str]:
    if asker == giver:
        return [asker, asker]
    links = list(chain())
    trail = [(giver, [asker, giver])]
    seen = {giver}
    while trail:
        name, path = trail.pop()
        member = members.get(name)
        if member is not None and member.askers.current in links:
            return _path(links, giver) if name == giver else [*path, asker]
        for request in _waits(member, _gets(pending, name)):
            other = request.peer
            if other == asker:
                if _is_stuck(members.get(asker), _gets(pending, asker), links):
                    return [*path, asker]
            elif other not in seen:
                seen.add(other)
                trail.append((other, [*path, other]))
    return []


def _gets(pending: Mapping[str, Iterable[Request]], asker: str) -> list[Request]:
    return [request for request in pending.get(asker, ()) if request.kind == "get"]


def _waits(member: Mailbox | None, gets: list[Request]) -> list[Request]:
    """Return the gets that the next answer of a behavior waits for."""
    if member is None:
        return gets
    if member.can_provide:
        serves = member.askers.current
        return [r for r in gets if serves is not None and r.parent is serves]
    tasks = [request.task for request in gets]
    return gets if gets and _all_wait(member, tasks) else []


def _is_stuck(
    member: Mailbox | None, gets: list[Request], links: list[Request]
) -> bool:
    """Tell whether the one that asks now has nobody else who would answer."""
    if member is None:
        return True
    if member.can_provide:
        return member.askers.current is not None and member.askers.current in links
    tasks = [request.task for request in gets]
    return _all_wait(member, [*tasks, asyncio.current_task()])


def _all_wait(member: Mailbox, waits: list[asyncio.Task[Any] | None]) -> bool:
    """Tell whether nobody of a behavior is left who does not wait."""
    if member.seat is not None and (works := member.seat.works()) is not None:
        return set(works).issubset(waits)
    living = set(member.owner.living())
    if any(task not in living for task in waits):
        return True  # somebody else acts in its name: what is known are the requests
    threads = member.owner.threads
    if threads and len(waits) >= len(threads):
        living.difference_update(member.carriers)
    return living.issubset(waits)


def _path(links: list[Request], peer: str) -> list[str]:
    """Return the names on the circle, in the order in which they wait."""
    names = [peer]
    for link in links:
        if link.peer == peer:
            break
        names.append(link.peer)
        if link.asker == peer:
            break
    return [peer, *reversed(names[1:]), peer]


REQUESTS_PER_SENDER = 16  # how many requests of one behavior may wait at a time
REQUESTS = 4096  # how many requests may wait in a robot at a time
LEDGER_SIZE = 256  # how many outcomes the ledger remembers

_DELIVERED = Outcome.DELIVERED

_LONGEST = sys.float_info.max


class Mediator:
    """Hands data from one behavior to another, and keeps the ledger of requests.

    When the other side is ready a request is a look-up, a check, an append and a
    wake-up; a task, a timer or a queue is made only when it has to wait.
    """

    def __init__(self, journal: Journal) -> None:
        self.journal = journal
        self.boxes: dict[str, Mailbox] = {}
        """The mailboxes of the robot's behaviors and reactions, by their names."""
        self.closed: bool = False
        self.ledger: collections.deque[tuple[str, str, str, Outcome]] = (
            collections.deque(maxlen=LEDGER_SIZE)
        )
        self.of_asker: dict[str, dict[Request, None]] = {}
        """The requests that each asker waits for, the oldest first."""
        self.pending: int = 0  # how many those are in all
        self.delivered: int = 0
        self.turned_away: int = 0
        self.late_answers: int = 0
        """How many answers came when nobody waited for them any more."""

    def counts(self) -> dict[str, int]:
        fields = ("delivered", "pending", "turned_away", "late_answers")
        return {field: getattr(self, field) for field in fields}

    # Put.

    def hand(self, data: Any, sender: str, receiver: str, interval: float) -> bool:
        """Deliver data at once if the receiver can take it; tells whether it did."""
        member = self.boxes.get(receiver)
        if (
            member is None
            or not member.is_near
            or self.closed
            or interval.__class__ is not float
            or not 0.0 < interval <= _LONGEST
            or (len(member.inbox) >= member.room and not member.make_room())
        ):
            return False
        member.inbox.append((sender, data))
        if member.takers:
            wake_one(member.takers)
        self.delivered += 1
        self.ledger.append(("put", sender, receiver, _DELIVERED))
        if self.journal.heard.put:
            self.journal.publish(Kind.PUT, receiver, sender, data)
        return True

    async def put(
        self,
        data: Any,
        sender: str,
        receiver: str,
        interval: float,
        by: Mailbox | None = None,
    ) -> None:
        """Hand data to a behavior; see `BehaviorSupervisor.put`."""
        member = self._check(receiver, "interval", interval, data)
        member.check_fits("put", data)
        if member.can_receive:
            member.deliver(data, sender)
            self.record("put", sender, receiver, _DELIVERED, data)
            return
        member.check_carries()
        request = Request("put", data, sender, member.senders, by)
        self._begin(request, interval)
        await request.outcome()

    # Get.

    def take(self, sender: str, receiver: str, interval: float) -> Any:
        """Return what the sender has offered; `NOTHING` if that has to be waited for."""
        member = self.boxes.get(sender)
        if (
            member is None
            or not (member.outbox or member.latest is not NOTHING)
            or sender == receiver
            or self.closed
            or interval.__class__ is not float
            or not 0.0 < interval <= _LONGEST
        ):
            return NOTHING
        self.delivered += 1
        self.ledger.append(("get", sender, receiver, _DELIVERED))
        data = member.outbox.pop(0) if member.outbox else member.latest
        if self.journal.heard.got:
            self.journal.publish(Kind.GOT, receiver, sender, data)
        return data

    async def get(
        self,
        sender: str,
        receiver: str,
        interval: float,
        by: Mailbox | None = None,
        *,
        is_taken: bool = True,
    ) -> Any:
        """Ask a behavior for data; see `BehaviorSupervisor.get`."""
        member = self._check(sender, "interval", interval)
        if sender != receiver and (member.outbox or member.latest is not NOTHING):
            data = member.outbox.pop(0) if member.outbox else member.latest
        else:
            member.check_carries()
            request = Request("get", None, receiver, member.askers, by)
            path = circle_of_get(receiver, sender, self.boxes, self.of_asker)
            self._begin(request, interval, path)
            member.askers.roused()
            try:
                data = await request.outcome()
            except asyncio.CancelledError:
                if request.how is _DELIVERED:  # it came in this very instant
                    self.give_back(sender, receiver, request.value)
                raise
        if is_taken:
            self.record("get", sender, receiver, _DELIVERED, data)
        return data

    def give_back(self, sender: str, receiver: str, data: Any) -> None:
        """Let the next one have what was not taken, if it is there once only."""
        self.record("get", sender, receiver, Outcome.WITHDRAWN)
        member = self.boxes.get(sender)
        if member is None or member.latest is not NOTHING:
            return
        if not member.give(data):
            member.outbox = [data, *member.outbox]

    # Ask.

    async def ask(
        self,
        request: Any,
        sender: str,
        receiver: str,
        timeout: float | None,
        progress: Callable[[Any], object] | None,
        by: Mailbox | None = None,
    ) -> Any:
        """Ask a behavior; see `BehaviorSupervisor.ask`."""
        await Budget.spend()
        if not isinstance(request, Asked):
            told = "expected an instance of a class derived from esair.Request"
            raise BadValueError(receiver, "request", f"{told}, not {request!r:.80}")
        if not (progress is None or callable(progress)):
            told = f"expected a function of what is told, not {progress!r:.80}"
            raise BadValueError(receiver, "progress", told)
        member = self._check(receiver, "timeout", timeout)
        queue = self._queue(member, request)
        if member.state is BehaviorState.FINISHED:
            raise _finished(member)
        if getattr(request, "_order", None) is not None:
            request = request.data  # it was taken, and is asked of somebody else
        member.check_fits("ask", request)
        order = Order(request, sender, queue, by)
        self._begin(order, timeout, circle_of_ask(order, queue.busy(), member))
        if self.journal.heard.asked:
            self.journal.publish(Kind.ASKED, receiver, sender, request)
        queue.roused()
        return await order.outcome(progress)

    def _queue(self, member: Mailbox, request: Asked[Any]) -> OrderQueue:
        if not isinstance(member.action, Behavior):
            there = self.boxes.items()
            names = [name for name, each in there if isinstance(each.action, Behavior)]
            raise UnknownNameError("behavior", member.name, names)
        queues = member.queues
        for kind in type(request).__mro__:
            queue = queues.get(kind)
            if queue is not None:
                return queue
        takes = ", ".join(sorted(kind.__name__ for kind in queues))
        self.record("ask", "", member.name, Outcome.REFUSED)
        raise RefusedError(
            f"it takes no {type(request).__name__}"
            + (f", but {takes}" if takes else ": it takes no requests"),
            member.name,
        )

    # What happens to the other side.

    def peer_failed(self, member: Mailbox, error: BaseException) -> None:
        """End every request that waits for a behavior that has crashed."""
        for queue in _queues(member):
            if not queue.outlives or member.state is BehaviorState.FAILED:
                queue.end_all(Outcome.PEER_FAILED, lambda _: member.failure(error))

    def peer_finished(self, member: Mailbox) -> None:
        """End what would be worked on by a behavior whose run has ended."""
        for queue in member.queues.values():
            queue.end_all(Outcome.PEER_FAILED, lambda _: _finished(member))

    def asker_ended(self, member: Mailbox) -> None:
        """End every request of a behavior whose run has ended, whoever waits in it."""
        ended = BehaviorRemovedError if member.state in _LEAVING else run_ended
        for request in tuple(self.of_asker.get(member.name, ())):
            if request.by is member:
                request.withdraw(Outcome.WITHDRAWN, error=ended(member.name))

    def peer_removed(self, member: Mailbox) -> None:
        """End every request that waits for a behavior that is removed."""
        for queue in _queues(member):
            queue.end_all(Outcome.PEER_REMOVED, _removed)

    def moved(self, old: Mailbox, new: Mailbox) -> None:
        """Let what waits for a behavior wait for the one in its place."""
        new.senders.adopt(old.senders)
        new.askers.adopt(old.askers)
        for kind, queue in old.queues.items():
            takes = new.queues.get(kind)
            if takes is not None:
                takes.adopt(queue)
            told = f"{new.name} was replaced, and takes no {kind.__name__}"
            for request in queue:
                request.withdraw(Outcome.REFUSED, error=RefusedError(told, new.name))
            queue.end_all(Outcome.PEER_REMOVED, _removed)
        new.admit()
        while new.outbox and new.give(new.outbox[0]):
            del new.outbox[0]

    def close(self) -> None:
        """End every request: the robot stops."""
        self.closed = True
        for member in self.boxes.values():
            for queue in _queues(member):
                if queue.count or queue.working:
                    queue.end_all(
                        Outcome.STOPPING,
                        lambda _: StoppingError("behaviors", "stopping"),
                    )

    # Requests that wait.

    def check_principal(self, role: str, name: str) -> None:
        """Refuse a request in the name of somebody who is not there.

        Raises:
            UnknownNameError: It is neither a component nor a person.
        """
        if name not in self.boxes and name not in PEOPLE:
            raise UnknownNameError(role, name, (*self.boxes, *PEOPLE))

    def _check(
        self, peer: str, field: str, seconds: float | None, data: Any = None
    ) -> Mailbox:
        """Return a behavior that somebody asks something of, if it may be asked."""
        if self.closed:
            raise StoppingError("behaviors", "stopping")
        member = self.boxes.get(peer)
        if member is None:
            raise UnknownNameError("behavior", peer, self.boxes)
        if not member.alive:
            raise member.absence(data)
        if not is_positive(seconds) and (seconds, field) != (None, "timeout"):
            expected = "seconds > 0" + (", or None" if field == "timeout" else "")
            raise BadValueError(
                peer, field, f"expected {expected}, not {seconds!r:.80}"
            )
        return member

    def _begin(
        self, request: Request, limit: float | None, path: Sequence[str] = ()
    ) -> None:
        """Have a request wait: for so many seconds at most, and within all bounds."""
        try:
            if path:
                raise CircularRequestError(path)
            own = self.of_asker.get(request.asker, ())
            if len(own) >= REQUESTS_PER_SENDER:
                self.turned_away += 1
                told = "number of its requests"
                raise BusyError(request.asker, told, REQUESTS_PER_SENDER)
            if self.pending >= REQUESTS:
                self.turned_away += 1
                raise BusyError("behaviors", "number of requests", REQUESTS)
            request.queue.push(request)
        except (BusyError, CircularRequestError):
            between = request.asker, request.peer
            if request.kind == "get":
                between = request.peer, request.asker
            self.record(request.kind, *between, Outcome.REFUSED)
            raise
        self.pending += 1
        self.of_asker.setdefault(request.asker, {})[request] = None
        if limit is not None:
            deadlines = Deadlines.of(request.loop)
            request.deadline = deadlines.after(limit, request.expire, limit)

    def ended(self, request: Request) -> None:
        """A request has its outcome."""
        self.pending -= 1
        others = self.of_asker[request.asker]
        del others[request]
        if not others:
            del self.of_asker[request.asker]

    def late(self) -> bool:
        """Count an answer that nobody waits for any more."""
        self.late_answers += 1
        return False

    def record(
        self, kind: str, sender: str, receiver: str, outcome: Outcome, data: Any = None
    ) -> None:
        """Write the outcome of a request into the ledger."""
        self.ledger.append((kind, sender, receiver, outcome))
        if outcome is _DELIVERED:
            self.delivered += 1
            event = Kind.PUT if kind == "put" else Kind.GOT
            if getattr(self.journal.heard, event):
                self.journal.publish(event, receiver, sender, data)


def _queues(member: Mailbox) -> tuple[RequestQueue, ...]:
    return (member.senders, member.askers, *member.queues.values())


def _removed(request: Request) -> BehaviorRemovedError:
    return BehaviorRemovedError(
        request.peer, request.data if request.kind == "put" else None
    )


def _finished(member: Mailbox) -> BehaviorFailedError:
    return BehaviorFailedError(member.name, "its run has ended")
