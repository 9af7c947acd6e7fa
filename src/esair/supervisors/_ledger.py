"""The ledger of all requests between behaviors: how many wait, and how each has ended."""

from __future__ import annotations

import collections
import enum
from typing import Any, NamedTuple

from esair.exceptions import BusyError
from esair.journal import Journal, Kind

REQUESTS_PER_SENDER = 16  # how many requests of one behavior may wait at a time
REQUESTS = 4096  # how many requests may wait in a robot at a time
LEDGER_SIZE = 256  # how many outcomes the ledger remembers


class Outcome(enum.Enum):
    """How a request ended. Each ends in exactly one way."""

    DELIVERED = "delivered"
    ANSWERED = "answered"
    REFUSED = "refused"
    TIMED_OUT = "timed out"
    PEER_REMOVED = "peer removed"
    PEER_FAILED = "peer failed"
    STOPPING = "stopping"
    WITHDRAWN = "withdrawn"


class Record(NamedTuple):
    """One line of the ledger: who asked what of whom, and how it ended."""

    kind: str
    sender: str
    receiver: str
    outcome: Outcome


class Pending:
    """The requests that wait, by who waits for them."""

    def __init__(self) -> None:
        self.count: int = 0
        self.turned_away: int = 0
        self.of_asker: dict[str, dict[Any, None]] = {}
        """Those of each asker, the oldest first."""

    def check(self, asker: str) -> None:
        """Pass if one more request of an asker may wait."""
        if len(self.of_asker.get(asker, ())) >= REQUESTS_PER_SENDER:
            self.turned_away += 1
            raise BusyError(asker, "number of its requests", REQUESTS_PER_SENDER)
        if self.count >= REQUESTS:
            self.turned_away += 1
            raise BusyError("behaviors", "number of requests", REQUESTS)

    def begin(self, request: Any) -> None:
        self.count += 1
        others = self.of_asker.get(request.asker)
        if others is None:
            self.of_asker[request.asker] = {request: None}
        else:
            others[request] = None

    def end(self, request: Any) -> None:
        self.count -= 1
        others = self.of_asker[request.asker]
        del others[request]
        if not others:
            del self.of_asker[request.asker]


class Ledger:
    """What is known of all that behaviors ask of one another."""

    def __init__(self, journal: Journal) -> None:
        self.journal = journal
        self.pending: Pending = Pending()
        self.ledger: collections.deque[tuple[str, str, str, Outcome]] = (
            collections.deque(maxlen=LEDGER_SIZE)
        )
        self.delivered: int = 0
        self.late_answers: int = 0
        """How many answers came when nobody waited for them any more."""

    def outcomes(self) -> list[Record]:
        """Return the last outcomes, the oldest first."""
        return [Record(*line) for line in self.ledger]

    def counts(self) -> dict[str, int]:
        return {
            "delivered": self.delivered,
            "pending": self.pending.count,
            "turned_away": self.pending.turned_away,
            "late_answers": self.late_answers,
        }

    def late(self) -> bool:
        """Count an answer that nobody waits for any more."""
        self.late_answers += 1
        return False

    def record(
        self, kind: str, sender: str, receiver: str, outcome: Outcome, data: Any = None
    ) -> None:
        """Write the outcome of a request into the ledger."""
        self.ledger.append((kind, sender, receiver, outcome))
        if outcome is Outcome.DELIVERED:
            self.delivered += 1
            event = Kind.PUT if kind == "put" else Kind.GOT
            if getattr(self.journal.heard, event):
                self.journal.publish(event, receiver, sender, data)
