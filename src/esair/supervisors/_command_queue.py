"""The command queue where a supervisor takes the user's commands, one at a time."""

from __future__ import annotations

import asyncio
import collections
import math
from collections.abc import Callable, Coroutine
from typing import Any, TypeVar

from esair.exceptions import BusyError, StoppingError
from esair.loop import VERB_COST, Budget, has_come, look_at, spawn
from esair.messages import SupervisorPhase

T = TypeVar("T")

LIMIT = 256  # how many commands of the user may wait at a supervisor


class CommandQueue:
    """Takes commands in WAIT_REQUEST only; the others wait in order, none is lost.

    A command runs in a task of its own, so that whoever gave it can be cancelled at
    any moment without leaving it half done. It changes the table of its supervisor in
    one step and says so by `changed`; what it waits for then, a ``setup`` or an end,
    keeps no other command waiting.
    """

    def __init__(self, name: str, *, asleep: bool = False) -> None:
        self.name = name
        self._asleep = asleep
        self._phase = SupervisorPhase.INITIALIZING
        self._waiting: collections.deque[asyncio.Future[None]] = collections.deque()
        self._work: asyncio.Task[Any] | None = None
        self._undoes: dict[asyncio.Task[Any], bool] = {}
        """Every command that is not done, and whether it can be undone still."""

    @property
    def phase(self) -> SupervisorPhase:
        """What the supervisor is doing; it handles a request until that is done."""
        if self._phase is SupervisorPhase.WAIT_REQUEST and self._undoes:
            return SupervisorPhase.HANDLING_REQUEST
        return self._phase

    async def run(
        self, work: Callable[[], Coroutine[Any, Any, T]], *, name: str, undo: bool
    ) -> T:
        """Do a command of the user when its turn has come."""
        await Budget.spend(VERB_COST)
        loop = asyncio.get_running_loop()
        await self._turn(loop)
        me = asyncio.current_task()
        assert me is not None
        before = me.cancelling()
        task = self._work = spawn(loop, work(), name=name)
        self._undoes[task] = undo
        task.add_done_callback(self._done)
        try:
            return await asyncio.shield(task)
        except asyncio.CancelledError:
            if task.cancelled() and me.cancelling() == before:  # the robot stopped
                raise StoppingError(self.name, self.phase.value) from None
            if self._undoes.get(task):
                task.cancel()
                await asyncio.wait({task})
            raise

    def no_return(self) -> None:
        """The work that runs can no longer be undone: it is finished in any case."""
        me = asyncio.current_task()
        if me in self._undoes:
            self._undoes[me] = False

    def changed(self) -> None:
        """The work that runs has changed the table: the next command may begin."""
        if self._work is not None and self._work is asyncio.current_task():
            self._work = None
            self._next()

    @property
    def _stopped(self) -> bool:
        return self._phase is SupervisorPhase.STOPPED

    async def _turn(self, loop: asyncio.AbstractEventLoop) -> None:
        if self._stopped:
            raise StoppingError(self.name, self.phase.value)
        if self._asleep:
            raise StoppingError(self.name, "not started yet: enter the robot first")
        if self._phase is SupervisorPhase.WAIT_REQUEST:
            self._phase = SupervisorPhase.HANDLING_REQUEST
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
            if has_come(turn):
                self._next()  # the turn came in the same tick: pass it on
            elif turn in self._waiting:
                self._waiting.remove(turn)
            raise

    def _done(self, task: asyncio.Task[Any]) -> None:
        del self._undoes[task]
        look_at(task)
        if self._work is task:
            self._work = None
            self._next()

    def _next(self) -> None:
        if self._stopped:
            return
        while self._waiting:
            turn = self._waiting.popleft()
            if not turn.done():
                self._phase = SupervisorPhase.HANDLING_REQUEST
                turn.set_result(None)
                return
        self._phase = SupervisorPhase.WAIT_REQUEST

    def wake(self) -> None:
        """The robot starts: let commands wait from now on."""
        self._asleep = False

    def initialized(self) -> None:
        """The configuration list is deployed: take commands from now on."""
        self._next()

    async def close(self, until: float = math.inf) -> None:
        """Refuse every further command, and end those that run, until a moment."""
        self._phase = SupervisorPhase.STOPPED
        waiting, self._waiting = self._waiting, collections.deque()
        for turn in waiting:
            if not turn.done():
                turn.set_exception(StoppingError(self.name, self.phase.value))
        running = set(self._undoes)
        for task in running:
            task.cancel()
        if running:
            left = max(0.0, until - asyncio.get_running_loop().time())
            await asyncio.wait(running, timeout=None if left == math.inf else left)
