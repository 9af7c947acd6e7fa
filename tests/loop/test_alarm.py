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


def test_who_is_forgotten_by_another_is_not_heard() -> None:
    """Also where both have something to say in one pass of the loop."""
    told: list[str] = []

    async def main() -> None:
        loop = asyncio.get_running_loop()
        turn = turn_of(loop)
        ends = [os.pipe(), os.pipe()]
        files = [read for read, _ in ends]

        def hear(one: int, other: int) -> None:
            os.read(files[one], 1)
            turn.forget(files[other])
            told.append("heard")

        turn.listen(files[0], lambda: hear(0, 1))
        turn.listen(files[1], lambda: hear(1, 0))
        for _, write in ends:
            os.write(write, b"1")
        for _ in range(5):
            await asyncio.sleep(0.001)
        for each in files:
            turn.forget(each)
        for fd in (fd for pair in ends for fd in pair):
            os.close(fd)

    with asyncio.Runner(loop_factory=TurnLoop) as runner:
        runner.run(main())
    assert told == ["heard"]


def test_what_cannot_be_listened_to_is_not_kept() -> None:
    """An error, and nobody is called for a file with its number later."""
    with asyncio.Runner(loop_factory=TurnLoop) as runner:
        turn = turn_of(runner.get_loop())
        read, write = os.pipe()
        os.close(read)
        with pytest.raises(OSError, match="Bad file"):
            turn.listen(read, lambda: None)
        turn.forget(read)
        os.close(write)
