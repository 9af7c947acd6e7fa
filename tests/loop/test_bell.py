"""The bell: a thread wakes the loop, and nothing is left of that."""

import asyncio
import contextlib
import gc
import os
import threading
from typing import Any

import pytest

from esair.loop._door import Bell

pytestmark = pytest.mark.real_clock


class Heard:
    """What a bell needs of the turns of a loop, and tells that it was heard."""

    virtual = False

    def __init__(self, loop: asyncio.AbstractEventLoop | None = None) -> None:
        self.loop = loop or asyncio.get_running_loop()
        self.heard = asyncio.Event()

    def come(self) -> None:
        self.heard.set()

    def ring(self) -> None:
        self.loop.call_soon_threadsafe(self.come)


def bell_of(turn: Any) -> Bell:
    return Bell(turn)


def descriptors() -> int:
    gc.collect()  # what other tests have left
    found = 0
    for number in os.listdir("/proc/self/fd"):
        with contextlib.suppress(OSError):  # that of the list itself
            found += "eventfd" in os.readlink(f"/proc/self/fd/{number}")
    return found


async def rung_in_thread(bell: Bell, heard: asyncio.Event) -> None:
    thread = threading.Thread(target=bell.ring)
    thread.start()
    await asyncio.wait_for(heard.wait(), 10)
    thread.join()


@pytest.mark.parametrize("held", [True, False])
async def test_a_thread_wakes_the_loop(held) -> None:
    """Whether or not there is a descriptor for it."""
    turn: Any = Heard()
    heard, bell = turn.heard, Bell(turn)
    if held:
        bell.hold()
    for _ in range(3):
        await rung_in_thread(bell, heard)
        heard.clear()
    if held:
        bell.let_go()


async def test_a_bell_without_a_descriptor_wakes_the_loop(monkeypatch) -> None:
    """The process may have as many as it can have."""

    def none_left(*_args):
        raise OSError(24, "too many open files")

    monkeypatch.setattr(os, "eventfd", none_left)
    turn: Any = Heard()
    heard, bell = turn.heard, Bell(turn)
    bell.hold()
    await rung_in_thread(bell, heard)
    bell.let_go()


async def test_what_was_rung_before_it_was_let_go_is_heard() -> None:
    """A thread hands over its last result and ends."""
    turn: Any = Heard()
    heard, bell = turn.heard, Bell(turn)
    bell.hold()
    bell.ring()
    bell.let_go()
    await asyncio.wait_for(heard.wait(), 10)


@pytest.mark.long
async def test_the_last_holder_takes_the_descriptor_with_it() -> None:
    """One descriptor for all, as long as somebody holds it."""
    before = descriptors()
    bell = bell_of(Heard())
    bell.hold()
    bell.hold()
    assert descriptors() == before + 1
    for left in (1, 0):
        bell.let_go()
        assert descriptors() == before + left


@pytest.mark.long
def test_a_loop_that_is_closed_while_it_is_held_leaves_no_descriptor() -> None:
    """Nobody has closed an executor, or it is closed later."""
    before = descriptors()

    async def held() -> Bell:
        bell = bell_of(Heard())
        bell.hold()
        assert descriptors() == before + 1
        return bell

    asyncio.run(held())
    assert descriptors() == before
    late = asyncio.run(held())
    late.let_go()
    assert descriptors() == before


def test_a_bell_of_a_loop_that_is_closed_says_so() -> None:
    """Who hands something over learns that nobody takes it."""
    loop = asyncio.new_event_loop()
    bell = bell_of(Heard(loop))
    bell.hold()
    loop.close()
    with pytest.raises(RuntimeError, match="closed"):
        bell.ring()
