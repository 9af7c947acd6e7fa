"""How the code of a behavior or reaction is made to crash, hang, or go mad."""

from __future__ import annotations

import asyncio
import functools
import inspect
import types
from collections.abc import Coroutine, Generator
from typing import Any

from esair.actions import Reaction
from esair.loop import portal
from esair.torture._gate import injected
from esair.torture._values import has_number, is_good, wrong


class Lever:
    """What one action is made to do."""

    was_deaf: bool
    deaf: bool
    mad: float

    hangs: float

    def __init__(self, action: Any, loop: Any) -> None:
        self.action = action
        # Until when it does not go on, its commands are no good
        self.hangs = self.mad = -1.0
        self.slow: list[tuple[float, float]] = []  # Until when each step takes how long
        # Deaf: it does not hear its cancellation meanwhile, as no thread does
        self.deaf = self.was_deaf = False
        self.undecided = False  # Whether the last step of a reaction gave nothing good
        self.how = "nan"
        self._loop = loop
        self._error: str | None = None
        self._in_thread = False
        self._tasks: set[asyncio.Task[Any]] = set()
        own = vars(action)
        if isinstance(action, Reaction):
            own["react"] = self._stepping(action.react)
        elif inspect.iscoroutinefunction(action.run):
            own["run"] = self._running(action.run)
        else:
            own["run"] = self._running_in_thread(action.run)

    @property
    def is_running(self) -> bool:
        """Whether its ``run`` has not ended, a plain one aside."""
        return any(not task.done() for task in self._tasks)

    def hang(self, seconds: float, *, deaf: bool) -> None:
        """Do not go on for a while."""
        self.hangs = self._loop.time() + seconds
        self.deaf = deaf or self._in_thread
        self.was_deaf |= self.deaf

    def crash(self, error: str) -> None:
        """Raise an error from its code: at once, or in the next step."""
        self._error = error
        for task in tuple(self._tasks):
            task.cancel()

    def _stepping(self, react: Any) -> Any:
        @functools.wraps(react)
        def step(*args: Any, **readings: Any) -> Any:
            error, self._error = self._error, None
            now = self._loop.time()
            if self.slow and now < self.slow[-1][0]:
                self._loop.advance(self.slow[-1][1])
            self.undecided = True
            if error is not None:
                raise injected(error)
            command = react(*args, **readings)
            if now < self.mad and command is not None and has_number(command):
                command = wrong(command, self.how)
            self.undecided = not is_good(command)
            return command

        return step

    def _running(self, run: Any) -> Any:
        @functools.wraps(run)
        async def running() -> None:
            task = asyncio.current_task()
            assert task is not None
            self._tasks.add(task)
            self._error = None
            try:
                await self._driven(run())
            except asyncio.CancelledError:
                error, self._error = self._error, None
                if error is None:
                    raise
                task.uncancel()
                raise injected(error) from None
            finally:
                self._tasks.discard(task)

        return running

    def _running_in_thread(self, run: Any) -> Any:
        self._in_thread = True

        @functools.wraps(run)
        def running() -> None:
            mine: Any = portal.get()
            call = mine.call
            self._error = None

            def obeying(*args: Any, **options: Any) -> Any:
                try:
                    return call(*args, **options)
                finally:
                    self._obey()

            mine.call = obeying
            run()

        return running

    def _obey(self) -> None:
        """Hang, then crash, if it was told to; in the thread."""
        hangs = self.hangs - self._loop.time()
        if hangs > 0.0:
            self._loop.wait_in_thread(hangs)
        error, self._error = self._error, None
        if error is not None:
            raise injected(error)

    @types.coroutine
    def _driven(self, run: Coroutine[Any, Any, None]) -> Generator[Any, Any, None]:
        """Go on with a coroutine, but not while it hangs."""
        go_on: Any = run.send
        value: Any = None
        while True:
            try:
                awaited = go_on(value)
            except StopIteration:
                return
            try:
                value, go_on = (yield awaited), run.send
            except BaseException as error:
                value, go_on = error, run.throw
            while self._loop.time() < self.hangs and not isinstance(
                value, GeneratorExit
            ):
                waits = self._loop.create_future()
                timer = self._loop.call_at(self.hangs, _done, waits)
                try:
                    yield from waits
                except asyncio.CancelledError as error:
                    if not self.deaf:
                        value, go_on = error, run.throw
                        break
                finally:
                    timer.cancel()


def _done(future: asyncio.Future[None]) -> None:
    if not future.done():
        future.set_result(None)
