"""All deadlines of a loop stand behind one timer."""

from __future__ import annotations

import asyncio
import gc
import weakref

import pytest
from hypothesis import given
from hypothesis import strategies as st

from esair.loop import Deadlines
from esair.testing._clock import VirtualLoop

pytestmark = pytest.mark.virtual_clock


async def test_each_comes_at_its_moment_in_order() -> None:
    """Whatever order they were asked for in; equal moments keep that order."""
    loop = asyncio.get_running_loop()
    deadlines = Deadlines.of(loop)
    begin, called = loop.time(), []

    for number, seconds in enumerate([0.3, 0.1, 0.2, 0.1]):
        deadlines.after(seconds, lambda n: called.append((n, loop.time())), number)
    await asyncio.sleep(1.0)

    assert [number for number, _ in called] == [1, 3, 2, 0]
    assert [at - begin for _, at in called] == pytest.approx([0.1, 0.1, 0.2, 0.3])


async def test_one_that_is_cancelled_never_comes() -> None:
    """Not even if another one of the same moment cancels it."""
    deadlines = Deadlines.of(asyncio.get_running_loop())
    called: list[str] = []
    deadlines.after(0.1, called.append, "early").cancel()
    deadlines.after(0.2, lambda: last.cancel())
    last = deadlines.after(0.2, called.append, "last")

    await asyncio.sleep(1.0)
    last.cancel()  # once more does no harm

    assert called == []


async def test_one_for_many_waits_comes_for_the_last_one() -> None:
    """It is started for each; also for one that begins as it is due."""
    loop = asyncio.get_running_loop()
    deadlines = Deadlines.of(loop)
    begin, called = loop.time(), []
    for_all = deadlines.idle(lambda: called.append(loop.time() - begin))
    await asyncio.sleep(1.0)
    assert not called

    for_all.start(begin + 1.1)
    for_all.cancel()
    deadlines.after(0.2, lambda: for_all.start(begin + 1.3))
    for_all.start(begin + 1.2)
    await asyncio.sleep(1.0)
    for_all.start(begin + 2.5)
    await asyncio.sleep(1.0)

    assert called == pytest.approx([1.3, 2.5])


async def test_one_that_raises_holds_no_other_up() -> None:
    """The loop is told; the next one comes."""
    loop = asyncio.get_running_loop()
    told: list[dict[str, object]] = []
    loop.set_exception_handler(lambda _, context: told.append(context))
    deadlines = Deadlines.of(loop)
    called: list[str] = []
    deadlines.after(0.1, lambda: 1 / 0)
    deadlines.after(0.1, called.append, "same moment")
    deadlines.after(0.2, called.append, "later")

    await asyncio.sleep(1.0)

    assert called == ["same moment", "later"]
    assert isinstance(told[0]["exception"], ZeroDivisionError)


async def test_a_thousand_waits_that_end_in_time_leave_nothing() -> None:
    """They need no timer of the loop, and their places do not pile up."""
    loop = asyncio.get_running_loop()
    deadlines = Deadlines.of(loop)
    timers = len(loop._scheduled)
    for _ in range(1000):
        deadlines.after(1.0, print).cancel()
    idle = deadlines.idle(print)
    for number in range(1000):
        idle.start(loop.time() + 1.0 + number)
        idle.cancel()

    assert deadlines.waiting == []
    assert len(deadlines._heap) < 100
    assert len(loop._scheduled) == timers


async def test_what_is_cancelled_is_let_go() -> None:
    """Long before its moment."""

    class Big:
        def call(self) -> None:
            raise AssertionError

    big = Big()
    gone = weakref.ref(big)
    Deadlines.of(asyncio.get_running_loop()).after(3600.0, big.call).cancel()
    del big
    gc.collect()

    assert gone() is None


async def test_a_timer_that_nobody_waits_for_makes_no_task() -> None:
    """Nothing of a robot that has stopped is heard of again; a later one comes."""
    loop = asyncio.get_running_loop()
    deadlines = Deadlines.of(loop)
    called: list[str] = []
    deadlines.after(0.5, called.append, "never").cancel()
    seen: set[asyncio.Task[None] | None] = set()
    loop.call_at(loop.time() + 0.5, lambda: seen.update(asyncio.all_tasks()))
    await asyncio.sleep(1.0)

    assert seen == {asyncio.current_task()}
    deadlines.after(0.5, called.append, "later")
    await asyncio.sleep(1.0)
    assert called == ["later"]


@pytest.mark.real_clock
@pytest.mark.parametrize("loop_factory", [asyncio.new_event_loop, VirtualLoop])
def test_no_loop_is_kept_by_its_deadlines(loop_factory) -> None:
    """Not even one that was closed before the timer had looked."""

    async def main() -> weakref.ref[asyncio.AbstractEventLoop]:
        loop = asyncio.get_running_loop()
        Deadlines.of(loop).after(3600.0, loop.stop).cancel()
        return weakref.ref(loop)

    with asyncio.Runner(loop_factory=loop_factory) as runner:
        loop = runner.run(main())
    del runner
    gc.collect()

    assert loop() is None


STEPS = st.lists(
    st.tuples(
        st.sampled_from(["after", "cancel", "pass"]),
        st.integers(0, 5),
        st.floats(0.0, 3.0),
    ),
    max_size=40,
)


@given(steps=STEPS)
def test_any_order_of_asking_and_cancelling(steps) -> None:
    """What was not cancelled comes once, and never early."""

    async def run() -> None:
        loop = asyncio.get_running_loop()
        deadlines = Deadlines.of(loop)
        asked: list[tuple[float, object]] = []
        cancelled: set[int] = set()
        came: dict[int, float] = {}
        for what, which, seconds in steps:
            if what == "after":
                number = len(asked)

                def call(number: int = number) -> None:
                    assert number not in came
                    came[number] = loop.time()

                when = loop.time() + seconds
                asked.append((when, deadlines.after(seconds, call)))
            elif what == "cancel" and which < len(asked):
                asked[which][1].cancel()
                if which not in came:
                    cancelled.add(which)
            else:
                await asyncio.sleep(seconds)
        await asyncio.sleep(10.0)
        assert came.keys() == set(range(len(asked))) - cancelled
        assert all(came[n] >= asked[n][0] - 1e-9 for n in came)

    with asyncio.Runner(loop_factory=VirtualLoop) as runner:
        runner.run(run())


async def test_who_had_no_chance_to_run_has_not_timed_out() -> None:
    """What passed while the loop was held up is put off, once; no other is."""
    loop: VirtualLoop = asyncio.get_running_loop()  # type: ignore[assignment]
    deadlines = Deadlines.of(loop)
    begin, called = loop.time(), []
    deadlines.after(0.1, lambda: called.append(loop.time() - begin))
    deadlines.after(0.1, called.append, "cancelled").cancel()
    in_time = loop.create_future()
    loop.call_later(2.05, in_time.set_result, None)
    waits = asyncio.create_task(deadlines.wait(in_time, 0.5))
    await asyncio.sleep(0.0)

    loop.advance(2.0)
    deadlines.after(0.01, lambda: called.append(loop.time() - begin))
    await waits
    assert in_time.done()
    await asyncio.sleep(1.0)

    assert called == pytest.approx([2.01, 2.1], abs=1e-3)


async def test_a_new_wait_takes_nobody_the_chance_that_he_was_given() -> None:
    """They share a deadline, and the new one would be over before."""
    loop: VirtualLoop = asyncio.get_running_loop()  # type: ignore[assignment]
    begin, called = loop.time(), []
    shared = Deadlines.of(loop).idle(lambda: called.append(loop.time() - begin))
    shared.start_by(begin + 0.1)
    await asyncio.sleep(0.0)
    loop.advance(2.0)
    await asyncio.sleep(0.01)
    shared.start_by(begin + 2.03)
    await asyncio.sleep(1.0)
    shared.start_by(begin + 4.0)
    shared.start_by(begin + 3.5)
    await asyncio.sleep(1.0)

    assert called == pytest.approx([2.1, 3.5], abs=1e-3)


async def test_a_clock_may_be_later_than_timers_count() -> None:
    """A deadline comes at its moment there too, and none at all holds nothing up."""
    loop = asyncio.get_running_loop()
    deadlines = Deadlines.of(loop)
    called: list[str] = []
    await asyncio.sleep(1e10)
    deadlines.idle(called.append, "never").start(float("inf"))
    deadlines.after(1.0, called.append, "later")

    await asyncio.sleep(0.5)
    assert called == []
    await asyncio.sleep(1.0)
    assert called == ["later"]
