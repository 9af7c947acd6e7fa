"""The executor: one thread for blocking calls, and one wake-up for many results."""

from __future__ import annotations

import asyncio
import functools
import threading
import time
from typing import Any

import pytest

from esair.exceptions import BusyError, DriverStuckError
from esair.loop import COMMAND, SAFE, Executor, InLine, Urgency, turn_of

pytestmark = pytest.mark.real_clock


def keep_the_loop_busy(executor: Executor) -> None:
    """Give the loop no turn until the thread has done everything."""
    end = time.monotonic() + 5.0
    while executor.waiting and time.monotonic() < end:
        time.sleep(0.001)
    time.sleep(0.01)


async def test_calls_run_in_order_on_one_thread() -> None:
    """Whoever asks first is served first, however many ask."""
    executor = Executor("bus")
    order: list[int] = []
    threads: set[str] = set()

    def work(number: int) -> int:
        order.append(number)
        threads.add(threading.current_thread().name)
        assert executor.is_current
        return number

    results = await asyncio.gather(
        *(executor.call(work, n, timeout=5.0) for n in range(100))
    )

    assert results == order == list(range(100))
    assert threads == {"esair-bus"}
    assert not executor.is_current
    executor.close()


@pytest.mark.promise("BUS-5")
async def test_the_most_urgent_call_has_the_next_turn() -> None:
    """Also if it became so while it waited, and if as many wait as may."""
    executor, order = Executor("bus", limit=8), list[Any]()
    go, later = threading.Event(), Urgency()
    loop = asyncio.get_running_loop()

    def submit(what: str, urgent: Urgency) -> asyncio.Future[None]:
        future: InLine[None] = InLine(loop=loop)
        executor.submit(loop, future, order.append, what, urgent=urgent)
        return future

    executor.submit(loop, InLine(loop=loop), go.wait)
    await asyncio.sleep(0.02)
    calls = [submit(f"poll {n}", Urgency()) for n in range(6)]
    calls.append(submit("write", later))
    with pytest.raises(BusyError):
        calls.extend(submit("poll", Urgency()) for _ in range(3))
    with later.raised(SAFE):
        calls.append(submit("safe", later))
        go.set()
        await asyncio.gather(*calls)

    assert order[:3] == ["write", "safe", "poll 0"]
    executor.close()


@pytest.mark.promise("BUS-5")
async def test_commands_have_each_second_turn() -> None:
    """They are before what waits, and do not fill the bus."""
    executor, order = Executor("bus"), list[Any]()
    loop, go, calls = asyncio.get_running_loop(), threading.Event(), []
    executor.submit(loop, InLine(loop=loop), go.wait)
    await asyncio.sleep(0.02)

    for what, urgent in [("poll", Urgency()), ("command", Urgency(COMMAND))]:
        for number in range(3):
            future: InLine[None] = InLine(loop=loop)
            told = f"{what} {number}"
            executor.submit(loop, future, order.append, told, urgent=urgent)
            calls.append(future)
    go.set()
    await asyncio.gather(*calls)

    assert order[:4] == ["command 0", "poll 0", "command 1", "poll 1"]
    executor.close()


@pytest.mark.promise("BUS-1")
async def test_results_that_are_ready_together_wake_the_loop_once(monkeypatch) -> None:
    """A burst costs less than as many single calls."""
    turn = turn_of(asyncio.get_running_loop())
    wakes = 0
    ring = turn.ring

    def counting():
        nonlocal wakes
        wakes += 1
        ring()

    monkeypatch.setattr(turn, "ring", counting)
    executor = Executor("bus")
    calls = [
        asyncio.ensure_future(executor.call(int, "7", timeout=5.0)) for _ in range(20)
    ]
    await asyncio.sleep(0)
    keep_the_loop_busy(executor)

    assert await asyncio.gather(*calls) == [7] * 20
    assert wakes == 1
    executor.close()


async def test_errors_come_to_their_own_caller() -> None:
    """Also one that would end a coroutine, or the process."""
    executor = Executor("bus")

    def fail(error: BaseException) -> None:
        raise error

    results = await asyncio.gather(
        executor.call(fail, ValueError("a"), timeout=5.0),
        executor.call(fail, StopIteration(), timeout=5.0),
        executor.call(fail, SystemExit(3), timeout=5.0),
        executor.call(fail, asyncio.CancelledError(), timeout=5.0),
        executor.call(int, "7", timeout=5.0),
        return_exceptions=True,
    )

    assert [type(each) for each in results] == [
        ValueError,
        RuntimeError,
        RuntimeError,
        RuntimeError,
        int,
    ]
    executor.close()


@pytest.mark.fault("D21")
async def test_a_new_thread_is_not_stuck_because_the_old_one_was() -> None:
    """What was left behind goes on alone, and does no harm."""
    executor = Executor("bus")
    go = threading.Event()
    with pytest.raises(DriverStuckError):
        await executor.call(go.wait, timeout=0.01)
    assert executor.stuck_since is not None
    executor.close()

    again = asyncio.ensure_future(executor.call(go.wait, timeout=5.0))
    await asyncio.sleep(0)
    assert executor.stuck_since is None
    go.set()
    assert await again is True
    executor.close()


@pytest.mark.fault("D21", "D22")
async def test_an_old_thread_that_returns_does_not_free_the_new_one() -> None:
    """Who asks is refused at once, as long as the newest thread is stuck."""
    executor = Executor("bus")
    old, new = threading.Event(), threading.Event()
    returned = threading.Event()

    def call() -> None:
        old.wait()
        returned.set()

    with pytest.raises(DriverStuckError):
        await executor.call(call, timeout=0.01)
    executor.close()
    with pytest.raises(DriverStuckError):
        await executor.call(new.wait, timeout=0.01)

    old.set()
    assert await asyncio.to_thread(returned.wait, 10)
    await asyncio.sleep(0.05)  # it has nothing to tell, so nothing can be waited for

    assert executor.stuck_since is not None
    new.set()
    assert await executor.join(10)
    assert executor.stuck_since is None


class Unspeakable:
    """A driver whose representation is at fault."""

    def __init__(self) -> None:
        self.go = threading.Event()

    def __repr__(self) -> str:
        raise RuntimeError("no words")

    def read(self) -> None:
        self.go.wait(30)


@pytest.mark.fault("D21", "D25")
async def test_a_driver_without_a_representation_is_stuck_like_any_other() -> None:
    """Its caller is told in time, by the name of the call."""
    executor = Executor("bus")
    driver = Unspeakable()
    begin = time.monotonic()

    with pytest.raises(DriverStuckError, match=r"Unspeakable\.read"):
        await executor.call(driver.read, timeout=0.01)
    with pytest.raises(DriverStuckError, match="partial"):
        await executor.call(functools.partial(print, driver), timeout=0.01)

    assert time.monotonic() - begin < 20
    driver.go.set()
    assert await executor.join(10)


async def test_what_waits_is_bounded() -> None:
    """One more than the limit is refused at once."""
    executor = Executor("bus", limit=3)
    go = threading.Event()
    first = asyncio.ensure_future(executor.call(go.wait, timeout=5.0))
    async with asyncio.timeout(5.0):
        await asyncio.sleep(0)
        while executor.waiting:  # noqa: ASYNC110 - nobody tells
            await asyncio.sleep(0.001)
    others = [
        asyncio.ensure_future(executor.call(int, "7", timeout=5.0)) for _ in range(3)
    ]
    await asyncio.sleep(0)

    assert executor.waiting == executor.limit
    with pytest.raises(BusyError, match="3"):
        await executor.call(int, "7", timeout=5.0)

    go.set()
    assert await first is True
    assert await asyncio.gather(*others) == [7, 7, 7]
    executor.close()


async def test_each_call_has_its_own_deadline() -> None:
    """One timer serves them all, and none is told too early, too late or twice."""
    executor = Executor("bus")
    go = threading.Event()
    loop = asyncio.get_running_loop()
    told: dict[float, float] = {}
    begin = loop.time()

    async def ask(timeout: float) -> None:
        with pytest.raises(DriverStuckError, match=f"in {timeout:g} s"):
            await executor.call(go.wait, timeout=timeout)
        told[timeout] = loop.time() - begin

    await asyncio.gather(*(ask(timeout) for timeout in (0.2, 0.05, 0.3, 0.1)))

    assert list(told) == [0.05, 0.1, 0.2, 0.3]
    assert all(timeout - 0.001 <= seconds for timeout, seconds in told.items())
    go.set()
    assert await executor.call(int, "7", timeout=5.0) == 7
    executor.close()


async def test_a_lane_serves_one_loop_after_another() -> None:
    """A deadline of the loop before does not count in the next."""
    executor = Executor("bus")
    go = threading.Event()

    async def life() -> None:
        assert await executor.call(int, "7", timeout=1000.0) == 7
        executor.close()

    await asyncio.to_thread(asyncio.run, life())

    with pytest.raises(DriverStuckError):
        await executor.call(go.wait, 5.0, timeout=0.05)
    go.set()
    executor.close()


@pytest.mark.promise("BUS-1", "BUS-5")
async def test_no_urgency_makes_a_line_without_an_end() -> None:
    """A command waits where there is room; what makes safe has as much room again."""
    executor, loop = Executor("bus", limit=3), asyncio.get_running_loop()
    begun, go = threading.Event(), threading.Event()
    commands, safe = Urgency(COMMAND), Urgency(COMMAND + SAFE)

    def work() -> None:
        begun.set()
        go.wait()

    executor.submit(loop, InLine(loop=loop), work)
    assert await asyncio.to_thread(begun.wait, 10.0)  # and it waits no more

    def submit(urgent: Urgency) -> None:
        executor.submit(loop, InLine(loop=loop), int, urgent=urgent)

    for urgent in (commands, safe):
        for _ in range(3):
            submit(urgent)
        with pytest.raises(BusyError):
            submit(urgent)
    go.set()
    executor.close()
