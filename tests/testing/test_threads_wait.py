"""Threads on the virtual clock: what waits for time does not hold it up."""

from __future__ import annotations

import asyncio
import threading
import time
from typing import Any

import pytest

import esair
from esair.loop import Executor
from esair.testing import FakeActuator, FakeSensor, VirtualLoop

pytestmark = pytest.mark.virtual_clock


def wait(seconds: float) -> float:
    """Wait in a thread of an executor; return when it goes on."""
    loop = waits_on[0]
    loop.wait_in_thread(seconds)
    return loop.time()


waits_on: list[VirtualLoop] = []


@pytest.fixture
async def executor() -> Executor:
    loop = asyncio.get_running_loop()
    assert isinstance(loop, VirtualLoop)
    waits_on[:] = [loop]
    return Executor("arm")


@pytest.mark.promise("TURN-6")
async def test_a_thread_waits_for_virtual_time(executor: Executor) -> None:
    """An hour passes at once, in the thread and in the loop."""
    assert await executor.call(wait, 3600.0, timeout=4000.0) == 3600.0
    assert await executor.join(1.0)


@pytest.mark.fault("D21")
async def test_what_is_queued_behind_it_does_not_stop_the_clock(
    executor: Executor,
) -> None:
    """A call that waits behind one that waits has its deadline in time."""
    loop = asyncio.get_running_loop()
    first = asyncio.ensure_future(executor.call(wait, 5.0, timeout=10.0))
    await asyncio.sleep(1.0)
    with pytest.raises(esair.DriverStuckError):
        await executor.call(wait, 0.1, timeout=2.0)
    assert loop.time() == 3.0
    assert await first == 5.0
    assert await executor.join(1.0)


@pytest.mark.fault("O16")
async def test_a_call_comes_before_the_end_that_was_asked_for_later(
    executor: Executor,
) -> None:
    """Given out in the turn in which the executor is closed, it still goes."""
    await executor.call(threading.get_ident, timeout=1.0)
    last = asyncio.ensure_future(executor.call(wait, 0.5, timeout=1.0))
    await asyncio.sleep(0)
    executor.close()
    assert await last == 0.5


@pytest.mark.promise("TURN-6")
async def test_no_time_passes_before_a_thread_has_begun_to_wait(
    executor: Executor, monkeypatch: pytest.MonkeyPatch
) -> None:
    """However long it takes to tell the loop that it waits."""
    loop = asyncio.get_running_loop()
    tell = loop.call_soon_threadsafe

    def slowly(*told: Any, **options: Any) -> Any:
        time.sleep(0.05)
        return tell(*told, **options)

    other = asyncio.ensure_future(asyncio.sleep(0.3))
    call = executor.call(wait, 0.1, timeout=1.0)
    monkeypatch.setattr(loop, "call_soon_threadsafe", slowly)
    assert await call == 0.1
    monkeypatch.undo()
    await other
    assert await executor.join(1.0)


async def test_a_thread_begins_though_the_loop_is_never_quiet() -> None:
    """Steps that take longer than their period delay it by one step, not until they end."""
    told: list[tuple[float, float]] = []

    class Motor(esair.Actuator[float]):
        safe = 0.0
        command_timeout = 0.2

        def write(self, command: float) -> None:
            told.append((loop.time(), command))

    class Heavy(esair.Reaction):
        sonar = esair.reads(float)
        rate = 20.0

        def react(self, sonar: float) -> None:
            if 1.0 <= loop.time() < 3.0:
                loop.advance(0.06)

    loop: Any = asyncio.get_running_loop()
    user: Any = esair.Behavior(name="user", writes={"motor": esair.writes(float)})
    sonar = FakeSensor("sonar", 1.0, type=float, rate=20.0)
    async with esair.Robot(resources=[Motor(), sonar], behaviors=[Heavy(), user]):
        await asyncio.sleep(0.99)
        await user.motor.write(1.0)
        await asyncio.sleep(3.0)
    (moved,) = [time for time, command in told if command == 1.0]
    after = [time for time, command in told if command == 0.0 and time > moved]
    assert after[0] - moved < 0.2 + 3 * 0.06


async def test_a_thread_falls_asleep_while_the_loop_is_busy() -> None:
    """A busy loop waits for no thread that would only wait for it."""
    loop: Any = asyncio.get_running_loop()
    goes_on = threading.Event()

    def work() -> float:
        goes_on.wait()
        loop.wait_in_thread(1.0)
        return float(loop.time())

    begin = loop.time()
    working = loop.run_in_executor(None, work)
    await asyncio.sleep(0.0)
    loop.advance(2.0)
    goes_on.set()

    assert await working - begin == pytest.approx(3.0)


async def test_a_thread_that_asks_the_loop_is_served_though_it_is_never_quiet() -> None:
    """What was ready waits for the thread, not the thread's own request."""
    wheels = FakeActuator("wheels", safe=0.0)
    sonar = FakeSensor("sonar", 1.0, type=float, rate=20.0)

    class Heavy(esair.Reaction):
        sonar = esair.reads(float)
        rate = 20.0

        def react(self, sonar: float) -> None:
            if loop.time() < 2.0:
                loop.advance(0.06)

    class Drive(esair.ThreadBehavior):
        wheels = esair.writes(float)

        def run(self) -> None:
            for number in range(1, 6):
                self.wheels.write(float(number))
                loop.wait_in_thread(0.2)

    loop: Any = asyncio.get_running_loop()
    async with esair.Robot(resources=[wheels, sonar], behaviors=[Heavy(), Drive()]):
        await asyncio.sleep(3.0)
    assert [each for each in wheels.commands if each] == [1.0, 2.0, 3.0, 4.0, 5.0]


@pytest.mark.promise("TURN-6")
@pytest.mark.parametrize("real", [0.0, 0.05])
async def test_what_a_busy_loop_does_next_depends_on_no_thread(real: float) -> None:
    """First what threads have done, however long that took; timers that are due at last."""
    loop: Any = asyncio.get_running_loop()
    order: list[str] = []

    def work() -> None:
        if real:
            threading.Event().wait(real)

    working = loop.run_in_executor(None, work)
    working.add_done_callback(lambda _: order.append("thread"))
    loop.call_later(0.5, order.append, "timer")
    loop.call_soon(order.append, "ready")
    loop.advance(1.0)
    await asyncio.sleep(0.5)

    assert order == ["thread", "ready", "timer"]


def test_a_call_of_a_thread_waits_for_no_thread(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It came while the loop was held: the threads come first, and so does what they call."""
    monkeypatch.setattr("esair.testing._clock.BLOCKED", 1.0)
    called = threading.Event()

    def work(loop: VirtualLoop) -> bool:
        loop.wait_in_thread(0.3)
        answered = threading.Event()
        loop.call_soon_threadsafe(answered.set)
        called.set()
        return answered.wait(20.0)

    def hold(loop: VirtualLoop) -> None:
        called.wait(20.0)
        loop.advance(2.0)

    async def main() -> None:
        loop = asyncio.get_running_loop()
        assert isinstance(loop, VirtualLoop)
        loop.call_later(
            0.3 + 5e-10, hold, loop
        )  # in the turn in which the thread wakes
        assert await loop.run_in_executor(None, work, loop)

    with asyncio.Runner(loop_factory=VirtualLoop) as runner:
        runner.run(main())
