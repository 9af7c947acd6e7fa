"""Signals that end a robot in order: SIGINT, SIGTERM, SIGHUP; and who changes them."""

from __future__ import annotations

import asyncio
import os
import signal
import sys
import threading

# Each component that is added is watched; the public getsignal makes an enum of a
# handler, or else prints it, task and all, into an error that nobody sees.
from _signal import getsignal  # type: ignore[import-not-found]  # noqa: PLC2701
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


class ProcessWatch:
    """Notices what is changed of that which belongs to the whole process."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._before = self._look()

    def changes(self) -> list[str]:
        """Name what is not as it was when this was made."""
        now = self._look()
        return [what for what, value in self._before.items() if now[what] != value]

    def _look(self) -> dict[str, object]:
        # Asyncio keeps its own handlers apart; without the attribute they go unseen.
        handlers = getattr(self._loop, "_signal_handlers", {})
        found: dict[str, object] = {
            f"the handler of {number.name}": (
                getsignal(number),
                handlers.get(number),
            )
            for number in ENDING
        }
        found["the task factory of the event loop"] = self._loop.get_task_factory()
        if sys.version_info < (3, 14):  # from then on the policy is deprecated
            found["the event loop policy"] = asyncio.get_event_loop_policy()
        return found
