"""One clock for everything, on every event loop."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import time
import weakref
from collections.abc import Callable

import pytest
import uvloop

from esair.loop import Deadlines, Scheduler, TurnLoop, clock_of
from esair.testing import VirtualLoop

LOOPS = pytest.mark.parametrize(
    "make", [asyncio.new_event_loop, uvloop.new_event_loop], ids=["asyncio", "uvloop"]
)
Make = Callable[[], asyncio.AbstractEventLoop]


@LOOPS
@pytest.mark.real_clock
def test_it_goes_on_while_the_loop_does_not(make: Make) -> None:
    """A reading that comes while a step computes has the right time."""

    async def main() -> float:
        clock = clock_of(asyncio.get_running_loop())
        begin = clock()
        time.sleep(0.01)  # noqa: ASYNC251 - the loop stands still meanwhile
        return clock() - begin

    with asyncio.Runner(loop_factory=make) as runner:
        assert 0.0099 < runner.run(main()) < 5.0


@LOOPS
@pytest.mark.real_clock
def test_no_step_comes_early(make: Make) -> None:
    """Not by more than 0.05 ms, whatever the timers of the loop are."""
    early: list[float] = []

    async def main() -> None:
        def step(_now: float) -> None:
            group = job.group
            assert group is not None
            early.append(group.moment / 1e9 - time.monotonic())

        job = Scheduler.of(asyncio.get_running_loop()).every(0.005, step)
        await asyncio.sleep(0.3)
        job.stop()

    with asyncio.Runner(loop_factory=make) as runner:
        runner.run(main())
    assert len(early) > 5
    assert max(early) <= 5e-5


@pytest.mark.parametrize("kind", [Scheduler, Deadlines])
def test_what_belongs_to_a_loop_goes_with_it(kind) -> None:
    """A program that makes loop after loop keeps none of them."""
    loop = VirtualLoop()
    mine = kind.of(loop)
    assert kind.of(loop) is mine
    loop.close()

    gone = weakref.ref(loop)
    del loop, mine
    gc.collect()

    assert gone() is None


def test_the_moment_of_a_timer_is_a_number() -> None:
    """It can be compared with any other, also with an equal one."""
    with contextlib.closing(TurnLoop()) as loop:
        timer = loop.call_at(5.0, print)
        assert not timer.when() < 5.0
        assert timer.when() < 6.0
        assert timer.when() < loop.call_at(5.0, print).when()
