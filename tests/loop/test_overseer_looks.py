"""What the overseer does about a loop, look by look: who is named, interrupted, ended."""

from __future__ import annotations

import asyncio
import gc
import logging
import math
import signal
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

import esair
from esair.loop import Ending, _overseer
from esair.loop._overseer import (
    KICK,
    PATIENCE,
    Kicks,
    Overseer,
    StallWatch,
    break_out,
    describe_holder,
)

pytestmark = pytest.mark.virtual_clock


class Held:
    """An event loop that some code holds until the test lets it turn."""

    def __init__(self) -> None:
        self.asked: list[Callable[[], object]] = []

    def call_soon_threadsafe(self, function: Callable[[], object]) -> None:
        self.asked.append(function)

    def turn(self) -> None:
        asked, self.asked = self.asked, []
        for function in asked:
            function()


class Closed(Held):
    def call_soon_threadsafe(self, function: Callable[[], object]) -> None:
        raise RuntimeError("Event loop is closed")


@pytest.fixture
def loop() -> Any:
    return Held()


# Who holds a loop.


class Asleep:
    """An overseer that only looks when the test says so."""

    def __init__(self) -> None:
        self.looks: list[Callable[[float], float]] = []
        self.awoken = 0

    def join(self, look: Callable[[float], float]) -> None:
        self.looks.append(look)

    def leave(self, look: Callable[[float], float]) -> None:
        self.looks.remove(look)

    def wake(self) -> None:
        self.awoken += 1


@pytest.fixture
def asleep(monkeypatch: pytest.MonkeyPatch) -> Asleep:
    asleep = Asleep()
    monkeypatch.setattr(_overseer, "overseer", asleep)
    return asleep


@pytest.fixture
def watch(asleep: Asleep) -> Callable[..., StallWatch]:
    def watch(loop: Any, *limits: float) -> StallWatch:
        watch = StallWatch(loop)
        for limit in limits:
            watch.start(limit)
        return watch

    return watch


@pytest.mark.fault("B07")
def test_who_holds_a_loop_is_named_once_each_time(
    loop: Any, watch: Any, caplog: Any
) -> None:
    """As soon as it is longer than the strictest limit, and not before."""
    stalls = watch(loop, 1.0, 0.1)
    assert stalls.look(10.0) == pytest.approx(10.05)
    assert stalls.look(10.05) == pytest.approx(10.1)
    assert not caplog.records
    stalls.look(10.11)
    assert "held for more than 0.1 s by" in caplog.text
    assert caplog.records[0].levelno == logging.WARNING
    stalls.look(10.2)
    assert len(caplog.records) == 1
    loop.turn()
    stalls.look(10.3)
    stalls.look(10.39)
    assert len(caplog.records) == 1
    stalls.look(10.41)
    assert len(caplog.records) == 2


@pytest.mark.fault("B07")
def test_a_loop_that_turns_is_asked_again_and_again(
    loop: Any, watch: Any, caplog: Any
) -> None:
    """Nobody is named, however long it runs."""
    stalls = watch(loop, 0.1)
    for number in range(50):
        stalls.look(number * 0.05)
        assert len(loop.asked) == 1
        loop.turn()
    assert not caplog.records


def test_a_loop_that_is_closed_is_nobodys_fault(watch: Any) -> None:
    """Its robot is about to say that it has ended."""
    held: Any = Closed()
    assert watch(held, 0.1).look(1.0) == pytest.approx(1.05)


@pytest.mark.fault("B07")
def test_the_strictest_robot_of_a_loop_counts_while_it_runs(
    loop: Any, watch: Any, asleep: Asleep, caplog: Any
) -> None:
    """From the moment on at which it starts; the last one ends the watch."""
    stalls = watch(loop, 1.0)
    assert asleep.awoken == 0
    stalls.start(0.1)
    assert asleep.awoken == 1  # a look that was due in half a second is due now
    assert asleep.looks == [stalls.look]
    stalls.stop(0.1)
    stalls.look(10.0)
    assert stalls.look(10.5) == pytest.approx(11.0)
    assert not caplog.records
    stalls.stop(1.0)
    assert asleep.looks == []
    stalls.start(1.0)
    stalls.look(12.0)  # it is asked anew
    stalls.look(12.5)
    assert not caplog.records


class Arm(esair.Behavior):
    async def run(self) -> None:
        """Do nothing."""

    def think(self, frame: Callable[[], Any]) -> Any:
        return frame()


@pytest.mark.fault("B07")
def test_the_component_is_named_whose_code_it_is() -> None:
    """The innermost one, with its line; else it is the program."""
    import sys

    level, text = describe_holder(Arm(name="left").think(sys._getframe))
    assert level == logging.WARNING
    first, _, stack = (text % 0.1).partition("\n")
    assert first.startswith("the event loop is held for more than 0.1 s by left (")
    assert first.rpartition(":")[0].endswith(
        str(Arm.think.__code__.co_firstlineno + 1) + ")"
    )
    assert "return frame()" in stack
    _, text = describe_holder(sys._getframe())
    assert " by the program:" in text


# Who is interrupted.


@pytest.fixture
def kicked(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    kicked: list[int] = []
    monkeypatch.setattr(_overseer, "kick", kicked.append)
    return kicked


@pytest.fixture
def left(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    left: list[int] = []
    monkeypatch.setattr(
        _overseer, "leave_at_once", lambda code, _why: left.append(code)
    )
    return left


@pytest.mark.promise("ROB-6")
def test_a_loop_that_hears_is_not_interrupted(
    loop: Any, kicked: list[int], left: list[int]
) -> None:
    """It is told once that it should end, and left alone until its time is over."""
    heard: list[float] = []
    ending = Ending(loop, lambda: heard.append(1.0), patience=5.0)
    assert ending.look(9.0) == math.inf
    assert not loop.asked
    ending.because(10.0)
    assert ending.look(9.5) == 10.0
    assert not loop.asked
    assert ending.look(10.0) == pytest.approx(10.0 + KICK)
    assert ending.held
    ending.look(10.1)
    assert len(loop.asked) == 1
    loop.turn()
    assert (heard, ending.held) == ([1.0], False)
    assert ending.look(10.1) == 15.0
    assert ending.look(14.9) == 15.0
    assert (kicked, left, heard, loop.asked) == ([], [], [1.0], [])


@pytest.mark.promise("ROB-6")
def test_who_holds_a_loop_that_should_end_is_interrupted(
    loop: Any, kicked: list[int], left: list[int]
) -> None:
    """After 0.25 s, then each 20 ms; what it does to end has as long, from the 25th on not."""
    ending = Ending(loop, patience=5.0)
    ending.because(10.0)
    ending.look(10.0)
    ending.look(10.0 + PATIENCE - 0.001)
    assert kicked == []
    assert ending.look(10.0 + PATIENCE) == pytest.approx(10.0 + PATIENCE + KICK)
    assert kicked == [threading.get_ident()]
    for _ in range(23):
        ending.look(10.5)
    assert not ending.forced
    ending.look(10.5)
    assert ending.forced
    assert not ending.is_spared(10.5)
    ending.interrupted(11.0)
    assert not ending.forced
    assert ending.is_spared(11.0 + PATIENCE - 0.001)
    assert not ending.is_spared(11.0 + PATIENCE)
    assert left == []


@pytest.mark.promise("ROB-6")
def test_who_holds_the_loop_once_more_is_asked_once_more(
    loop: Any, kicked: list[int], left: list[int]
) -> None:
    """Until all is safe; from the moment on at which that is seen."""
    is_safe, heard = False, []
    ending = Ending(loop, lambda: heard.append(1), is_done=lambda: is_safe)
    ending.because(10.0)
    ending.look(10.0)
    loop.turn()
    ending.look(11.0)
    assert len(loop.asked) == 1
    ending.look(11.2)
    assert kicked == []
    ending.look(11.25)
    assert len(kicked) == 1
    loop.turn()
    is_safe = True
    assert ending.look(12.0) == math.inf
    assert (len(kicked), heard, loop.asked) == (1, [1], [])


@pytest.mark.promise("ROB-6")
def test_a_reason_to_end_is_looked_at_at_once(
    loop: Any, asleep: Asleep, left: list[int]
) -> None:
    """While it is watched; without a signal the process is left with 1."""
    ending = Ending(loop, patience=5.0)
    ending.start()
    assert asleep.looks == [ending.look]
    ending.because(10.0)
    assert asleep.awoken == 1
    ending.look(15.0)
    assert left == [1]
    ending.stop()
    assert asleep.looks == []


@pytest.mark.promise("ROB-6")
def test_the_first_reason_to_end_counts(
    loop: Any, kicked: list[int], left: list[int]
) -> None:
    """By it the process is left, with its code, when its time is over."""
    ending = Ending(loop, patience=5.0)
    ending.because(20.0, 3)
    ending.because(10.0, 130)
    ending.because(12.0, 143)
    ending.look(14.999)
    assert left == []
    ending.look(15.0)
    assert left == [130]


def test_a_closed_loop_needs_no_telling(kicked: list[int], left: list[int]) -> None:
    """It has ended."""
    closed: Any = Closed()
    ending = Ending(closed)
    ending.because(1.0)
    ending.look(1.0)


# The signals that interrupt.


@pytest.fixture
def kicks() -> Iterator[Kicks]:
    kicks = Kicks(lambda _number, _frame: None)
    kicks.start()
    yield kicks
    kicks.stop()


@pytest.mark.promise("ROB-5")
def test_signals_that_somebody_uses_are_left_to_him() -> None:
    """The others are taken, and given back."""

    def mine(_number: int, _frame: Any) -> None:
        """Hear nothing."""

    before = signal.signal(signal.SIGALRM, mine)
    try:
        kicks = Kicks(lambda _number, _frame: None)
        kicks.start()
        kicks.arm()
        assert signal.getsignal(signal.SIGALRM) is mine
        assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)
        assert signal.getsignal(signal.SIGURG) is not signal.SIG_DFL
        kicks.stop()
        assert signal.getsignal(signal.SIGALRM) is mine
        assert signal.getsignal(signal.SIGURG) is signal.SIG_DFL
        signal.signal(signal.SIGURG, mine)
        kicks.stop()
        assert signal.getsignal(signal.SIGURG) is mine
        signal.signal(signal.SIGURG, signal.SIG_DFL)
    finally:
        signal.signal(signal.SIGALRM, before)


@pytest.mark.promise("ROB-6")
def test_the_kernel_interrupts_where_no_thread_gets_to_run(kicks: Kicks) -> None:
    """From a quarter of a second on, each 20 ms, until it is told to stop."""
    kicks.arm()
    first, period = signal.getitimer(signal.ITIMER_REAL)
    assert 0.0 < first <= PATIENCE
    assert period == pytest.approx(KICK)
    kicks.disarm()
    assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)
    kicks.arm()
    kicks.stop()
    assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)
    assert signal.getsignal(signal.SIGALRM) is signal.SIG_DFL


@pytest.mark.promise("ROB-6")
def test_nothing_is_interrupted_where_no_loop_runs() -> None:
    """It has ended, or is being ended: that is the program's own code."""
    import sys

    break_out(sys._getframe(), forced=True)


@pytest.mark.promise("ROB-6")
async def test_code_of_nobody_is_not_interrupted() -> None:
    """A library that no user has called."""
    break_out(None, forced=True)


@pytest.mark.promise("ROB-6")
async def test_a_component_that_holds_the_loop_is_cancelled() -> None:
    """As at any await: what it does about that is done."""
    import sys

    ends: list[str] = []

    class Holds(esair.Behavior):
        async def run(self) -> None:
            frame: Any = eval("sys._getframe()", {"sys": sys, "__name__": "my_robot"})
            try:
                break_out(frame, forced=False)
            except BaseException as error:
                ends.append(type(error).__name__)

    async with esair.Robot(behaviors=[Holds()]):
        await asyncio.sleep(0.01)
    assert ends == ["CancelledError"]


# The thread.


@pytest.mark.real_clock
def test_the_thread_lives_while_something_is_watched() -> None:
    """One for all that is; each look says when the next one is due."""
    overseer = Overseer()
    looks: list[str] = []
    came = threading.Event()

    def rare(_now: float) -> float:
        looks.append("rare")
        came.set()
        return math.inf

    def often(now: float) -> float:
        looks.append("often")
        return now + 0.01 if looks.count("often") < 5 else math.inf

    assert overseer.thread_id is None
    overseer.join(rare)
    assert came.wait(5.0)
    number = overseer.thread_id
    assert number is not None
    overseer.join(often)
    until = time.monotonic() + 2.5
    while looks.count("often") < 5 and time.monotonic() < until:
        time.sleep(0.005)
    assert overseer.thread_id == number
    assert looks.count("rare") < 50  # it sleeps until then
    overseer.leave(rare)
    overseer.leave(rare)  # a fork has none
    assert looks.count("often") == 5
    assert overseer.thread_id == number
    overseer.leave(often)
    assert overseer.thread_id is None
    assert number not in {each.native_id for each in threading.enumerate()}
    assert overseer.wake_fd == -1
    gc.collect()


@pytest.mark.real_clock
def test_bytes_of_signals_come_to_who_counts_them_each_once() -> None:
    """What only wakes the thread is none."""
    overseer = Overseer()
    came: list[int] = []
    overseer.on_bytes = came.extend
    overseer.join(lambda _now: math.inf)
    import os

    os.write(overseer.wake_fd, b"\x02\0\x0f")
    until = time.monotonic() + 5.0
    while len(came) < 2 and time.monotonic() < until:
        time.sleep(0.005)
    assert came == [2, 15]
    overseer.wake()
    overseer.leave(overseer._looks[0])
    overseer.wake()  # nobody is there
    overseer.drain()
    assert came == [2, 15]
