"""On the virtual clock a robot gives the same events again, in any process."""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from esair.loop import Door, Executor

ROOT = Path(__file__).parents[2]


def played(seeds: range, hash_seed: int) -> list[str]:
    """Return what the actuators of the robots of some seeds were told."""
    run = subprocess.run(
        [sys.executable, "-m", "tests.turn.worlds", *map(str, seeds)],
        cwd=ROOT,
        env={**os.environ, "PYTHONHASHSEED": str(hash_seed)},
        capture_output=True,
        text=True,
        timeout=600,
        check=True,
    )
    return run.stdout.splitlines()


@pytest.mark.long
@pytest.mark.promise("TURN-6")
def test_any_robot_repeats_in_another_process(request: pytest.FixtureRequest) -> None:
    """With threads, plain drivers and random timing, and with another hash seed."""
    seeds = range(60 if request.config.getoption("--esair-soak") else 5)
    once, again = (played(seeds, hash_seed) for hash_seed in (1, 4711))

    assert len(once) == len(seeds)
    assert sum(map(len, once)) > 400 * len(seeds)  # they are worth it
    assert [i for i in seeds if once[i] != again[i]] == []


@pytest.mark.virtual_clock
@pytest.mark.promise("TURN-1", "TURN-6")
async def test_results_of_threads_take_effect_in_the_order_of_their_calls() -> None:
    """The call that was made first comes first, though its thread takes longest."""
    order: list[int] = []
    executors = [Executor(f"bus{i}") for i in range(4)]

    async def call(number: int) -> None:
        pause = 0.02 * (4 - number)
        await executors[number].call(time.sleep, pause, timeout=5.0)
        order.append(number)

    await asyncio.gather(*map(call, range(4)))
    for executor in executors:
        executor.close()

    assert order == [0, 1, 2, 3]


@pytest.mark.virtual_clock
@pytest.mark.promise("TURN-6")
async def test_no_thread_works_while_the_loop_does() -> None:
    """What a thread sees of the loop is the same each time: the end of a turn."""
    executor = Executor("bus")
    seen: list[int] = []
    count = 0
    call = asyncio.ensure_future(executor.call(lambda: seen.append(count), timeout=5.0))
    for _ in range(50):
        await asyncio.sleep(0)
        count += 1
    await call
    executor.close()

    assert seen == [50]


@pytest.mark.real_clock
@pytest.mark.promise("TURN-1")
def test_entries_of_a_real_loop_take_effect_as_they_came_in() -> None:
    """They are numbered when they come in, from however many threads."""
    taken: list[int] = []

    async def main() -> Door:
        loop = asyncio.get_running_loop()
        door = Door.of(loop)

        def come(number: int) -> None:
            for _ in range(50):
                door.tell((str(number),), lambda: taken.append(number))

        threads = [threading.Thread(target=come, args=(i,)) for i in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            await asyncio.to_thread(thread.join)
        door.tell(("bad",), lambda: 1 / 0)
        door.tell(("last",), lambda: taken.append(-1))
        await asyncio.sleep(0.01)
        return door

    door = asyncio.run(main())

    assert len(taken) == 201
    assert taken[-1] == -1
    assert door.number == 202
