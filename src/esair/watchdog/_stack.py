"""Where this process writes down what it executes, when its watchdog asks."""

from __future__ import annotations

import faulthandler
import os
import signal
import threading

TELL_STACK = signal.SIGRTMAX  # The signal by which a watchdog asks


class StackFile:
    """A file in memory that gets the stack at each signal; one for the process.

    It is written by a signal handler in C, so also by code that never gives the
    interpreter back.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._users = 0
        self._file = -1

    def open(self) -> int:
        """Return its descriptor; it is there until as many have closed it."""
        with self._lock:
            if not self._users:
                self._file = os.memfd_create("esair-stack")
                faulthandler.register(TELL_STACK, self._file)
            self._users += 1
            return self._file

    def close(self) -> None:
        """Need it no more: the watchdog that was to read it has ended."""
        with self._lock:
            self._users -= 1
            if not self._users:
                faulthandler.unregister(TELL_STACK)
                os.close(self._file)


stack_file = StackFile()
