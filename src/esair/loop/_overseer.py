"""The overseer: one thread beside all event loops, for what a stuck loop cannot see."""

from __future__ import annotations

import contextlib
import math
import os
import select
import threading
import time
from collections.abc import Callable
from typing import Protocol

JOIN = 1.0  # how long the last one who leaves waits for the thread, in seconds


class Sentinel(Protocol):
    """Something that the overseer looks at now and then."""

    def look(self, now: float) -> float:
        """Look; return the moment of the next look, on the monotonic clock."""


class Overseer:
    """A daemon thread that runs while anybody wants something watched.

    It also reads the bytes that a signal writes to `wake_fd`, which the interpreter
    does at once, whatever the program is doing.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._sentinels: tuple[Sentinel, ...] = ()
        self._thread: threading.Thread | None = None
        self._read_fd = -1
        self.wake_fd = -1  # where a byte wakes the thread; 0 means nothing but that
        self.on_bytes: Callable[[bytes], None] = lambda _data: None
        """Called with what else was written there, in whatever thread has read it."""

    def join(self, sentinel: Sentinel) -> None:
        with self._lock:
            self._sentinels = (*self._sentinels, sentinel)
            if self._thread is None:
                self._read_fd, self.wake_fd = os.pipe()
                os.set_blocking(self._read_fd, False)
                os.set_blocking(self.wake_fd, False)
                self._thread = threading.Thread(
                    target=self._work, name="esair-overseer", daemon=True
                )
                self._thread.start()
        self.wake()

    def leave(self, sentinel: Sentinel) -> None:
        """Look at something no more; the last one ends the thread."""
        with self._lock:
            left = tuple(each for each in self._sentinels if each is not sentinel)
            self._sentinels = left
            thread = self._thread
            if left or thread is None or thread is threading.current_thread():
                return
            self._thread = None
            self.wake()
            thread.join(JOIN)
            for fd in (self._read_fd, self.wake_fd):
                os.close(fd)
            self._read_fd = self.wake_fd = -1

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
            due = min((each.look(now) for each in self._sentinels), default=math.inf)
            pause = max(0.0, due - time.monotonic())
            poll.poll(None if pause == math.inf else math.ceil(pause * 1e3))
            self.drain()


overseer = Overseer()  # the one of this process
