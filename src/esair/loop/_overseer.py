"""The overseer: one thread beside all event loops, for what a stuck loop cannot see.

It says who holds a loop, while it is held (`StallWatch`), and makes sure that something
ends (`Ending`): the loop is told, freed, and at last left. `run_and_end` runs a loop, and
ends it whatever is left in it.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import math
import os
import select
import selectors
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Coroutine, Iterable
from types import FrameType
from typing import Any

import anyio

from esair.abc import Component
from esair.loop._of_loop import OfLoop
from esair.loop._ownership import current_owner

JOIN = 1.0  # how long the last one who leaves waits for the thread, in seconds
LONGEST = 86_400.0  # how long it waits at a time, in seconds: the system takes 24 days


Look = Callable[[float], float]
"""Looks at something; returns the moment of the next look, on the monotonic clock."""


class Overseer:
    """A daemon thread that runs while anybody wants something watched.

    It also reads the bytes that a signal writes to `wake_fd`, which the interpreter
    does at once, whatever the program is doing.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._looks: tuple[Look, ...] = ()
        self._thread: threading.Thread | None = None
        self._read_fd = -1
        self.wake_fd = -1  # where a byte wakes the thread; 0 means nothing but that
        self.on_bytes: Callable[[bytes], None] = lambda _data: None
        """Called with what else was written there, in whatever thread has read it."""

    def join(self, look: Look) -> None:
        with self._lock:
            self._looks = (*self._looks, look)
            if self._thread is None:
                self._read_fd, self.wake_fd = os.pipe()
                os.set_blocking(self._read_fd, False)
                os.set_blocking(self.wake_fd, False)
                self._thread = threading.Thread(
                    target=self._work, name="esair-overseer", daemon=True
                )
                self._thread.start()
        self.wake()

    def leave(self, look: Look) -> None:
        """Look at something no more; the last one ends the thread."""
        with self._lock:
            left = list(self._looks)
            with contextlib.suppress(ValueError):  # a fork of the robot has none
                left.remove(look)
            self._looks = tuple(left)
            thread = self._thread
            if left or thread is None or thread is threading.current_thread():
                return
            self._thread = None
            self.wake()
            thread.join(JOIN)
            for fd in (self._read_fd, self.wake_fd):
                os.close(fd)
            self._read_fd = self.wake_fd = -1

    @property
    def thread_id(self) -> int | None:
        """The thread as the kernel numbers it; None if nothing is watched."""
        thread = self._thread
        return None if thread is None else thread.native_id

    def wake(self) -> None:
        """Have the thread look at once."""
        with contextlib.suppress(OSError):  # full, then it is awake; or closed
            os.write(self.wake_fd, b"\0")

    def drain(self) -> None:
        """Take the bytes that have come, in any thread; each is taken once."""
        try:
            data = os.read(self._read_fd, 4096).replace(b"\0", b"")
        except OSError:
            return
        if data:
            self.on_bytes(data)

    def forget(self) -> None:
        """Forget everything: this is a forked child, which has no such thread."""
        self.__init__()  # type: ignore[misc]

    def _work(self) -> None:
        poll = select.poll()
        poll.register(self._read_fd, select.POLLIN)
        me = threading.current_thread()
        while self._thread is me:
            now = time.monotonic()
            due = min((look(now) for look in self._looks), default=math.inf)
            pause = max(0.0, due - time.monotonic())
            poll.poll(math.ceil(min(pause, LONGEST) * 1e3))
            self.drain()


overseer = Overseer()  # the one of this process


_log = logging.getLogger("esair")


class StallWatch(OfLoop):
    """Asks a loop again and again, from a thread, whether it still turns.

    Code that holds it longer than allowed is named in the log with its stack, while
    it still holds it. One for each loop; the strictest of its robots counts.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._thread = threading.get_ident()
        self._limits: list[float] = []
        self._asked: float | None = None
        self._said = False

    def start(self, limit: float) -> None:
        """Watch for turns that take longer than a limit, in seconds."""
        self._thread = threading.get_ident()
        self._limits.append(limit)
        if len(self._limits) == 1:
            overseer.join(self.look)
        else:
            overseer.wake()  # a stricter limit begins now

    def stop(self, limit: float) -> None:
        self._limits.remove(limit)
        if not self._limits:
            overseer.leave(self.look)
            self._asked = None

    def look(self, now: float) -> float:
        """Ask the loop, or say that it does not answer; called by the overseer."""
        limit = min(self._limits, default=math.inf)
        if self._asked is None:
            self._asked = now
            with contextlib.suppress(RuntimeError):  # the loop is closed
                self._loop.call_soon_threadsafe(self._answer)
        elif not self._said and now - self._asked >= limit:
            self._said = True
            frame = sys._current_frames().get(self._thread)  # noqa: SLF001 - the only way to see it
            if frame is not None:
                _log.log(*describe_holder(frame), limit)
        return now + limit / 2

    def _answer(self) -> None:
        self._asked = None
        self._said = False


def describe_holder(frame: FrameType) -> tuple[int, str]:
    """Name the component whose code a thread executes, the line, and its stack."""
    if frame.f_code.co_filename == selectors.__file__:
        return logging.INFO, "the computer is busy: no turn for more than %g s"
    name, where = "the program", ""
    each: FrameType | None = frame
    while each is not None:
        owner = each.f_locals.get("self")
        if isinstance(owner, Component):
            with contextlib.suppress(Exception):  # a user's name may be anything
                name = str(owner.name)
                where = f" ({each.f_code.co_filename}:{each.f_lineno})"
            break
        each = each.f_back
    stack = "".join(traceback.format_stack(frame))
    text = f"{name}{where}:\n{stack}".replace("%", "%%")
    return logging.WARNING, f"the event loop is held for more than %g s by {text}"


PATIENCE = 0.25  # how long a loop may take to hear that it should end, in seconds

KICK = 0.02
"""How often code that holds a loop which should end is interrupted, in seconds."""

_ALWAYS = 25
"""From this kick on code is interrupted even inside of what it calls of the loop."""

_INSIDE = ("esair.", "asyncio.", "selectors", "anyio.")

_LOOPS = {"asyncio.base_events", "asyncio.runners", "esair.loop._overseer"}

_LIBRARIES = (
    "<frozen ",
    os.path.dirname(os.__file__),
    os.path.dirname(os.path.dirname(anyio.__file__)),
)
"""Where code lies that holds a loop only for who has called it."""

_KICK_SIGNAL = getattr(signal, "SIGURG", None)  # ignored unless somebody wants it
_TIMER_SIGNAL = getattr(signal, "SIGALRM", None)


class LoopHeldError(Exception):
    """Raised in code that holds the event loop of a robot that has to stop."""


class Ending:
    """Watches that an event loop hears that it should end, and that it does.

    A loop that does not hear is held by some code: that code is interrupted, as
    Ctrl-C would do it, so that every actuator can still be told its safe command.
    """

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        hear: Callable[[], None] | None = None,
        *,
        patience: float = math.inf,
        is_done: Callable[[], bool] = lambda: True,
    ) -> None:
        self._loop = loop
        self._hear = hear
        self._is_done = is_done  # until then the loop may be held once more
        self._patience = patience
        self._thread = threading.get_ident()
        self._reason = self._asked = math.inf
        self._limit = math.inf
        self._code = 1
        self._told = False
        self._kicks = 0
        self._spared_until = -math.inf
        self.heard: bool = False  # whether the loop has heard of it

    def start(self) -> None:
        overseer.join(self.look)

    def stop(self) -> None:
        overseer.leave(self.look)

    def because(self, moment: float, code: int = 1) -> None:
        """Take note of a reason to end; the earliest counts."""
        if moment < self._reason:
            self._reason, self._asked, self._code = moment, moment, code
            self._limit = moment + self._patience
        overseer.wake()

    def tell(self) -> None:
        """Tell the loop that there is a reason to end, once; in any thread."""
        if not self._told:
            self._told = True
            with contextlib.suppress(RuntimeError):  # the loop is closed
                self._loop.call_soon_threadsafe(self._acknowledge)

    @property
    def held(self) -> bool:
        """Whether some code keeps the loop from hearing that it should end."""
        return self._told and not self.heard

    def is_spared(self, now: float) -> bool:
        """Tell whether what was interrupted may still be on its way to the end."""
        return now < self._spared_until

    def interrupted(self, now: float) -> None:
        """Code was interrupted: what it does to end has its own time to do so."""
        self._kicks = 0
        self._spared_until = now + PATIENCE

    @property
    def forced(self) -> bool:
        """Whether that code was spared often enough."""
        return self._kicks >= _ALWAYS

    def look(self, now: float) -> float:
        """Do what is due; called by the overseer."""
        if now >= self._limit:
            leave_at_once(self._code, "it did not end in time")
        if now < self._reason:
            return min(self._reason, self._limit)
        if self.heard and not self._is_done():
            self._told, self.heard, self._asked = False, False, now
        self.tell()
        if self.heard:
            return self._limit
        if now - self._asked >= PATIENCE:
            self._kicks += 1
            kick(self._thread)
        return now + KICK

    def _acknowledge(self) -> None:
        self.heard = True
        hear, self._hear = self._hear, None
        if hear is not None:
            hear()


def kick(thread: int) -> None:
    """Interrupt the main thread, whatever it waits for; see `Kicks`."""
    if _KICK_SIGNAL is not None and thread == threading.main_thread().ident:
        signal.pthread_kill(thread, _KICK_SIGNAL)


class Kicks:
    """The signals that interrupt the main thread, where nobody else uses them."""

    def __init__(self, kicked: Callable[[int, FrameType | None], None]) -> None:
        self._kicked = kicked
        self._mine: list[int] = []

    def start(self) -> None:
        for number in (_KICK_SIGNAL, _TIMER_SIGNAL):
            if number is not None and signal.getsignal(number) is signal.SIG_DFL:
                signal.signal(number, self._kicked)
                self._mine.append(number)

    def stop(self) -> None:
        self.disarm()
        for number in self._mine:
            signal.signal(number, signal.SIG_DFL)
        self._mine.clear()

    def arm(self) -> None:
        """Have the kernel kick from soon on: no other thread may get to run."""
        if _TIMER_SIGNAL in self._mine:
            signal.setitimer(signal.ITIMER_REAL, PATIENCE, KICK)

    def disarm(self) -> None:
        if _TIMER_SIGNAL in self._mine:
            signal.setitimer(signal.ITIMER_REAL, 0.0)


def break_out(frame: FrameType | None, *, forced: bool) -> None:
    """Raise in the code that holds the loop, unless it is the loop's own."""
    if asyncio._get_running_loop() is None:  # noqa: SLF001 - public, but for its name
        return  # nobody holds it: it has ended, or is being ended
    if not _is_of_a_user(frame, forced=forced):
        return
    if current_owner() is not None:
        raise asyncio.CancelledError("it holds the event loop, and the robot stops")
    raise LoopHeldError("it holds the event loop, and the robot stops")


def _is_of_a_user(frame: FrameType | None, *, forced: bool) -> bool:
    """Whether it is a user's code, or a library that this has called."""
    while frame is not None:
        module = str(frame.f_globals.get("__name__", ""))
        inside = module.startswith(_INSIDE)
        if module in _LOOPS or (inside and not forced):
            return False
        if not inside and not frame.f_code.co_filename.startswith(_LIBRARIES):
            return True
        frame = frame.f_back
    return False


def leave_at_once(code: int, why: str) -> None:
    """End the process now; say why, if that does not take long."""
    frame = sys._current_frames().get(threading.main_thread().ident or 0)  # noqa: SLF001 - the only way to see it
    where = "" if frame is None else "".join(traceback.format_stack(frame)[-3:])

    def say() -> None:
        os.write(
            2, f"esair: the process is ended: {why}; it was here:\n{where}".encode()
        )

    saying = threading.Thread(target=say, daemon=True)  # nobody may read it
    saying.start()
    saying.join(0.1)
    os._exit(code)


TASKS_PATIENCE = 0.3
"""How long the end of a loop waits for tasks that are left in it, in seconds."""

THREADS_PATIENCE = 0.1
"""How long the end of the process waits for threads that are about to end, in seconds."""


def run_and_end(
    work: Coroutine[Any, Any, None],
    loop_factory: Callable[[], asyncio.AbstractEventLoop] | None,
) -> None:
    """Do what `asyncio.run` does, but do not wait for ever for tasks and threads."""
    loop = asyncio.new_event_loop() if loop_factory is None else loop_factory()
    asyncio.set_event_loop(loop)
    try:
        loop.run_until_complete(loop.create_task(work))
    finally:
        try:
            _end_tasks(loop)
        finally:
            asyncio.set_event_loop(None)
            loop.close()  # threads of run_in_executor are not waited for


def _end_tasks(loop: asyncio.AbstractEventLoop) -> None:
    left = asyncio.all_tasks(loop)
    for task in left:
        task.cancel()
    if left:
        loop.run_until_complete(asyncio.wait(left, timeout=TASKS_PATIENCE))
    leave_behind([task for task in left if not task.done()])
    for task in left:
        if task.done() and not task.cancelled() and (error := task.exception()):
            _log.warning("%s: it ended with %r", task.get_name(), error)
    generators = loop.create_task(loop.shutdown_asyncgens())
    loop.run_until_complete(asyncio.wait({generators}, timeout=TASKS_PATIENCE))


def leave_behind(tasks: Iterable[asyncio.Task[Any]]) -> None:
    """Have nobody wait for tasks that would not end.

    Who ends an event loop cancels all of its tasks and waits for them, `asyncio.run` for
    ever: it must not find these.
    """
    names = []
    for task in tasks:
        names.append(task.get_name())
        _keep_for_ever(task)
        asyncio._unregister_task(task)  # noqa: SLF001 - documented for other kinds of tasks
    if names:
        _log.warning("left behind, they would not end: %s", ", ".join(sorted(names)))


def _keep_for_ever(task: asyncio.Task[Any]) -> None:
    """Never let a task be collected, not even at the interpreter's end.

    Its coroutine would be closed then, which runs its code once more; without a loop
    each await of it raises, and what swallows that in a loop does not end.
    """
    import ctypes  # only when a task would not end

    ctypes.pythonapi.Py_IncRef(ctypes.py_object(task))


def threads_that_keep_the_process(before: set[threading.Thread]) -> list[str]:
    """Name new threads for whose end the interpreter waits at its own.

    Those that have nothing more to do are given the moment that they need to end.
    """
    new = [
        thread
        for thread in threading.enumerate()
        if thread not in before and not thread.daemon
    ]
    until = time.monotonic() + THREADS_PATIENCE
    for thread in new:
        thread.join(max(0.0, until - time.monotonic()))
    return sorted(thread.name for thread in new if thread.is_alive())
