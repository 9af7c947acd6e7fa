"""Signals that end a robot in order: SIGINT, SIGTERM, SIGHUP; and who changes them.

They are counted outside of the event loops, so they work while one is stuck: the
interpreter writes a byte for each, which the overseer's thread reads, or, if no other
thread gets to run, the handler in the main thread.
"""

from __future__ import annotations

import asyncio
import atexit
import contextlib
import itertools
import math
import os
import signal
import sys
import threading
import time

# Each component that is added is watched; the public getsignal makes an enum of a
# handler, or else prints it, task and all, into an error that nobody sees.
from _signal import getsignal  # type: ignore[import-not-found]  # noqa: PLC2701
from collections.abc import Callable
from types import FrameType
from typing import Any, Self

from esair.loop._overseer import Ending, Kicks, break_out, leave_at_once, overseer

if sys.platform == "win32":
    raise ImportError("esair runs on Linux, not on Windows: use it in WSL")

ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

_FREE = (signal.SIG_DFL, signal.default_int_handler)
"""With these a signal ends the program, whatever its loop has still to do."""

LAST_WORD = 0.6  # how long the third signal waits at most for safe commands, in seconds


class SignalWatch:
    """Tells one robot of the signals that end it."""

    def __init__(
        self,
        on_first: Callable[[int], None],
        on_second: Callable[[], None],
        is_safe: Callable[[], bool] = lambda: True,
    ) -> None:
        self._on_first = on_first
        self._on_second = on_second
        self.is_safe = is_safe
        self.loop: asyncio.AbstractEventLoop | None = None
        self.ending: Ending | None = None
        self.last: Ending | None = None  # that of the whole process, if there is one
        self.host: asyncio.Task[Any] | None = None
        self.number: int | None = None  # the first signal that it was told of

    def start(self, *, interrupts: bool) -> bool:
        """Begin to watch; tells whether anybody in this process hears of signals.

        Only signals that would kill the program without any clean-up are taken over,
        and only in the main thread: Python lets no other one do so.
        """
        self.loop = asyncio.get_running_loop()
        self.host = asyncio.current_task()
        self.ending = Ending(self.loop, self._hear, is_done=self.is_safe)
        self.ending.start()
        return desk.join(self, interrupts=interrupts)

    def stop(self) -> None:
        """Give the signals back, if no other robot needs them."""
        if self.ending is not None:
            desk.leave(self)
            self.ending.stop()
            self.ending = None

    async def others_stopped(self, timeout: float) -> None:
        """Wait until the other robots of this loop have heard of a signal and stopped."""
        give_up = time.monotonic() + timeout
        while desk.others(self) and time.monotonic() < give_up:  # noqa: ASYNC110 - once, at the end
            await asyncio.sleep(0.005)

    def first(self, number: int) -> None:
        """A signal has come; in any thread."""
        self.number = number
        if self.ending is not None:
            self.ending.because(time.monotonic())
            self.ending.tell()
            if self.last is not None:
                self.last.because(time.monotonic(), 128 + number)

    def second(self) -> None:
        """Another one has come; in any thread."""
        if self.loop is not None:
            with contextlib.suppress(RuntimeError):  # the loop is closed
                self.loop.call_soon_threadsafe(self._on_second)

    def _hear(self) -> None:
        if self.number is not None:
            self._on_first(self.number)


class SignalDesk:
    """Owns the handlers of the signals for all robots of the process."""

    def __init__(self) -> None:
        self._lock = threading.Lock()  # robots in several threads begin and end at once
        self._watches: tuple[SignalWatch, ...] = ()
        self._before: dict[int, Any] = {}
        self._kicks = Kicks(self._kicked)
        self._wake_before = -1
        self._numbers = itertools.count(1)
        self._first = 0
        self._last_word = math.inf
        self._code = 1
        self._runner: Any = None  # asyncio's handler of Ctrl-C, if that is in charge
        self._interrupted = False  # whether it has heard of one

    def join(self, watch: SignalWatch, *, interrupts: bool) -> bool:
        with self._lock:
            if not (self._watches or self._before):
                overseer.join(self.look)
            self._watches = (*self._watches, watch)
        is_main = threading.current_thread() is threading.main_thread()
        if is_main:
            self._install(interrupts=interrupts)
        if self._first:  # one that starts while the others end
            watch.first(self._first)
        return is_main or bool(self._before)

    def leave(self, watch: SignalWatch) -> None:
        """Tell it no more; the last one puts everything back."""
        with self._lock:
            self._watches = tuple([e for e in self._watches if e is not watch])
            if self._watches:
                return
            self._numbers = itertools.count(1)
            self._first, self._last_word = 0, math.inf
            if threading.current_thread() is threading.main_thread():
                self._uninstall()
            if not self._before:  # else the main thread puts that back, at a signal
                overseer.leave(self.look)

    def leave_to(self, handler: Callable[[int, FrameType | None], None]) -> None:
        """Put this in the place of the handlers, not what was there before."""
        self._before = dict.fromkeys(self._before, handler)

    def others(self, watch: SignalWatch) -> bool:
        """Tell whether other robots of the same loop, by other tasks, still run."""
        return any(
            each.loop is watch.loop and each.host is not watch.host
            for each in self._watches
        )

    def look(self, now: float) -> float:
        """Leave at the third signal as soon as all is safe; called by the overseer."""
        if self._last_word == math.inf:
            return math.inf
        if now >= self._last_word or all(each.is_safe() for each in self._watches):
            leave_at_once(self._code, "a third signal came")
        return now + 0.01

    def forget(self) -> None:
        """This is a forked child: its signals, and its loops, are not the robots'."""
        told = "it is a fork of a robot's, and went on as that robot"
        for watch in self._watches:
            if watch.loop is not None:
                watch.loop.call_soon(leave_at_once, 1, told)
        if self._before:
            with contextlib.suppress(ValueError):
                signal.set_wakeup_fd(-1)
                for number, handler in self._before.items():
                    signal.signal(number, handler)
        self.__init__()  # type: ignore[misc]

    def _install(self, *, interrupts: bool) -> None:
        for number in ENDING:
            if number in self._before:
                continue
            handler: Any = signal.getsignal(number)
            free = handler in _FREE or isinstance(handler, _Again)
            is_interrupt = number == signal.SIGINT
            if is_interrupt and _is_of_a_runner(handler) and not interrupts:
                self._runner, self._interrupted, free = handler, False, True
            if free or (is_interrupt and interrupts):
                self._before[number] = handler
                signal.signal(number, self._handle)
        if self._before and overseer.on_bytes != self._count_all:
            overseer.on_bytes = self._count_all
            self._wake_before = signal.set_wakeup_fd(
                overseer.wake_fd, warn_on_full_buffer=False
            )
            self._kicks.start()

    def _uninstall(self) -> None:
        for number, handler in self._before.items():
            if signal.getsignal(number) == self._handle:
                if handler is self._runner and not _in_a_runner():
                    handler = signal.default_int_handler  # as the runner had put back
                signal.signal(number, handler)
        if self._before:
            current = signal.set_wakeup_fd(self._wake_before)
            if current != overseer.wake_fd:  # somebody has set another since
                with contextlib.suppress(ValueError, OSError):
                    signal.set_wakeup_fd(current)
            overseer.on_bytes = lambda _data: None
        self._kicks.stop()
        self._before.clear()
        self._runner = None
        self._wake_before = -1

    def _handle(self, number: int, frame: FrameType | None) -> None:
        """Count a signal in the main thread, unless the overseer has done so.

        Asyncio's runner hears of the first Ctrl-C alone: at the second it leaves its
        loop, and no stop that has begun goes on.
        """
        if not self._watches:  # the last one has ended in another thread
            self._uninstall()
            overseer.leave(self.look)
            signal.raise_signal(number)
            return
        mine = overseer.wake_fd
        if self._is_the_runners(number):
            if not self._interrupted:
                self._interrupted = True
                self._runner(number, frame)
                return
            self._count(number)
        elif (current := signal.set_wakeup_fd(mine, warn_on_full_buffer=False)) == mine:
            overseer.drain()
        else:  # somebody else hears the bytes
            signal.set_wakeup_fd(current, warn_on_full_buffer=False)
            self._count(number)
        self._kicks.arm()

    def _count_all(self, data: bytes) -> None:
        if self._wake_before >= 0:  # of a loop with handlers of its own
            with contextlib.suppress(OSError):
                os.write(self._wake_before, data)
        for number in data if self._watches else b"":
            if number in self._before and not self._is_the_runners(number):
                self._count(number)

    def _is_the_runners(self, number: int) -> bool:
        return number == signal.SIGINT and self._runner is not None

    def _count(self, number: int) -> None:
        count = next(self._numbers)
        if count == 1:
            self._first = number
            for watch in self._watches:
                watch.first(number)
        elif count == 2:
            for watch in self._watches:
                watch.second()
        elif self._last_word == math.inf:
            self._code = 128 + number
            self._last_word = time.monotonic() + LAST_WORD
            overseer.wake()

    def _kicked(self, _number: int, frame: FrameType | None) -> None:
        """Look, in the main thread, whether its code has to give the loop back."""
        endings = [ending for w in self._watches for ending in (w.ending, w.last)]
        held = [ending for ending in endings if ending is not None and ending.held]
        if not held:
            self._kicks.disarm()
        now = time.monotonic()
        due = [ending for ending in held if not ending.is_spared(now)]
        if due:
            try:
                break_out(frame, forced=any(ending.forced for ending in due))
            except BaseException:
                for ending in held:
                    ending.interrupted(time.monotonic())
                raise


desk = SignalDesk()  # the one of this process


class LateSignals:
    """Hears signals for a whole run, from before its loop is made until it is closed.

    One that comes when the robot has stopped finds all safe: it shortens nothing more,
    must not kill the process with another exit code, and is not lost either.
    """

    def __init__(self) -> None:
        self._watch = SignalWatch(lambda _number: None, lambda: None)

    def __enter__(self) -> Self:
        desk.join(self._watch, interrupts=True)
        return self

    def __exit__(self, *_: object) -> None:
        if self.number is not None:
            desk.leave_to(_Again(128 + self.number))
            atexit.register(_hear_no_more)
        desk.leave(self._watch)

    @property
    def number(self) -> int | None:
        return self._watch.number


class _Again:
    """The handler after a run that a signal has ended: one more means the same.

    The program ends with the code of the first one; what it does at its end is broken
    off, as by Ctrl-C.
    """

    def __init__(self, code: int) -> None:
        self._code = code

    def __call__(self, _number: int, _frame: FrameType | None) -> None:
        raise SystemExit(self._code)


def _is_of_a_runner(handler: Any) -> bool:
    owner = getattr(getattr(handler, "func", None), "__self__", None)
    return isinstance(owner, asyncio.Runner)


def _in_a_runner() -> bool:
    """Whether asyncio's runner still runs its program: its end closes what is left."""
    frame: FrameType | None = sys._getframe()  # noqa: SLF001 - public, but for its name
    while frame is not None and frame.f_code is not asyncio.Runner.run.__code__:
        frame = frame.f_back
    return frame is not None


def _hear_no_more() -> None:
    """The interpreter ends, and takes its handlers back: a signal would kill it."""
    for number in ENDING:
        if isinstance(signal.getsignal(number), _Again):
            signal.signal(number, signal.SIG_IGN)


def _in_a_forked_child() -> None:
    desk.forget()
    overseer.forget()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_in_a_forked_child)


class ProcessWatch:
    """Notices what is changed of that which belongs to the whole process."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._before = self._look()

    def changes(self) -> list[str]:
        """Name what is not as it was when this was made."""
        before, now = self._before, self._look()
        return [] if now == before else [w for w in before if now[w] != before[w]]

    def _look(self) -> dict[str, object]:
        # Asyncio keeps its own handlers apart; without the attribute they go unseen.
        handlers = getattr(self._loop, "_signal_handlers", {})
        found: dict[str, object] = {}
        for number in ENDING:
            is_now = getsignal(number), handlers.get(number)
            found[f"the handler of {number.name}"] = is_now
        found["the task factory of the event loop"] = self._loop.get_task_factory()
        if sys.version_info < (3, 14):  # from then on the policy is deprecated
            found["the event loop policy"] = asyncio.get_event_loop_policy()
        return found
