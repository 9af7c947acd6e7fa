"""When code takes real time, and the virtual clock would wait for it for ever."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from types import FrameType
from typing import Any

import anyio

import esair
from esair.loop import Door
from esair.testing import VirtualLoop

PATIENCE = 10.0
"""How long virtual time may stand still at most, in seconds of real time."""

_LIBRARIES = tuple(
    os.path.join(os.path.dirname(each), "")
    for each in (os.__file__, os.path.dirname(anyio.__file__), esair.__file__)
)
"""The folders of the code that is nobody's own: Python's, the packages', esair's."""


class HeldError(BaseException):
    """Code of the robot has held the loop, or its thread, in real time."""

    def __init__(self, component: str, text: str) -> None:
        super().__init__(text)
        self.component = component  # Whose code, as far as its file tells


class Patience:
    """Raises `HeldError` in what runs if virtual time stands, and stops the loop.

    It can do so in the main thread only. However busy the computer is, a story that goes
    on may go on.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self.lost: HeldError | None = None  # What has held it; None if nothing has
        self._loop = loop
        self._main = threading.current_thread() is threading.main_thread()
        self._before: Any = None
        self._seen = -1.0

    def __enter__(self) -> Patience:
        if self._main:
            self._before = signal.signal(signal.SIGALRM, self._tired)
            signal.setitimer(signal.ITIMER_REAL, PATIENCE, PATIENCE)
        return self

    def __exit__(self, *_: object) -> None:
        if self._main:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            signal.signal(signal.SIGALRM, self._before)

    def _tired(self, _number: int, frame: FrameType | None) -> None:
        before, self._seen = self._seen, self._loop.time()
        if before != self._seen:
            return
        # Whoever contains it does not contain the end of the loop.
        self.lost = _held_in(frame, PATIENCE)
        self._loop.stop()
        raise self.lost


def abandon(loop: asyncio.AbstractEventLoop) -> None:
    """Close what runs in a loop that will not go on."""
    for task in asyncio.all_tasks(loop):
        task._log_destroy_pending = False  # type: ignore[attr-defined]  # noqa: SLF001
        with contextlib.suppress(BaseException):
            asyncio._set_running_loop(loop)  # noqa: SLF001 - what is closed asks for it
            task.get_coro().close()
    asyncio._set_running_loop(None)  # noqa: SLF001 - as above


def _held_in(frame: FrameType | None, seconds: float) -> HeldError:
    """Find the user's code that holds, in the loop or in a thread of the robot."""
    running = sys._current_frames()  # noqa: SLF001 - there is no other way to see them
    threads = [each for each in threading.enumerate() if each.name.startswith("esair-")]
    for each in [frame, *(running.get(thread.ident or 0) for thread in threads)]:
        while each is not None:
            file = each.f_code.co_filename
            if not file.startswith(("<frozen ", *_LIBRARIES)):
                what = f"{each.f_code.co_qualname} at {file}:{each.f_lineno}"
                text = f"{what} does not end: {seconds:g} s of real time have passed"
                return HeldError(each.f_code.co_name, text)
            each = each.f_back
    return HeldError("robot", f"time stood still for {seconds:g} s of real time")


@contextlib.contextmanager
def virtual_sleep(loop: VirtualLoop) -> Iterator[None]:
    """Have `time.sleep` take virtual time: of all of them in the loop, else of one thread.

    That of a thread which has no work of the loop, as a recorder's, takes real time.
    """
    real, door = time.sleep, Door.of(loop)
    home = threading.current_thread()

    def sleep(seconds: float) -> None:
        current = threading.current_thread()
        if current is home and asyncio._get_running_loop() is loop:  # noqa: SLF001
            loop.advance(max(0.0, seconds))
        elif any(current is at_work for at_work, *_ in door.at_hand()):
            loop.wait_in_thread(seconds)
        else:
            real(seconds)

    patched: Any = sleep
    time.sleep = patched
    try:
        yield
    finally:
        time.sleep = real
