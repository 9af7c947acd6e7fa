"""The mediator: all data between behaviors passes here, and only on request."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Callable, Sequence
from typing import Any

from esair.actions import NOTHING, Behavior
from esair.actions import Request as Asked
from esair.connections import run_ended
from esair.exceptions import (
    BadValueError,
    BehaviorFailedError,
    BehaviorRemovedError,
    BusyError,
    CircularRequestError,
    RefusedError,
    StoppingError,
    UnknownNameError,
)
from esair.journal import Journal, Kind
from esair.loop import Budget, Deadlines
from esair.messages import PEOPLE, BehaviorState
from esair.supervisors._circles import circle_of_ask, circle_of_get
from esair.supervisors._ledger import Ledger, Outcome
from esair.supervisors._mailbox import Mailbox
from esair.supervisors._orders import Order, OrderQueue
from esair.supervisors._requests import Request, RequestQueue
from esair.values import is_positive

_DELIVERED = Outcome.DELIVERED

_LONGEST = sys.float_info.max


class Mediator(Ledger):
    """Hands data from one behavior to another, and keeps the ledger of requests.

    When the other side is ready a request is a look-up, a check, an append and a
    wake-up; a task, a timer or a queue is made only when it has to wait.
    """

    def __init__(self, journal: Journal) -> None:
        super().__init__(journal)
        self.boxes: dict[str, Mailbox] = {}
        """The mailboxes of the robot's behaviors and reactions, by their names."""
        self.closed: bool = False

    # Put.

    def hand(self, data: Any, sender: str, receiver: str, interval: float) -> bool:
        """Deliver data at once if the receiver can take it; tells whether it did."""
        member = self.boxes.get(receiver)
        if (
            member is None
            or not member.receives
            or self.closed
            or interval.__class__ is not float
            or not 0.0 < interval <= _LONGEST
            or (len(member.inbox) >= member.room and not member.make_room())
        ):
            return False
        member.inbox.append((sender, data))
        if member.takers:
            member.wake()
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
        if self.hand(data, sender, receiver, float(interval)):
            return
        request = Request("put", data, sender, member.senders, by, self)
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
        self, sender: str, receiver: str, interval: float, by: Mailbox | None = None
    ) -> Any:
        """Ask a behavior for data; see `BehaviorSupervisor.get`."""
        member = self._check(sender, "interval", interval)
        offered = self.take(sender, receiver, float(interval))
        if offered is not NOTHING:
            return offered
        request = Request("get", None, receiver, member.askers, by, self)
        path = circle_of_get(receiver, sender, self.boxes, self.pending.of_asker)
        self._begin(request, interval, path)
        member.askers.roused()
        try:
            data = await request.outcome()
        except asyncio.CancelledError:
            if request.how is _DELIVERED:  # it came in this very instant
                self.record("get", sender, receiver, Outcome.WITHDRAWN)
                if request.offered:
                    self.boxes.get(sender, member).put_back(request.value)
            raise
        self.record("get", sender, receiver, _DELIVERED, data)
        return data

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
        member = self._check(receiver, "timeout", timeout)
        queue = self._queue(member, request)
        if member.state is BehaviorState.FINISHED:
            raise _finished(member)
        if getattr(request, "_order", None) is not None:
            request = request.data  # it was taken, and is asked of somebody else
        order = Order(request, sender, queue, by, self)
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
                queue.end_all(Outcome.PEER_FAILED, lambda _: member.failed_by(error))

    def peer_finished(self, member: Mailbox) -> None:
        """End what would be worked on by a behavior whose run has ended."""
        for queue in member.queues.values():
            queue.end_all(Outcome.PEER_FAILED, lambda _: _finished(member))

    def asker_ended(self, member: Mailbox, *, removed: bool = False) -> None:
        """End every request of a behavior whose run has ended, whoever waits in it."""
        for request in tuple(self.pending.of_asker.get(member.name, ())):
            if request.by is member:
                ended = run_ended(member.name)
                error = BehaviorRemovedError(member.name) if removed else ended
                request.withdraw(Outcome.WITHDRAWN, error=error)

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
        for each in new.served:
            each.roused()

    def close(self) -> None:
        """End every request: the robot stops."""
        self.closed = True
        for member in self.boxes.values():
            for queue in _queues(member):
                queue.end_all(
                    Outcome.STOPPING, lambda _: StoppingError("behaviors", "stopping")
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
            self.pending.check(request.asker)
            request.queue.push(request)
        except (BusyError, CircularRequestError):
            between = request.asker, request.peer
            if request.kind == "get":
                between = request.peer, request.asker
            self.record(request.kind, *between, Outcome.REFUSED)
            raise
        self.pending.begin(request)
        if limit is not None:
            deadlines = Deadlines.of(asyncio.get_running_loop())
            request.deadline = deadlines.after(limit, request.expire, limit)


def _queues(member: Mailbox) -> tuple[RequestQueue, ...]:
    return (member.senders, *member.served)


def _removed(request: Request) -> BehaviorRemovedError:
    return BehaviorRemovedError(
        request.peer, request.data if request.kind == "put" else None
    )


def _finished(member: Mailbox) -> BehaviorFailedError:
    return BehaviorFailedError(member.name, "its run has ended")
