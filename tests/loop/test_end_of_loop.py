"""What the end of a run finds in the process, and what it waits for."""

from __future__ import annotations

import asyncio
import os
import signal
import threading
from collections.abc import AsyncGenerator
from typing import Any

import pytest

from esair.loop import run_and_end, threads_that_keep_the_process
from esair.loop._overseer import kick, leave_at_once
from esair.testing import VirtualLoop

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


def test_what_is_left_in_a_loop_ends_with_it(caplog: Any) -> None:
    """Its tasks are cancelled, and what they do about it is waited for, and told."""
    ended: list[str] = []
    kept: list[object] = []

    async def numbers() -> AsyncGenerator[int, None]:
        try:
            yield 1
        finally:
            ended.append("generator")

    async def waits(name: str) -> None:
        try:
            await asyncio.sleep(60.0)
        finally:
            await asyncio.sleep(0.1)
            ended.append(name)

    async def fails() -> None:
        try:
            await asyncio.sleep(60.0)
        finally:
            raise ValueError("broken")

    async def work() -> None:
        generator = numbers()
        kept.append(generator)
        await anext(generator)
        kept.extend(asyncio.create_task(waits(name)) for name in ("one", "other"))
        kept.append(asyncio.create_task(fails(), name="arm"))
        await asyncio.sleep(0.01)

    run_and_end(work(), VirtualLoop)
    assert sorted(ended) == ["generator", "one", "other"]
    (said,) = caplog.messages
    assert said == "arm: it ended with ValueError('broken')"


def test_what_would_not_end_is_left_behind(caplog: Any) -> None:
    """After 0.3 s, by its name: the end of the program waits for it no more."""
    loop = VirtualLoop()

    async def stays() -> None:
        while True:
            try:
                await asyncio.sleep(60.0)
            except asyncio.CancelledError:
                continue

    async def work() -> None:
        for name in ("b", "a"):
            asyncio.create_task(stays(), name=name)  # noqa: RUF006 - nobody keeps it
        await asyncio.sleep(1.0)
        raise KeyError("work")

    with pytest.raises(KeyError, match="work"):
        run_and_end(work(), lambda: loop)
    assert caplog.messages == ["left behind, they would not end: a, b"]
    assert loop.is_closed()
    assert loop.time() == pytest.approx(1.3)
    assert asyncio.all_tasks(loop) == set()


def test_who_leaves_at_once_says_where_the_program_was(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """With the code that it is left with; what nobody reads holds nothing up."""
    said: list[tuple[int, bytes]] = []
    left: list[int] = []
    monkeypatch.setattr(os, "_exit", left.append)
    monkeypatch.setattr(os, "write", lambda fd, text: said.append((fd, text)))
    leave_at_once(143, "a third signal came")
    ((fd, text),) = said
    assert (fd, left) == (2, [143])
    assert text.startswith(b"esair: the process is ended: a third signal came; it was")
    assert b"test_end_of_loop.py" in text


def test_only_the_main_thread_can_be_interrupted() -> None:
    """By a signal that nobody else uses."""
    came: list[int] = []
    before = signal.signal(signal.SIGURG, lambda number, _frame: came.append(number))
    other = threading.Thread(target=threading.Event().wait, args=(0.2,))
    other.start()
    try:
        kick(other.ident or 0)
        assert came == []
        kick(threading.get_ident())
        assert came == [signal.SIGURG]
    finally:
        signal.signal(signal.SIGURG, before)
        other.join()
