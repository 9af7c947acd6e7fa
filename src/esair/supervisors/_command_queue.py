"""The command queue where a supervisor takes the user's commands, one at a time."""

from __future__ import annotations

import asyncio
import collections
from collections.abc import Callable, Coroutine
from typing import Any, TypeVar

from esair.exceptions import BusyError, StoppingError
from esair.loop import spawn
from esair.messages import SupervisorPhase

T = TypeVar("T")

LIMIT = 256
"""How many commands of the user may wait at a supervisor."""


class CommandQueue:
    """Takes commands in WAIT_REQUEST only; the others wait in order, none is lost.

    A command runs in a task of its own, so that whoever gave it can be cancelled at
    any moment without leaving it half done.

    Args:
        name: The name of the supervisor, for errors.
        asleep: Refuse commands until `wake`: nobody would ever see to them.
    """

    def __init__(self, name: str, *, asleep: bool = False) -> None:
        self.name = name
        self._asleep = asleep
        self.phase = SupervisorPhase.INITIALIZING
        self._waiting: collections.deque[asyncio.Future[None]] = collections.deque()
        self._work: asyncio.Task[Any] | None = None
        self._undoes = False

    async def run(
        self,
        work: Callable[[], Coroutine[Any, Any, T]],
        *,
        name: str,
        undo: bool,
    ) -> T:
        """Do a command of the user when its turn has come.

        Args:
            work: Makes the coroutine that does it.
            name: The name of its task.
            undo: Whether cancelling the caller cancels, and so undoes, the work.
                Else it is finished without the caller.

        Raises:
            StoppingError: The supervisor has stopped.
            BusyError: Too many commands wait.
        """
        loop = asyncio.get_running_loop()
        await self._turn(loop)
        me = asyncio.current_task()
        assert me is not None
        before = me.cancelling()
        self._undoes = undo
        task = self._work = spawn(loop, work(), name=name)
        task.add_done_callback(self._done)
        try:
            return await asyncio.shield(task)
        except asyncio.CancelledError:
            if task.cancelled() and me.cancelling() == before:  # the robot stopped
                raise StoppingError(self.name, self.phase.value) from None
            if self._work is task and self._undoes:
                task.cancel()
                await asyncio.wait({task})
            raise

    def no_return(self) -> None:
        """The work that runs can no longer be undone: it is finished in any case."""
        self._undoes = False

    @property
    def _stopped(self) -> bool:
        return self.phase is SupervisorPhase.STOPPED

    async def _turn(self, loop: asyncio.AbstractEventLoop) -> None:
        if self._stopped:
            raise StoppingError(self.name, self.phase.value)
        if self._asleep:
            raise StoppingError(self.name, "not started yet: enter the robot first")
        if self.phase is SupervisorPhase.WAIT_REQUEST:
            self.phase = SupervisorPhase.HANDLING_REQUEST
            return
        if len(self._waiting) >= LIMIT:
            raise BusyError(self.name, "number of waiting commands", LIMIT)
        turn: asyncio.Future[None] = loop.create_future()
        self._waiting.append(turn)
        try:
            await turn
            if self._stopped:  # in the same tick as the turn
                raise StoppingError(self.name, self.phase.value)
        except asyncio.CancelledError:
            if turn.done() and not turn.cancelled() and turn.exception() is None:
                self._next()  # the turn came in the same tick: pass it on
            elif turn in self._waiting:
                self._waiting.remove(turn)
            raise

    def _done(self, task: asyncio.Task[Any]) -> None:
        self._work = None
        if not task.cancelled():
            task.exception()  # its caller may have gone
        self._next()

    def _next(self) -> None:
        if self._stopped:
            return
        while self._waiting:
            turn = self._waiting.popleft()
            if not turn.done():
                self.phase = SupervisorPhase.HANDLING_REQUEST
                turn.set_result(None)
                return
        self.phase = SupervisorPhase.WAIT_REQUEST

    def wake(self) -> None:
        """The robot starts: let commands wait from now on."""
        self._asleep = False

    def initialized(self) -> None:
        """The configuration list is deployed: take commands from now on."""
        self._next()

    async def close(self) -> None:
        """Refuse every further command, and end the one that runs."""
        self.phase = SupervisorPhase.STOPPED
        waiting, self._waiting = self._waiting, collections.deque()
        for turn in waiting:
            if not turn.done():
                turn.set_exception(StoppingError(self.name, self.phase.value))
        if self._work is not None:
            self._work.cancel()
            await asyncio.wait({self._work})
