"""What a behavior and a resource have in common: restarts, a budget, reports."""

from __future__ import annotations

import collections
import logging

from esair.exceptions import describe
from esair.journal import Journal, Kind
from esair.loop import raisable
from esair.messages import Restart

_log = logging.getLogger("esair")


class Life:
    """The life of one component: it fails, and is begun anew while its budget lasts.

    Attributes:
        name: The name of the component.
        restarts: How often it may still be begun anew.
        journal: Where it tells what becomes of it.
    """

    __slots__ = ("journal", "name", "restarts")

    def __init__(self, name: str, policy: Restart, journal: Journal) -> None:
        self.name = name
        self.restarts = RestartBudget(policy)
        self.journal = journal

    def tell(
        self, kind: Kind, error: BaseException | None = None, text: str = ""
    ) -> None:
        self.journal.publish(kind, self.name, "", error, text)

    def pause_after(self, error: BaseException, now: float) -> float | None:
        """Take a restart from the budget, after an error."""
        pause = self.restarts.spend(now)
        if pause is None:
            self.tell(Kind.FAILED, error, describe(error))
            _log.error(
                "%s: failed for good, %d restarts did not help: %s",
                self.name,
                self.restarts.policy.max,
                describe(error),
                exc_info=raisable(error),
            )
        return pause


class RestartBudget:
    """Counts restarts within a window and says how long to wait before each."""

    __slots__ = ("_times", "count", "policy")

    def __init__(self, policy: Restart) -> None:
        self.policy = policy
        self.count = 0  # how many restarts there were since it was full
        self._times: collections.deque[float] | None = None

    def fill(self) -> None:
        """Begin anew: somebody has asked for a restart, or nothing else helps."""
        self._times = None
        self.count = 0

    def spend(self, now: float) -> float | None:
        """Return the pause before the next restart in seconds, or None if it is spent."""
        policy = self.policy
        if self._times is None:
            self._times = collections.deque()
        times = self._times
        while times and now - times[0] > policy.within:
            times.popleft()
        if len(times) >= policy.max:
            return None
        doublings = min(len(times), 64)  # more would leave the range of a float
        pause = min(policy.delay * 2.0**doublings, policy.max_delay)
        times.append(now)
        self.count += 1
        return pause
