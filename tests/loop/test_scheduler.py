"""The scheduler calls every step when it is due, and what has to wait stays in its task."""

from __future__ import annotations

import asyncio
import functools
import itertools
import time
from typing import Any

import pytest

import esair
from esair.loop import Deadlines, Order, Scheduler, TurnLoop, ignore
from esair.testing import VirtualLoop

pytestmark = pytest.mark.virtual_clock


def clock() -> float:
    return asyncio.get_running_loop().time()


def scheduler() -> Scheduler:
    return Scheduler.of(asyncio.get_running_loop())


async def test_a_step_is_called_each_period_without_drift() -> None:
    """A thousand turns later the step is still on its grid."""
    calls: list[float] = []
    job = scheduler().every(0.1, lambda _now: calls.append(clock()))
    await asyncio.sleep(100.05)
    job.stop()
    await asyncio.sleep(1.0)

    assert len(calls) in {1000, 1001}
    assert calls[-1] - calls[0] == pytest.approx(0.1 * (len(calls) - 1))
    assert job.skipped == 0


@pytest.mark.promise("REA-3")
async def test_late_steps_are_counted_and_skipped() -> None:
    """After a second in which the computer was busy there is no burst."""
    calls: list[float] = []
    job = scheduler().every(0.1, lambda _now: calls.append(clock()))
    await asyncio.sleep(0.25)
    before = len(calls)
    loop: Any = asyncio.get_running_loop()
    assert isinstance(loop, VirtualLoop)
    loop.advance(1.0)
    await asyncio.sleep(0.05)

    assert len(calls) - before <= 2
    assert job.skipped in {9, 10}
    job.stop()


@pytest.mark.promise("ROB-3")
async def test_a_step_that_raises_does_not_stop_the_others(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """The error is logged, and the scheduler turns on."""
    calls: list[float] = []

    def bad(_now: float) -> None:
        raise RuntimeError("no")

    jobs = [scheduler().every(0.1, bad), scheduler().every(0.1, calls.append)]
    await asyncio.sleep(1.05)
    for job in jobs:
        job.stop()
    await asyncio.sleep(0)
    assert len(calls) >= 10
    assert "RuntimeError: no" in caplog.text


async def test_a_step_that_waits_holds_nobody_up() -> None:
    """The others keep their times while its rest goes on in its own task."""
    calls: list[float] = []
    tasks: list[Any] = []
    started: list[Any] = []

    async def rest() -> None:
        await asyncio.sleep(0.45)
        tasks.append(asyncio.current_task())

    def slow(_now: float) -> Any:
        started.append(asyncio.current_task())
        return rest() if len(started) == 1 else None

    jobs = [scheduler().every(0.1, slow), scheduler().every(0.1, calls.append)]
    await asyncio.sleep(1.05)
    for job in jobs:
        job.stop()
    await asyncio.sleep(0)
    assert len(calls) >= 10
    assert tasks == started[:1]


async def test_a_step_on_demand_is_called_once_for_many_demands() -> None:
    """Demands within one turn are one call."""
    calls: list[float] = []
    job = scheduler().on_demand(calls.append)
    for _ in range(5):
        job.soon()
    await asyncio.sleep(0.01)
    assert len(calls) == 1
    job.soon()
    job.stop()
    await asyncio.sleep(0.01)
    assert len(calls) == 1


async def test_a_shot_is_called_at_its_moment_unless_it_is_cancelled() -> None:
    """One call, neither early nor twice."""
    calls: list[float] = []
    loop = asyncio.get_running_loop()
    scheduler().at(loop.time() + 0.5, lambda _now: calls.append(clock()))
    other = scheduler().at(loop.time() + 0.2, lambda _now: calls.append(-1.0))
    scheduler().cancel(other)
    await asyncio.sleep(2.0)
    assert calls == [pytest.approx(0.5)]


async def test_every_ticks_at_once_and_then_on_its_grid() -> None:
    """The value of a tick is the time since the first one."""
    ticks: list[float] = []
    async for tick in esair.every(0.25):
        ticks.append(tick)
        if len(ticks) == 4:
            break
    assert ticks == [0.0, 0.25, 0.5, 0.75]


async def test_every_leaves_out_ticks_that_have_passed() -> None:
    """A slow body costs ticks, which are counted, and causes no burst."""
    times: list[float] = []
    every = esair.every(0.1)
    async for _ in every:
        times.append(clock())
        if len(times) == 2:
            await asyncio.sleep(0.55)
        if len(times) == 4:
            break
    assert every.late >= 4
    assert times[3] - times[2] <= 0.1 + 1e-9


@pytest.mark.fault("T03")
async def test_a_tick_that_comes_late_is_the_last_that_has_passed() -> None:
    """The loop stands still for ten periods in a wait: one tick, then the grid."""
    ticks: list[tuple[float, float]] = []

    loop: Any = asyncio.get_running_loop()
    loop.call_later(0.05, loop.advance, 1.0)
    async for tick in esair.every(0.1):
        ticks.append((clock(), tick))
        if len(ticks) == 4:
            break
    expected = [(0.0, 0.0), (1.05, 1.0), (1.1, 1.1), (1.2, 1.2)]
    assert ticks == [pytest.approx(each) for each in expected]


@pytest.mark.fault("T05")
async def test_what_is_due_when_no_timer_reaches_is_just_late() -> None:
    """An actuator that is held for ever, as good as, has no moment that overflows."""
    fired: list[float] = []
    one_shot = scheduler().at(1e300, fired.append)
    await asyncio.sleep(1.0)
    scheduler().cancel(one_shot)
    assert not fired


@pytest.mark.parametrize("period", [0, -1.0, float("nan"), float("inf"), True, "1"])
def test_every_takes_a_number_of_seconds(period: Any) -> None:
    """Anything else is refused before it starts."""
    with pytest.raises(esair.BadValueError, match="period"):
        esair.every(period)


def test_every_waits_without_a_loop_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """A plain loop outside of a robot waits for each tick; what passed is left out."""
    now, slept = 100.0, list[float]()

    def sleep(seconds: float) -> None:
        nonlocal now
        slept.append(seconds)
        now += seconds

    monkeypatch.setattr(time, "monotonic", lambda: now)
    monkeypatch.setattr(time, "sleep", sleep)
    every, ticks = esair.every(0.01), list[float]()
    for takes, tick in zip((0.004, 0.0, 0.035, 0.0), every, strict=False):
        ticks.append(tick)
        now += takes

    assert ticks == [pytest.approx(each) for each in (0.0, 0.01, 0.02, 0.05)]
    assert slept == [pytest.approx(each, abs=1e-9) for each in (0.0, 0.006, 0.01, 0.0)]
    assert every.late == 2


@pytest.mark.virtual_clock
@pytest.mark.fault("B09")
async def test_a_step_slower_than_its_period_starves_nobody() -> None:
    """Between two of its steps every other task gets its turn."""
    loop = asyncio.get_running_loop()
    assert isinstance(loop, VirtualLoop)
    turns_of_others = 0
    seen: list[int] = []

    def slow(_now: float) -> None:
        seen.append(turns_of_others)
        if len(seen) <= 50:
            loop.advance(0.03)

    job = scheduler().every(0.01, slow)
    while len(seen) <= 50:
        turns_of_others += 1
        await asyncio.sleep(0)
    job.stop()

    assert all(after > before for before, after in itertools.pairwise(seen[:50]))
    assert job.skipped >= 100


@pytest.mark.long
@pytest.mark.promise("TURN-3")
@pytest.mark.parametrize(
    "rates", [(10.0, 20.0), (30.0, 60.0), (0.1, 100.0), (3.0, 9.0)]
)
async def test_harmonic_rates_meet(rates: tuple[float, float]) -> None:
    """Each step of the slower one is at the nanosecond of one of the quicker one."""
    slow: list[float] = []
    quick: list[float] = []

    def noting(calls: list[float]) -> Any:
        return lambda _now: calls.append(clock())

    jobs = [
        scheduler().every(1.0 / rate, noting(calls))
        for rate, calls in zip(rates, (slow, quick), strict=True)
    ]
    await asyncio.sleep(12.0 / rates[0])
    for job in jobs:
        job.stop()
    await asyncio.sleep(0)

    assert len(slow) >= 12
    assert set(slow[:-1]) <= set(quick)


@pytest.mark.promise("TURN-2")
async def test_an_instant_has_one_order() -> None:
    """Polls, steps by their names, what they decided, then who waited for the moment."""
    calls: list[str] = []

    class Decision:
        def function(self, _now: float) -> None:
            calls.append("decided")

    def steps(name: str) -> Any:
        def step(_now: float) -> None:
            calls.append(name)
            if name == "b":
                scheduler().decide(Decision())

        return step

    begin = clock()
    expiry = functools.partial(steps("expiry"), 0.0)
    deadlines = Deadlines.of(asyncio.get_running_loop())
    deadlines.at(begin + 0.1, expiry, order=Order.EXPIRY)
    scheduler().at(begin + 0.1, steps("wake"))
    jobs = [scheduler().every(0.1, steps(name), name=name) for name in "cba"]
    jobs.append(scheduler().every(0.1, steps("poll"), name="z", order=Order.POLL))
    await asyncio.sleep(0.05)
    calls.clear()
    await asyncio.sleep(0.1)
    for job in jobs:
        job.stop()
    await asyncio.sleep(0)

    assert calls == ["poll", "a", "b", "c", "decided", "wake", "expiry"]


async def test_a_crowd_is_spread_by_name() -> None:
    """Its phases are the same in each run, and no two are less than 2.5 ms apart."""
    scheduler().expect(320)
    phases = [scheduler().phase(f"r{i}") for i in range(320)]

    assert phases == [scheduler().phase(f"r{i}") for i in range(320)]
    assert set(phases) == {2_500_000 * k for k in range(10)}
    assert max(map(phases.count, phases)) < 64


async def test_shots_that_were_cancelled_keep_nothing_alive() -> None:
    """The scheduler stands still when nobody waits any more."""
    kept = scheduler().at(clock() + 0.1, lambda _now: None)
    for others in range(1, 6):
        shots = [
            scheduler().at(clock() + 5.0, lambda _now: None) for _ in range(others)
        ]
        for shot in shots:
            scheduler().cancel(shot)
            scheduler().cancel(shot)
    await asyncio.sleep(0.2)
    scheduler().cancel(kept)

    names = [task.get_name() for task in asyncio.all_tasks()]
    assert "esair scheduler" not in names


async def test_a_shot_that_is_cancelled_at_the_end_of_the_loop_begins_nothing() -> None:
    """Its scheduler was cancelled with the other tasks; another would never end."""

    def leads() -> list[asyncio.Task[Any]]:
        return [t for t in asyncio.all_tasks() if t.get_name() == "esair scheduler"]

    shot = scheduler().at(clock() + 10.0, lambda _now: None)
    await asyncio.sleep(0.1)
    (lead,) = leads()
    lead.cancel()
    await asyncio.wait([lead])
    scheduler().cancel(shot)

    assert leads() == []


@pytest.mark.promise("TURN-2")
@pytest.mark.real_clock
def test_what_the_end_of_a_turn_asks_for_comes_in_the_next_one() -> None:
    """Also where turns have a border and nothing else is due for long."""

    async def main() -> float:
        loop = asyncio.get_running_loop()
        called: asyncio.Future[float] = loop.create_future()
        job = Scheduler.of(loop).on_demand(called.set_result)
        due = loop.time() + 0.01
        Deadlines.of(loop).at(due, job.soon, order=Order.EXPIRY)
        far = Scheduler.of(loop).at(due + 100.0, lambda _now: None)
        moment = await asyncio.wait_for(called, 10.0)
        Scheduler.of(loop).cancel(far)
        return moment - due

    with asyncio.Runner(loop_factory=TurnLoop) as runner:
        assert runner.run(main()) < 1.0


async def test_there_is_no_gap_while_a_step_is_asked_for() -> None:
    """Until it was called; then as long as nothing is due."""
    loop = asyncio.get_running_loop()
    scheduler = Scheduler.of(loop)
    far = scheduler.at(loop.time() + 1.0, ignore)
    await asyncio.sleep(0.5)
    assert scheduler.gap() == pytest.approx(0.5)
    job = scheduler.every(5.0, ignore)
    await asyncio.sleep(0.1)
    job.soon()
    assert scheduler.gap() == 0.0
    await asyncio.sleep(0.1)
    assert scheduler.gap() == pytest.approx(0.3)
    job.stop()
    scheduler.cancel(far)
    await asyncio.sleep(0)
    assert scheduler.gap() > 1e6
