"""The alarm: a thread wakes the loop, and nothing is left of that."""

import asyncio
import gc
import os
import threading

import pytest

from esair.loop import Door, TurnLoop, turn_of

pytestmark = pytest.mark.real_clock


def none_left(*_args):
    raise OSError(24, "too many open files")


def descriptors() -> int:
    gc.collect()  # what other tests have left
    return len(os.listdir("/proc/self/fd"))


async def woken_by_threads() -> None:
    door = Door.of(asyncio.get_running_loop())
    for _ in range(3):
        heard = asyncio.Event()
        thread = threading.Thread(target=door.tell, args=(("test",), heard.set))
        thread.start()
        await asyncio.wait_for(heard.wait(), 10)
        thread.join()


@pytest.mark.parametrize("has_descriptor", [True, False])
def test_a_thread_wakes_the_loop(monkeypatch, has_descriptor) -> None:
    """Also if the process has as many descriptors as it can have."""
    before = descriptors()
    if not has_descriptor:
        monkeypatch.setattr(os, "eventfd", none_left)
    with asyncio.Runner(loop_factory=TurnLoop) as runner:
        runner.run(woken_by_threads())
    assert descriptors() == before


def test_who_rings_for_a_loop_that_is_closed_is_told_so() -> None:
    """Who hands something over learns that nobody takes it."""
    loop = TurnLoop()
    turn = turn_of(loop)
    loop.close()
    with pytest.raises(RuntimeError, match="closed"):
        turn.ring()
