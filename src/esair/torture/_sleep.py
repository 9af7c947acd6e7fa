"""Code that sleeps: it takes virtual time."""

from __future__ import annotations

import asyncio
import contextlib
import threading
import time
from collections.abc import Iterator
from typing import Any

from esair.testing import VirtualLoop


@contextlib.contextmanager
def virtual_sleep(loop: VirtualLoop) -> Iterator[None]:
    """Have `time.sleep` take virtual time: of all of them in the loop, else of one thread."""
    real = time.sleep
    home = threading.current_thread()

    def sleep(seconds: float) -> None:
        current = threading.current_thread()
        if current is home and asyncio._get_running_loop() is loop:  # noqa: SLF001
            loop.advance(max(0.0, seconds))
        elif current.name.startswith("esair-"):
            loop.wait_in_thread(seconds)
        else:
            real(seconds)

    patched: Any = sleep
    time.sleep = patched
    try:
        yield
    finally:
        time.sleep = real
