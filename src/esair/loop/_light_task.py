"""A coroutine that is driven by what it waits for, from its first step on; and futures.

Most driver calls end in their first step: a frame is handed to a socket, and that is
all. A task would cost several times the call itself, and make it wait for a turn of the
loop. What waits after all is gone on with by the very future that it waits for.
"""

from __future__ import annotations

import asyncio
import contextlib
import contextvars
import enum
import sys
import types
from asyncio import tasks
from asyncio.tasks import (
    _enter_task,  # noqa: PLC2701 - documented, for third-party tasks
    _leave_task,  # noqa: PLC2701 - documented, for third-party tasks
)
from collections.abc import Callable, Coroutine, Generator, Iterable, Iterator
from typing import Any, Final

from esair.exceptions import describe
from esair.loop._of_loop import OfLoop


def wake(*futures: asyncio.Future[None] | None) -> None:
    """Let those go on who still wait for some futures."""
    for future in futures:
        if future is not None and not future.done():
            future.set_result(None)


def wake_one(futures: Iterable[asyncio.Future[None]]) -> None:
    """Let the first go on who still waits."""
    for future in futures:
        if not future.done():
            future.set_result(None)
            return


def fail(future: asyncio.Future[Any] | None, error: BaseException) -> None:
    """Give who still waits an error; who waits may be cancelled in this moment."""
    if future is not None and not future.done():
        future.set_exception(error)
        future.exception()


def settle(
    future: asyncio.Future[Any], value: Any, error: BaseException | None
) -> None:
    """Give who still waits a value, an error if there is one, or a cancellation."""
    if future.done():
        return
    if error is None:
        future.set_result(value)
    elif isinstance(error, asyncio.CancelledError):
        future.cancel()
    else:
        future.set_exception(error)


def raisable(error: BaseException, who: str = "it") -> Exception:
    """Make an error that may be raised in any task of what somebody has raised."""
    if isinstance(error, Exception) and not isinstance(error, StopIteration):
        return error  # a future takes everything but a StopIteration
    wrapped = RuntimeError(f"{who} raised {describe(error)}")
    wrapped.__cause__ = error
    return wrapped


def ignore(*_: object) -> None:
    """Take no notice: what a hook is that nobody has set."""


def look_at(ended: asyncio.Future[Any]) -> None:
    """Look at an error whose cause has nobody any more who would."""
    if not ended.cancelled():
        ended.exception()


def has_come(future: asyncio.Future[Any]) -> bool:
    """Tell whether what was waited for is there: a cancellation came too late."""
    return future.done() and not future.cancelled() and future.exception() is None


class _Mark(enum.Enum):
    WAITS = enum.auto()
    ENDED = enum.auto()


WAITS: Final = _Mark.WAITS
"""What `LightTask.begin` returns for a coroutine that has not ended yet."""

ENDED: Final = _Mark.ENDED
"""What comes out of a light task when a coroutine has ended, in place of a wait."""


class _CurrentTasks(dict[asyncio.AbstractEventLoop, Any]):
    """The current task of each loop, where Python keeps it in no dictionary."""

    def get(self, loop: asyncio.AbstractEventLoop, _default: Any = None, /) -> Any:
        return asyncio.current_task(loop)

    def __setitem__(self, loop: asyncio.AbstractEventLoop, task: Any) -> None:
        tasks._swap_current_task(loop, task)  # type: ignore[attr-defined] # noqa: SLF001 - documented for third-party tasks

    def __delitem__(self, loop: asyncio.AbstractEventLoop) -> None:
        self[loop] = None


current_tasks: dict[asyncio.AbstractEventLoop, Any] = (
    tasks._current_tasks  # type: ignore[attr-defined] # noqa: SLF001 - half of a call's cost by the functions
    if sys.version_info < (3, 14)
    else _CurrentTasks()
)


current_task_of: Callable[[asyncio.AbstractEventLoop], Any] = current_tasks.get
"""Returns the current task of a loop; found anew at each call it would take twice as long."""


@types.coroutine
def _run_all(light: LightTask) -> Generator[Any, Any, None]:
    """Run what is sent in, one after the other, and keep what each returns.

    A coroutine that another one awaits ends without a StopIteration, which costs more
    than most calls of a driver.
    """
    coroutine = yield ENDED
    while True:
        light.value = yield from coroutine
        coroutine = yield ENDED


COMMAND = 1
"""How urgent it is what an actuator waits for: each second turn, if others wait, too."""

SAFE, OPENING = 16, 1
"""How much more urgent it is when it is made safe, or opened: before all others."""


class Urgency:
    """How urgent is what one device waits for on its bus: the highest level goes first."""

    __slots__ = ("level",)

    def __init__(self, level: int = 0) -> None:
        self.level: int = level

    @contextlib.contextmanager
    def raised(self, by: int) -> Iterator[None]:
        """Be more urgent meanwhile, also what waits already."""
        self.level += by
        try:
            yield
        finally:
            self.level -= by


_USUAL = Urgency()

urgency: contextvars.ContextVar[Urgency] = contextvars.ContextVar(
    "esair_urgency", default=_USUAL
)
"""That of the device whose driver runs, with all that it has started."""


class Turns:
    """Says who has the next turn: the most urgent, else who came first.

    After a command somebody else has a turn, so that commands alone do not fill a bus.
    """

    __slots__ = ("_floor",)

    def __init__(self) -> None:
        self._floor = 0

    def rank(self, waits: Any) -> int:
        """Sort what waits by this, least first; equals keep their order."""
        level: int = waits.urgency.level
        return -level if level > self._floor else 0

    @staticmethod
    def has_room(waiting: int, limit: int, urgent: Urgency) -> bool:
        """Tell whether one more may wait.

        What makes safe, or opens an actuator, may where as many again wait already.
        """
        return waiting < (2 * limit if urgent.level > COMMAND else limit)

    def taken(self, waits: Any) -> None:
        """Take note who has the turn."""
        self._floor = COMMAND if waits.urgency.level == COMMAND else 0


class Caller:
    """Whose coroutines a light task runs.

    Attributes:
        task_name: What their task is named.
        context: What their first steps run in; one that goes on keeps it.
    """

    __slots__ = ("_own", "context", "task_name")

    def __init__(self, task_name: str, urgent: Urgency = _USUAL) -> None:
        self.task_name: str = task_name
        self._own = contextvars.Context()
        self._own.run(urgency.set, urgent)
        self.context: contextvars.Context = self.fresh()

    def fresh(self) -> contextvars.Context:
        """Return a context of nobody's, but that it knows how urgent this is."""
        return self._own.copy()


class LightTask(asyncio.Future[None]):
    """Runs one coroutine after the other, each from its first step on.

    Inside, it is what `asyncio.current_task` returns, with the methods of a task that
    `asyncio.timeout`, `asyncio.TaskGroup` and anyio need: the third-party task of
    asyncio's page on extending it. Whoever began it is never waited with: a coroutine
    that swallows its cancellation holds nobody up. It has a context of its own, so that
    what it starts belongs to nobody.
    """

    # Slots: what lies in the dictionary that this class had without them is sought in
    # the classes first, which takes three times as long.
    __slots__ = (
        "_context",
        "_coroutine",
        "_ended",
        "_fut_waiter",
        "_must_cancel",
        "_name",
        "_num_cancels_requested",
        "_running_on",
        "_runs",
        "caller",
        "lined",
        "send",
        "value",
    )

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        name: str = "",
        context: contextvars.Context | None = None,
    ) -> None:
        super().__init__(loop=loop)
        self._running_on = loop
        self.caller: Caller | None = None
        """Whose coroutine it runs; asked for what it is only when somebody wants to know."""
        self.lined: float = 0.0
        """How long its coroutine has waited for turns on a bus, in seconds."""
        self._name = name
        self._context: contextvars.Context | None = context
        self._coroutine: Coroutine[Any, Any, Any] | None = None
        self._ended: Callable[[Any, BaseException | None], None] | None = None
        self._runs = runs = _run_all(self)
        runs.send(None)
        self.send: Callable[[Any], Any] = runs.send
        """Runs a coroutine to its end or its first wait; `ENDED` says that it ended."""
        self.value: Any = None  # what the last coroutine has returned
        # These three have the names that anyio looks at.
        self._fut_waiter: asyncio.Future[Any] | None = None
        self._must_cancel = False
        self._num_cancels_requested = 0

    def begin(self, coroutine: Coroutine[Any, Any, Any]) -> Any:
        """Run a coroutine to its end or its first wait, now."""
        loop = self._running_on
        current = current_tasks
        caller = current_task_of(loop)
        current[loop] = self
        try:
            waits_for = self.get_context().run(self.send, coroutine)
        finally:
            if caller is None:
                del current[loop]
            else:
                current[loop] = caller
        if waits_for is ENDED:
            return self.value
        self.goes_on(coroutine, waits_for)
        return WAITS

    def goes_on(self, coroutine: Coroutine[Any, Any, Any], waits_for: Any) -> None:
        """Drive a coroutine whose first step has ended in a wait."""
        caller = self.caller
        if caller is not None:
            # Its own now; the next first step has another.
            self._context, caller.context = caller.context, caller.fresh()
        self._coroutine = coroutine
        self._wait_for(waits_for)

    def then(self, ended: Callable[[Any, BaseException | None], None]) -> None:
        """Say what gets the result or the error of the coroutine, in the loop."""
        self._ended = ended
        self.lined = 0.0

    # What a task has.

    def cancel(self, msg: Any | None = None) -> bool:
        """Throw a `CancelledError` into the coroutine; it may go on all the same."""
        if self.done() or FirstSteps.of(self._running_on).spare is self:
            return False  # it runs none, and the next one is another call's
        self._num_cancels_requested += 1
        if self._fut_waiter is not None and self._fut_waiter.cancel(msg):
            return True
        self._must_cancel = True
        self._cancel_message = msg
        return True

    def cancelling(self) -> int:
        """Tell how many cancellations are pending."""
        return self._num_cancels_requested

    def uncancel(self) -> int:
        """Take one cancellation back; tells how many are left."""
        if self._num_cancels_requested > 0:
            self._num_cancels_requested -= 1
            if self._num_cancels_requested == 0:
                self._must_cancel = False
        return self._num_cancels_requested

    def get_name(self) -> str:
        return self._name or (self.caller.task_name if self.caller else "")

    def set_name(self, value: object) -> None:
        self._name = str(value)

    def get_coro(self) -> Coroutine[Any, Any, Any] | None:
        """Return the coroutine; None while the first step runs."""
        return self._coroutine

    def get_context(self) -> contextvars.Context:
        if self._context is None:
            if self.caller is not None:
                return self.caller.context
            self._context = contextvars.Context()
        return self._context

    # Steps after the first one.

    def _step(self, error: BaseException | None = None) -> None:
        loop = self._running_on
        if self._must_cancel:
            self._must_cancel = False
            if not isinstance(error, asyncio.CancelledError):
                message = self._cancel_message
                error = asyncio.CancelledError(*(() if message is None else (message,)))
        self._fut_waiter = None
        end: tuple[Any, BaseException | None]
        _enter_task(loop, self)  # type: ignore[arg-type]
        try:
            waits_for = self.send(None) if error is None else self._runs.throw(error)
            end = (self.value, None)
        except BaseException as raised:  # contained: it is the coroutine's own
            waits_for = ENDED
            end = (None, raised)
        finally:
            _leave_task(loop, self)  # type: ignore[arg-type]
        if waits_for is not ENDED:
            self._wait_for(waits_for)
            return
        self._coroutine = None
        self._runs.close()  # the two refer to each other
        self.set_result(None)
        ended, self._ended = self._ended, None
        assert ended is not None
        ended(*end)

    def _wait_for(self, waits_for: Any) -> None:
        if waits_for is None:  # ``sleep(0)``
            self._running_on.call_soon(self._step, context=self._context)
        elif getattr(waits_for, "_asyncio_future_blocking", None):
            waits_for._asyncio_future_blocking = False  # noqa: SLF001 - the protocol of tasks
            waits_for.add_done_callback(self._wake_up, context=self._context)
            self._fut_waiter = waits_for
            if self._must_cancel and waits_for.cancel(self._cancel_message):
                self._must_cancel = False
        else:
            error = RuntimeError(
                f"{self.get_name()} waits for {waits_for!r:.80}, which is nothing of asyncio"
            )
            self._running_on.call_soon(self._step, error, context=self._context)

    def _wake_up(self, future: asyncio.Future[Any]) -> None:
        try:
            error = future.exception()
        except asyncio.CancelledError as cancelled:
            error = cancelled
        self._step(error)  # here: it is no part of handling a cancellation


class FirstSteps(OfLoop):
    """Begins coroutines, most of which end at once: all of a loop share a light task."""

    __slots__ = ("_loop", "spare")

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self.spare: LightTask = LightTask(loop)
        """Runs the next first step, if it has no caller now."""

    def begin(self, coroutine: Coroutine[Any, Any, Any], caller: Caller) -> Any:
        """Run a coroutine to its end or its first wait, now."""
        light = self.spare
        if light.caller is not None:
            # One begins another: each has a task and a context.
            light = LightTask(self._loop, caller.task_name, caller.fresh())
            return light if light.begin(coroutine) is WAITS else light.value
        light.caller = caller
        value: Any = WAITS
        try:
            value = light.begin(coroutine)
        finally:
            if value is WAITS or light.cancelling():
                self.spare = LightTask(self._loop)  # that one is used up
            else:
                light.caller = None
        return light if value is WAITS else value
