"""How often a crashed component may still be started again."""

from __future__ import annotations

import collections

from esair.messages import Restart


class RestartBudget:
    """Counts restarts within a window and says how long to wait before each."""

    def __init__(self, policy: Restart) -> None:
        self.policy = policy
        self.restarts = 0
        """How many restarts there were in all."""
        self._times: collections.deque[float] = collections.deque()

    def spend(self, now: float) -> float | None:
        """Return the pause before the next restart in seconds, or None if it is spent."""
        policy = self.policy
        times = self._times
        while times and now - times[0] > policy.within:
            times.popleft()
        if len(times) >= policy.max:
            return None
        doublings = min(len(times), 64)  # more would leave the range of a float
        pause = min(policy.delay * 2.0**doublings, policy.max_delay)
        times.append(now)
        self.restarts += 1
        return pause
