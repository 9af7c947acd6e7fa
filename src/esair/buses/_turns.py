"""Turns on a wire that carries one exchange at a time."""

from __future__ import annotations

import asyncio
import collections

from esair.buses._inbox import within


class Turns:
    """One at a time, in the order in which they asked.

    Attributes:
        waiting: How many wait for their turn, or have it.
    """

    def __init__(self) -> None:
        self.waiting = 0
        self._queue: collections.deque[asyncio.Future[None]] = collections.deque()

    def take_if_free(self) -> bool:
        """Have the turn at once if nobody has it; tells whether it was so."""
        if self.waiting:
            return False
        self.waiting = 1
        return True

    async def take(self, seconds: float) -> None:
        """Wait for the turn; `give` it back afterwards.

        Args:
            seconds: How long to wait.

        Raises:
            TimeoutError: It did not come in time; it must not be given back.
        """
        self.waiting += 1
        if self.waiting == 1:
            return
        turn: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._queue.append(turn)
        try:
            await within(turn, seconds)
        except BaseException:
            if turn in self._queue:
                self._queue.remove(turn)
                self.waiting -= 1
            elif not turn.cancelled() and turn.exception() is None:
                self.give()  # it came at the same moment
            raise

    def give(self) -> None:
        """Let the next one have its turn."""
        self.waiting -= 1
        while self._queue:
            turn = self._queue.popleft()
            if not turn.done():
                turn.set_result(None)
                return
            self.waiting -= 1
