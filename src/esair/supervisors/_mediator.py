"""The mediator: all data between behaviors passes here, and only on request."""

from __future__ import annotations

import asyncio
import functools
import sys
from collections.abc import Mapping
from typing import Any

from esair.actions import NOTHING
from esair.exceptions import (
    BadValueError,
    BehaviorRemovedError,
    BehaviorUnavailableError,
    BusyError,
    CircularRequestError,
    EsairError,
    StoppingError,
    describe,
)
from esair.journal import Journal, Kind
from esair.loop import fail, spawn
from esair.messages import BehaviorState
from esair.supervisors._asks import Asks, run_over
from esair.supervisors._circles import circle_of_get
from esair.supervisors._ledger import Ledger
from esair.supervisors._mailbox import Mailbox
from esair.supervisors._request_queue import Done, do_for, done_by
from esair.supervisors._requests import (
    REQUESTS_PER_TARGET,
    Outcome,
    Request,
)
from esair.values import is_positive

_DELIVERED = Outcome.DELIVERED

_LONGEST = sys.float_info.max


class Mediator(Ledger):
    """Hands data from one behavior to another, and keeps the ledger of requests.

    When the other side is ready a request is a look-up, a check, an append and a
    wake-up; a task, a timer or a queue is made only when it has to wait.
    """

    def __init__(self, members: Mapping[str, Mailbox], journal: Journal) -> None:
        super().__init__(members, journal)
        self.ask = Asks(self).ask
        self._gets: dict[str, list[Request]] = {}
        """For each behavior that waits in a get: its requests."""

    # Put.

    def hand(self, data: Any, sender: str, receiver: str, interval: float) -> bool:
        """Deliver data at once if the receiver can take it; tells whether it did."""
        member = self._members.get(receiver)
        if (
            member is None
            or not member.receives
            or len(member.inbox) >= member.room
            or self.closed
            or interval.__class__ is not float
            or not 0.0 < interval <= _LONGEST
        ):
            return False
        member.inbox.append(data)
        member.origins.append(sender)
        if member.takers:
            member.wake()
        self.delivered += 1
        self.ledger.append(("put", sender, receiver, _DELIVERED))
        if self.journal.heard:
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
        member = self._check(receiver, interval, data)
        if member.can_receive:
            member.deliver(data, sender)
            self.record("put", sender, receiver, _DELIVERED, data)
            return
        request = self._begin("put", sender, receiver, data, member.senders.count, by)
        member.senders.push(request)
        deadline = self.deadlines.after(
            interval, self._expire, request, interval, member
        )
        try:
            await request.future
        except BaseException as error:
            self._members.get(receiver, member).senders.discard(request)
            member.senders.discard(request)
            self._withdraw(request, error)
            raise
        finally:
            deadline.cancel()
            self._finish(request)

    def admit(self, member: Mailbox) -> None:
        """Deliver what waits for a behavior that can receive again."""
        senders = member.senders
        while senders.count and member.has_room():
            request = senders.pop()
            future = request.future
            if not future.done():
                data, sender = request.data, request.sender
                member.deliver(data, sender)
                self.record("put", sender, request.receiver, _DELIVERED, data)
                future.set_result(None)

    # Get.

    def take(self, sender: str, receiver: str, interval: float) -> Any:
        """Return what the sender has offered; `NOTHING` if that has to be waited for."""
        member = self._members.get(sender)
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
        if self.journal.heard:
            self.journal.publish(Kind.GOT, receiver, sender, data)
        return data

    async def get(
        self, sender: str, receiver: str, interval: float, by: Mailbox | None = None
    ) -> Any:
        """Ask a behavior for data; see `BehaviorSupervisor.get`."""
        offered = self.take(sender, receiver, interval)
        if offered is not NOTHING:
            return offered
        return await self._get_slowly(sender, receiver, interval, by)

    async def _get_slowly(
        self, sender: str, receiver: str, interval: float, by: Mailbox | None
    ) -> Any:
        member = self._check(sender, interval)
        path = circle_of_get(receiver, sender, self._members, self._gets)
        if path:
            self.record("get", sender, receiver, Outcome.REFUSED)
            raise CircularRequestError(path)
        if member.outbox or member.latest is not NOTHING:
            offered = member.outbox.pop(0) if member.outbox else member.latest
            self.record("get", sender, receiver, _DELIVERED, offered)
            return offered
        request = self._begin("get", sender, receiver, None, member.askers.count, by)
        member.askers.push(request)
        self._gets.setdefault(receiver, []).append(request)
        self.serve(member)
        deadline = self.deadlines.after(
            interval, self._expire, request, interval, member
        )
        try:
            data = await request.future
            self.record("get", sender, receiver, _DELIVERED, data)
            return data
        except BaseException as error:
            self._withdraw(request, error)
            if request.offered:
                self._put_back(self._members.get(sender, member), request)
            raise
        finally:
            deadline.cancel()
            self._finish(request)
            waits = self._gets[receiver]
            waits.remove(request)
            if not waits:
                del self._gets[receiver]
            self._members.get(sender, member).askers.discard(request)
            member.askers.discard(request)
            if request.provider is not None:
                request.provider.cancel()

    def offered(self, member: Mailbox, data: Any) -> bool:
        """Hand offered data to whoever waits for it; tells whether somebody did."""
        while member.askers.count:
            request = member.askers.pop()
            if request.future.done():
                continue
            request.offered = member.latest is NOTHING
            request.future.set_result(data)
            return True
        return False

    def _put_back(self, member: Mailbox, request: Request) -> None:
        """Give what an asker did not take, cancelled in that instant, to the next."""
        data = request.future.result()
        if not self.offered(member, data):
            member.outbox.insert(0, data)

    def serve(self, member: Mailbox) -> None:
        """Have a behavior make the data that somebody waits for, one at a time."""
        if not member.can_provide or member.provider is not None or self.closed:
            return
        request = member.askers.peek()
        if request is None:
            return
        member.serves = request
        request.provider = member.provider = spawn(
            self._loop,
            do_for(request, member, "provide"),
            name=f"{member.name} provide",
            owner=member.owner,
        )
        # Not in the task itself: one that is cancelled before its first step does
        # nothing at all.
        member.provider.add_done_callback(
            functools.partial(self._provided, member, request)
        )

    def _provided(
        self, member: Mailbox, request: Request, task: asyncio.Task[Done]
    ) -> None:
        data, error = done_by(task)
        member.provider = member.serves = None
        waited = member.askers.discard(request)
        if not waited or request.future.done():
            self.late_answers += error is None
        elif error is None:
            request.offered = True
            request.future.set_result(data)
        else:
            failed: EsairError = member.failed_by(error)
            if type(error) is CircularRequestError and request.asker in error.path:
                # It waits for itself: told as plainly as to the one that closed the circle.
                failed = CircularRequestError(error.path)
                failed.__cause__ = error
            self._fail(request, failed, Outcome.PEER_FAILED)
        self.serve(member)

    # What happens to the other side.

    def peer_failed(self, member: Mailbox, error: BaseException) -> None:
        """End every request that waits for a behavior that has crashed."""
        for request in self._drain(member):
            self._fail(request, member.failed_by(error), Outcome.PEER_FAILED)
        if member.state is BehaviorState.FAILED:
            for queue in member.queues.values():
                queue.fail_all(describe(error), error)

    def peer_finished(self, member: Mailbox) -> None:
        """End every request that waits for a behavior whose run has ended."""
        for queue in member.queues.values():
            queue.fail_all("its run has ended", None)

    def asker_ended(self, member: Mailbox, *, removed: bool = False) -> None:
        """End every request of a behavior whose run has ended, whoever waits in it."""
        make = BehaviorRemovedError if removed else run_over
        for each in tuple(member.asked):
            if isinstance(each, Request):
                self._fail(each, make(member.name), Outcome.WITHDRAWN)
            else:
                each.withdraw(Outcome.WITHDRAWN, make(member.name))

    def peer_removed(self, member: Mailbox) -> None:
        """End every request that waits for a behavior that is removed."""
        for request in self._drain(member):
            self._fail(
                request,
                BehaviorRemovedError(member.name, request.data),
                Outcome.PEER_REMOVED,
            )
        for queue in member.queues.values():
            queue.end_all(
                Outcome.PEER_REMOVED, lambda: BehaviorRemovedError(member.name)
            )

    def moved(self, old: Mailbox, new: Mailbox) -> None:
        """Let what waits for a behavior wait for the one in its place."""
        for before, after in ((old.senders, new.senders), (old.askers, new.askers)):
            for request in before.drain():
                after.push(request)
        for kind, queue in old.queues.items():
            takes = new.queues.get(kind)
            if takes is not None:
                takes.adopt(queue)
            else:
                queue.refuse_all(
                    f"{new.name} was replaced, and takes no {kind.__name__}"
                )
            queue.end_all(Outcome.PEER_REMOVED, lambda: BehaviorRemovedError(old.name))
        self.admit(new)
        while new.outbox and self.offered(new, new.outbox[0]):
            del new.outbox[0]
        self.serve(new)

    def close(self) -> None:
        """End every request: the robot stops."""
        self.closed = True
        for member in self._members.values():
            for request in self._drain(member):
                self._fail(
                    request, StoppingError("behaviors", "stopping"), Outcome.STOPPING
                )
            for queue in member.queues.values():
                queue.end_all(
                    Outcome.STOPPING, lambda: StoppingError("behaviors", "stopping")
                )

    def _drain(self, member: Mailbox) -> list[Request]:
        return [*member.senders.drain(), *member.askers.drain()]

    # Requests that wait.

    def _check(self, peer: str, interval: object, data: Any = None) -> Mailbox:
        member = self.check_peer(peer, data)
        if not is_positive(interval):
            raise BadValueError(
                peer, "interval", f"expected seconds > 0, not {interval!r:.80}"
            )
        return member

    def _begin(
        self,
        kind: str,
        sender: str,
        receiver: str,
        data: Any,
        waiting: int,
        by: Mailbox | None,
    ) -> Request:
        future = self._loop.create_future()
        request = Request(kind, sender, receiver, data, future, by)
        if waiting >= REQUESTS_PER_TARGET:
            self.record(kind, sender, receiver, Outcome.REFUSED)
            raise BusyError(
                request.peer, "number of requests to it", REQUESTS_PER_TARGET
            )
        self.check_bounds(kind, sender, receiver, request.asker)
        self.pending.begin(request.asker)
        if by is not None:
            by.asked[request] = None
        return request

    def _finish(self, request: Request) -> None:
        self.pending.end(request.asker)
        if request.by is not None:
            request.by.asked.pop(request, None)

    def _withdraw(self, request: Request, error: BaseException) -> None:
        """Record a request whose asker was cancelled before it had an outcome."""
        if not isinstance(error, asyncio.CancelledError):
            return
        if request.future.cancelled() or request.future.exception() is None:
            self.record(
                request.kind, request.sender, request.receiver, Outcome.WITHDRAWN
            )

    def _expire(self, request: Request, interval: float, member: Mailbox) -> None:
        what = "receive" if request.kind == "put" else "send"
        self._fail(
            request,
            BehaviorUnavailableError(request.peer, what, interval, member.state.value),
            Outcome.TIMED_OUT,
        )

    def _fail(self, request: Request, error: EsairError, outcome: Outcome) -> None:
        if not request.future.done():
            self.record(request.kind, request.sender, request.receiver, outcome)
            fail(request.future, error)
