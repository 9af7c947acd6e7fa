"""The portal between a plain behavior's thread and the event loop."""

from __future__ import annotations

import asyncio
import concurrent.futures
import contextvars
import threading
from collections.abc import Callable, Coroutine
from typing import Any, TypeVar

from esair.exceptions import BehaviorRemovedError
from esair.loop._door import Door
from esair.loop._futures import look_at, raisable, settle
from esair.loop._ownership import Owner, spawn

T = TypeVar("T")


class Portal:
    """Runs a plain function in its own thread, and its calls in the loop.

    The thread calls `call`, which waits there while the coroutine runs in the
    loop. Once the portal is closed every call raises `BehaviorRemovedError`, so a
    function that still runs learns of its end at its next call.
    """

    def __init__(self, name: str, owner: Owner) -> None:
        self.name = name
        self._owner = owner
        self.loop: asyncio.AbstractEventLoop = asyncio.get_running_loop()
        self._door = Door.of(self.loop)
        self.closed: bool = False
        self._calls: set[asyncio.Task[Any]] = set()
        self._home = threading.current_thread()

    async def run(self, function: Callable[[], object]) -> None:
        """Run a function in a new daemon thread and wait for its end.

        If the waiting task is cancelled the portal is closed and the end is
        awaited; cancel again not to wait for it.
        """
        loop = self.loop
        owner = self._owner
        ended: asyncio.Future[None] = loop.create_future()

        def finished(error: BaseException | None) -> None:
            owner.threads = tuple(t for t in owner.threads if t is not thread)
            failed = None if error is None else raisable(error, "the behavior")
            settle(ended, None, failed)

        go: concurrent.futures.Future[int] = concurrent.futures.Future()

        def work() -> None:
            error: BaseException | None = None
            portal.set(self)
            _work.number = go.result()
            try:
                function()
            except BaseException as raised:  # contained, as in a task
                error = raised
            try:
                self._door.post(_work.number, ("thread", self.name), finished, error)
            except RuntimeError:  # the loop is closed: nobody waits any more
                return

        context = contextvars.copy_context()
        thread = threading.Thread(
            target=context.run, args=(work,), name=f"esair-{self.name}", daemon=True
        )
        thread.start()
        self._door.give_out(go.set_result, thread)
        owner.threads = (*owner.threads, thread)
        try:
            await asyncio.shield(ended)
        except asyncio.CancelledError:
            self.close()
            try:
                await asyncio.shield(ended)
            except asyncio.CancelledError:
                ended.add_done_callback(look_at)
                raise
            except BehaviorRemovedError:
                pass
            raise

    def call(
        self,
        function: Callable[..., Coroutine[Any, Any, T]],
        *args: Any,
        **options: Any,
    ) -> T:
        """Run a coroutine function in the loop and wait for it, in the thread."""
        if threading.current_thread() is self._home:
            raise RuntimeError(
                f"{self.name}: a call that waits, in the event loop: its run is a "
                "plain function, so its other methods must be plain functions too"
            )
        mine = portal.get(None)
        outcome: concurrent.futures.Future[T] = concurrent.futures.Future()
        context = contextvars.copy_context()  # what the thread does it for
        counted = getattr(_work, "number", 0)
        thread = threading.current_thread()

        def go_on(settle: Callable[[Any], None], what: Any) -> None:
            def begin(work: int) -> None:
                next_work[0] = work
                settle(what)

            if counted:
                self._door.give_out(begin, thread)
            else:  # a thread that the door knows nothing of
                settle(what)

        next_work = [0]

        def done(task: asyncio.Task[T]) -> None:
            self._calls.discard(task)
            if task.cancelled():
                go_on(outcome.set_exception, BehaviorRemovedError(self.name))
            elif (error := task.exception()) is not None:
                go_on(outcome.set_exception, error)
            else:
                go_on(outcome.set_result, task.result())

        def begin() -> None:
            # Of a thread that outlived its own run, mine is closed.
            if self.closed or (mine is not None and mine.closed):
                go_on(outcome.set_exception, BehaviorRemovedError(self.name))
                return
            try:
                coroutine = function(*args, **options)
            except BaseException as error:  # such as an argument that it does not have
                go_on(outcome.set_exception, error)
                return
            task = spawn(
                self.loop,
                coroutine,
                name=f"{self.name} call",
                owner=self._owner,
                context=context,
            )
            self._calls.add(task)
            task.add_done_callback(done)

        try:
            self._door.post(counted, ("thread", self.name), begin)
        except RuntimeError:  # the loop is closed
            raise BehaviorRemovedError(self.name) from None
        try:
            return outcome.result()
        finally:
            if counted:
                _work.number = next_work[0]

    def close(self) -> None:
        """Refuse every further call, and cancel those that run."""
        self.closed = True
        for call in tuple(self._calls):
            call.cancel()


portal: contextvars.ContextVar[Portal] = contextvars.ContextVar("esair_portal")
"""The portal of the thread that runs, if it is the thread of a plain behavior."""

_work = threading.local()
"""Its number is that of the work which the door has given to the thread that runs."""
