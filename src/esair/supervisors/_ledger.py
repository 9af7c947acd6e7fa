"""The ledger of all requests between behaviors: how many wait, and how each has ended."""

from __future__ import annotations

import asyncio
import collections
from collections.abc import Mapping
from typing import Any

from esair.actions import Behavior
from esair.exceptions import BusyError, StoppingError, UnknownNameError
from esair.journal import Journal, Kind
from esair.loop import Deadlines
from esair.supervisors._mailbox import Mailbox
from esair.supervisors._requests import Outcome, Record

REQUESTS_PER_SENDER = 16  # how many requests of one behavior may wait at a time
REQUESTS = 4096  # how many requests may wait in a robot at a time
LEDGER_SIZE = 256  # how many outcomes the ledger remembers


class Pending:
    """Counts the requests that wait."""

    def __init__(self) -> None:
        self.count = 0
        self.of_asker: dict[str, int] = {}

    def full(self, asker: str) -> BusyError | None:
        """Return what an asker gets if not one more request of it may wait."""
        if self.of_asker.get(asker, 0) >= REQUESTS_PER_SENDER:
            return BusyError(asker, "number of its requests", REQUESTS_PER_SENDER)
        if self.count >= REQUESTS:
            return BusyError("behaviors", "number of requests", REQUESTS)
        return None

    def begin(self, asker: str) -> None:
        """Count a request that begins to wait."""
        self.count += 1
        self.of_asker[asker] = self.of_asker.get(asker, 0) + 1

    def end(self, asker: str) -> None:
        """Count a request that waits no more."""
        self.count -= 1
        left = self.of_asker[asker] - 1
        if left:
            self.of_asker[asker] = left
        else:
            del self.of_asker[asker]


class Ledger:
    """What is known of the behaviors, and of all that they ask of one another."""

    def __init__(self, members: Mapping[str, Mailbox], journal: Journal) -> None:
        self._members = members
        self.journal = journal
        self._loop = asyncio.get_running_loop()
        self.deadlines = Deadlines.of(self._loop)
        self.pending = Pending()
        self.closed = False
        self.ledger: collections.deque[tuple[str, str, str, Outcome]] = (
            collections.deque(maxlen=LEDGER_SIZE)
        )
        self.delivered = 0
        self.late_answers = 0
        """How many answers came when nobody waited for them any more."""

    def behaviors(self) -> list[str]:
        """Return the names of those who can be asked: reactions cannot."""
        return [
            name
            for name, member in self._members.items()
            if isinstance(member.action, Behavior)
        ]

    def outcomes(self) -> list[Record]:
        """Return the last outcomes, the oldest first."""
        return [Record(*line) for line in self.ledger]

    def counts(self) -> dict[str, int]:
        return {
            "delivered": self.delivered,
            "pending": self.pending.count,
            "late_answers": self.late_answers,
        }

    def check_peer(self, peer: str, data: Any = None) -> Mailbox:
        """Return a behavior that somebody asks something of, if it may be asked."""
        if self.closed:
            raise StoppingError("behaviors", "stopping")
        member = self._members.get(peer)
        if member is None:
            raise UnknownNameError("behavior", peer, self._members)
        if not member.alive:
            raise member.absence(data)
        return member

    def check_bounds(self, kind: str, sender: str, receiver: str, asker: str) -> None:
        """Pass if one more request of an asker may wait."""
        busy = self.pending.full(asker)
        if busy is not None:
            self.record(kind, sender, receiver, Outcome.REFUSED)
            raise busy

    def record(
        self, kind: str, sender: str, receiver: str, outcome: Outcome, data: Any = None
    ) -> None:
        """Write the outcome of a request into the ledger."""
        self.ledger.append((kind, sender, receiver, outcome))
        if outcome is Outcome.DELIVERED:
            self.delivered += 1
            if self.journal.heard:
                event = Kind.PUT if kind == "put" else Kind.GOT
                self.journal.publish(event, receiver, sender, data)
