"""`ask`: a request that is answered, with one outcome at the asker."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from esair.actions import Behavior, Request
from esair.exceptions import (
    BadValueError,
    BehaviorUnavailableError,
    CircularRequestError,
    NotRegisteredError,
    RefusedError,
    UnknownNameError,
)
from esair.journal import Kind
from esair.loop import Budget
from esair.supervisors._circles import circle_of_ask
from esair.supervisors._ledger import Ledger
from esair.supervisors._mailbox import Mailbox
from esair.supervisors._orders import Order
from esair.supervisors._request_queue import RequestQueue
from esair.supervisors._requests import Outcome
from esair.values import is_positive


class Asks:
    """The part of the mediator that hands requests over and brings answers back."""

    def __init__(self, ledger: Ledger) -> None:
        self._ledger = ledger

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
        order = self._begin(request, sender, receiver, timeout, by)
        try:
            return await order.outcome(progress)
        finally:
            if not order.over:
                order.withdraw(Outcome.WITHDRAWN, None)

    def _begin(
        self,
        request: Any,
        sender: str,
        receiver: str,
        timeout: float | None,
        by: Mailbox | None,
    ) -> Order:
        ledger = self._ledger
        if not isinstance(request, Request):
            raise BadValueError(
                receiver,
                "request",
                "expected an instance of a class derived from esair.Request, "
                f"not {request!r:.80}",
            )
        if timeout is not None and not is_positive(timeout):
            raise BadValueError(
                receiver,
                "timeout",
                f"expected seconds > 0, or None, not {timeout!r:.80}",
            )
        member = ledger.check_peer(receiver)
        if not isinstance(member.action, Behavior):
            raise UnknownNameError("behavior", receiver, ledger.behaviors())
        queue = self._queue(member, request)
        failure = queue.failure()
        if failure is not None:
            raise failure
        order = Order(
            self, request.data if _is_taken(request) else request, sender, queue, by
        )
        path = circle_of_ask(order, queue.busy(), queue.member)
        if path:
            ledger.record("ask", sender, receiver, Outcome.REFUSED)
            raise CircularRequestError(path)
        ledger.check_bounds("ask", sender, receiver, sender)
        try:
            queue.push(order)
        except Exception:
            ledger.record("ask", sender, receiver, Outcome.REFUSED)
            raise
        ledger.pending.begin(sender)
        if ledger.journal.heard:
            ledger.journal.publish(Kind.ASKED, receiver, sender, order.data)
        if by is not None:
            by.asked[order] = None
        if timeout is not None:
            order.deadline = ledger.deadlines.after(
                timeout, self._expire, order, timeout
            )
        queue.roused()
        return order

    def _queue(self, member: Mailbox, request: Request[Any]) -> RequestQueue:
        queues = member.queues
        for kind in type(request).__mro__:
            queue = queues.get(kind)
            if queue is not None:
                return queue
        names = ", ".join(sorted(kind.__name__ for kind in queues))
        self._ledger.record("ask", "", member.name, Outcome.REFUSED)
        raise RefusedError(
            f"it takes no {type(request).__name__}"
            + (f", but {names}" if names else ": it takes no requests"),
            member.name,
        )

    def _expire(self, order: Order, timeout: float) -> None:
        state = order.queue.member.state.value
        order.withdraw(
            Outcome.TIMED_OUT,
            BehaviorUnavailableError(order.peer, "answer", timeout, state),
        )

    def late(self) -> bool:
        """Count an answer that nobody waits for any more."""
        self._ledger.late_answers += 1
        return False

    def ended(self, order: Order, outcome: Outcome, value: object) -> None:
        """An order has its outcome: an answer, an error, or nothing if it is withdrawn."""
        journal = self._ledger.journal
        self._ledger.record("ask", order.asker, order.peer, outcome)
        if journal.heard:
            journal.publish(
                Kind.ANSWERED, order.peer, order.asker, value, outcome.value
            )
        self._ledger.pending.end(order.asker)
        if order.by is not None:
            order.by.asked.pop(order, None)
        if order.deadline is not None:
            order.deadline.cancel()


def run_over(name: str) -> NotRegisteredError:
    """Make the error for a request whose asker's run has ended."""
    return NotRegisteredError(name, "robot", "this run of it has ended")


def _is_taken(request: Request[Any]) -> bool:
    return getattr(request, "_order", None) is not None
