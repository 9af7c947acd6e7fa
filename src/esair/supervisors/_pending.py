"""How many requests wait, in all and for each asker: both are bounded."""

from __future__ import annotations

from esair.exceptions import BusyError
from esair.supervisors._requests import REQUESTS, REQUESTS_PER_SENDER


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
