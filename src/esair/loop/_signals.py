"""Signals that end a robot in order: SIGINT, SIGTERM, SIGHUP."""

from __future__ import annotations

import asyncio
import os
import signal
import threading
from collections.abc import Callable

ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class SignalWatch:
    """Calls a function at the first signal, another at the second, exits at the third.

    It takes over only signals that would kill the program without any clean-up, and
    only in the main thread.

    Args:
        on_first: Told the number of the first signal.
        on_second: Told when somebody becomes impatient.
    """

    def __init__(
        self, on_first: Callable[[int], None], on_second: Callable[[], None]
    ) -> None:
        self._on_first = on_first
        self._on_second = on_second
        self._count = 0
        self._loop: asyncio.AbstractEventLoop | None = None
        self._watched: list[int] = []

    def start(self, *, interrupts: bool) -> None:
        """Begin to watch.

        Args:
            interrupts: Whether to watch SIGINT too, which `asyncio.run` handles by
                itself.
        """
        if threading.current_thread() is not threading.main_thread():
            return
        loop = self._loop = asyncio.get_running_loop()
        for number in ENDING:
            handler = signal.getsignal(number)
            mine = interrupts if number == signal.SIGINT else handler is signal.SIG_DFL
            if mine:
                try:
                    loop.add_signal_handler(number, self._hear, number)
                except (NotImplementedError, RuntimeError):
                    return
                self._watched.append(number)

    def stop(self) -> None:
        """Give the signals back."""
        for number in self._watched:
            assert self._loop is not None
            self._loop.remove_signal_handler(number)
        self._watched.clear()

    def _hear(self, number: int) -> None:
        self._count += 1
        if self._count == 1:
            self._on_first(number)
        elif self._count == 2:
            self._on_second()
        else:
            os._exit(128 + number)
