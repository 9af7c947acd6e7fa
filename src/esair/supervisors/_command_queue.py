"""The command queue where a supervisor takes the user's commands, one at a time."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any, TypeVar

from esair.exceptions import BusyError, StoppingError
from esair.loop import VERB_COST, Budget, look_at, spawn
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
        self._begins = asyncio.Event()
        """Set from when commands have their turns."""
        self._turn = asyncio.Lock()
        """Held by the work that has not changed the table yet."""
        self._waiting = 0
        self.turned_away: int = 0  # how many commands there was no room for
        self._work: asyncio.Task[Any] | None = None
        self._undoes: dict[asyncio.Task[Any], bool] = {}
        """Every command that is not done, and whether it can be undone still."""
        self._lasting: set[asyncio.Task[Any]] = set()
        """Those of them that the stop of the robot lets end."""

    @property
    def phase(self) -> SupervisorPhase:
        """What the supervisor is doing; it handles a request until that is done."""
        is_busy = self._undoes or self._waiting or self._turn.locked()
        if self._phase is SupervisorPhase.WAIT_REQUEST and is_busy:
            return SupervisorPhase.HANDLING_REQUEST
        return self._phase

    async def run(
        self,
        work: Callable[[], Coroutine[Any, Any, T]],
        *,
        name: str,
        undo: bool,
        lasts: bool = False,
    ) -> T:
        """Do a command of the user when its turn has come.

        Args:
            work: What to do.
            name: What its task is called.
            undo: Whether it is given up if whoever gave it is cancelled.
            lasts: Whether it takes something away, which the stop of the robot does not
                interrupt; any other ends there by a `StoppingError`.
        """
        await Budget.spend(VERB_COST)
        if self._asleep:
            raise StoppingError(self.name, "not started yet: enter the robot first")
        if self._waiting >= LIMIT:
            self.turned_away += 1
            raise BusyError(self.name, "number of waiting commands", LIMIT)
        self._waiting += 1
        try:
            await self._begins.wait()
            await self._turn.acquire()
        finally:
            self._waiting -= 1
        # The robot may have been stopped meanwhile.
        if self.is_closed:
            self._turn.release()
            raise self._stopping()
        me = asyncio.current_task()
        assert me is not None
        before = me.cancelling()
        task = self._work = spawn(asyncio.get_running_loop(), work(), name=name)
        self._undoes[task] = undo
        if lasts:
            self._lasting.add(task)
        task.add_done_callback(self._done)
        try:
            return await asyncio.shield(task)
        except asyncio.CancelledError:
            if task.cancelled() and me.cancelling() == before:  # the robot stopped
                raise self._stopping() from None
            if self._undoes.get(task):
                task.cancel()
                await asyncio.wait({task})
            raise

    def no_return(self) -> None:
        """The work that runs can no longer be undone: it is finished in any case."""
        me = asyncio.current_task()
        if me in self._undoes:
            self._undoes[me] = False
            self._lasting.add(me)

    def changed(self) -> None:
        """The work that runs has changed the table: the next command may begin."""
        self._end_turn_of(asyncio.current_task())

    def _stopping(self) -> StoppingError:
        return StoppingError(self.name, self.phase.value)

    def _done(self, task: asyncio.Task[Any]) -> None:
        del self._undoes[task]
        self._lasting.discard(task)
        look_at(task)
        if self._work is task:
            self._end_turn_of(task)

    def _end_turn_of(self, task: asyncio.Task[Any] | None) -> None:
        if self._work is not None and self._work is task:
            self._work = None
            self._turn.release()

    def wake(self) -> None:
        """The robot starts: let commands wait from now on."""
        self._asleep = False

    def initialized(self) -> None:
        """The configuration list is deployed: take commands from now on."""
        if self._phase is SupervisorPhase.INITIALIZING:
            self._phase = SupervisorPhase.WAIT_REQUEST
            self._begins.set()

    @property
    def is_closed(self) -> bool:
        """Whether the robot stops: nothing new may come."""
        return self._phase is SupervisorPhase.STOPPED

    def refuse(self) -> None:
        """Refuse every further command, and give up those that can be given up."""
        if self._phase is SupervisorPhase.STOPPED:
            return
        self._phase = SupervisorPhase.STOPPED
        self._begins.set()
        self._end_turn_of(self._work)  # whoever waits hears of it at once
        for task in set(self._undoes) - self._lasting:
            task.cancel()

    async def close(self) -> None:
        """Refuse every further command, and wait for those that were given up."""
        self.refuse()
        if given_up := set(self._undoes) - self._lasting:
            await asyncio.wait(given_up)

    def left(self, until: float) -> list[Coroutine[Any, Any, None]]:
        """Return what waits for the commands that are left, if there are any."""
        return [self._finish(until)] if self._undoes else []

    async def _finish(self, until: float) -> None:
        left = max(0.0, until - asyncio.get_running_loop().time())
        if self._undoes:
            await asyncio.wait(set(self._undoes), timeout=left)
        for task in self._undoes:
            task.cancel()
