"""What the end of a run finds in the process, and what it waits for."""

from __future__ import annotations

import threading

import pytest

from esair.loop import threads_that_keep_the_process

pytestmark = [pytest.mark.promise("ROB-6"), pytest.mark.real_clock]


def test_a_thread_that_is_about_to_end_keeps_no_process() -> None:
    """As those of `asyncio.to_thread`, which hear that the loop was closed."""
    before = set(threading.enumerate())
    asked = threading.Event()
    ending = threading.Thread(target=lambda: asked.wait(0.02), name="ending")
    ending.start()
    assert threads_that_keep_the_process(before) == []
    assert not ending.is_alive()


def test_a_thread_that_goes_on_is_named() -> None:
    """Its end is not waited for; a daemon's never is."""
    before = set(threading.enumerate())
    asked = threading.Event()
    threads = [
        threading.Thread(target=asked.wait, args=(60.0,), name=name, daemon=daemon)
        for name, daemon in (("stuck", False), ("daemon", True))
    ]
    for thread in threads:
        thread.start()
    try:
        assert threads_that_keep_the_process(before) == ["stuck"]
    finally:
        asked.set()
        for thread in threads:
            thread.join()
