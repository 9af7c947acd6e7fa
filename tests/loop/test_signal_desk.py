"""Who hears of the signals that end robots, in which order, and what is put back."""

from __future__ import annotations

import asyncio
import functools
import os
import signal
import threading
import time
from collections.abc import Callable, Coroutine, Iterator
from types import SimpleNamespace
from typing import Any

import attrs
import pytest

from esair.loop import (
    Ending,
    LateSignals,
    ProcessWatch,
    SignalWatch,
    _overseer,
    _signals,
)
from esair.loop._overseer import LoopHeldError, Overseer
from esair.loop._signals import ENDING, LAST_WORD, SignalDesk
from esair.testing import VirtualLoop

pytestmark = [pytest.mark.virtual_clock, pytest.mark.promise("ROB-6")]

INT, TERM, HUP = ENDING


class Asleep(Overseer):
    """An overseer whose thread gets no turn: the main thread reads the bytes."""

    def __init__(self) -> None:
        super().__init__()
        self.looks: list[Callable[[float], float]] = []
        self.awoken = 0

    def join(self, look: Callable[[float], float]) -> None:
        if not self.looks:
            self._read_fd, self.wake_fd = os.pipe()
            for fd in (self._read_fd, self.wake_fd):
                os.set_blocking(fd, False)
        self.looks.append(look)

    def leave(self, look: Callable[[float], float]) -> None:
        self.looks.remove(look)
        if not self.looks:
            for fd in (self._read_fd, self.wake_fd):
                os.close(fd)
            self._read_fd = self.wake_fd = -1

    def wake(self) -> None:
        self.awoken += 1


@attrs.frozen
class Process:
    """What signals find in it."""

    desk: SignalDesk
    overseer: Asleep
    left: list[int]
    """With which code it was left."""

    def look(self, now: float) -> None:
        for each in tuple(self.overseer.looks):
            each(now)


@pytest.fixture
def process(monkeypatch: pytest.MonkeyPatch) -> Iterator[Process]:
    numbers = (*ENDING, signal.SIGURG, signal.SIGALRM)
    before = {number: signal.getsignal(number) for number in numbers}
    wakes = signal.set_wakeup_fd(-1)
    for number in numbers:
        signal.signal(number, signal.SIG_DFL)
    signal.signal(INT, signal.default_int_handler)
    left: list[int] = []
    process = Process(SignalDesk(), Asleep(), left)
    for module in (_signals, _overseer):
        monkeypatch.setattr(module, "overseer", process.overseer)
        monkeypatch.setattr(
            module, "leave_at_once", lambda code, _why: left.append(code)
        )
    monkeypatch.setattr(_signals, "desk", process.desk)
    yield process
    for number, handler in before.items():
        signal.signal(number, handler)
    signal.set_wakeup_fd(wakes)


class Robot:
    """Is told of signals."""

    def __init__(self, *, is_safe: bool = True) -> None:
        self.is_safe = is_safe
        self.told: list[Any] = []
        hurry = "second"
        self.watch = SignalWatch(
            self.told.append, lambda: self.told.append(hurry), lambda: self.is_safe
        )


def alone(
    test: Callable[..., Coroutine[Any, Any, None]],
) -> Callable[..., None]:
    """Run it without asyncio's runner, which has a handler of its own."""

    @functools.wraps(test)
    def run(**fixtures: Any) -> None:
        loop = VirtualLoop()
        try:
            loop.run_until_complete(test(**fixtures))
        finally:
            loop.close()

    return run


async def turn() -> None:
    for _ in range(3):
        await asyncio.sleep(0)


@pytest.mark.parametrize("number", ENDING)
@alone
async def test_the_first_stops_and_the_second_hurries(
    process: Process, number: signal.Signals
) -> None:
    """Each robot hears of both, in its loop, and whichever signal the second is."""
    robots = [Robot(), Robot()]
    for each in robots:
        assert each.watch.start(interrupts=False)
    signal.raise_signal(number)
    await turn()
    assert [each.told for each in robots] == [[number], [number]]
    assert robots[0].watch.number == number
    signal.raise_signal(TERM)
    await turn()
    assert [each.told for each in robots] == [[number, "second"]] * 2
    process.look(0.0)
    assert process.left == []
    for each in robots:
        each.watch.stop()


@alone
async def test_the_third_leaves_as_soon_as_all_is_safe(process: Process) -> None:
    """With its own code; it waits no longer than the last word takes."""
    safe, moves = Robot(), Robot(is_safe=False)
    for each in (safe, moves):
        each.watch.start(interrupts=False)
    for number in (TERM, INT):
        signal.raise_signal(number)
    process.look(1e12)
    awoken = process.overseer.awoken
    signal.raise_signal(HUP)
    assert process.overseer.awoken > awoken
    now = process.desk._last_word - LAST_WORD
    process.desk.look(now + LAST_WORD - 0.01)
    assert process.left == []
    assert process.desk.look(now + LAST_WORD - 0.01) == now + LAST_WORD
    moves.is_safe = True
    process.desk.look(now)
    assert process.left == [128 + HUP]
    moves.is_safe = False
    process.desk.look(now + LAST_WORD)
    assert process.left == [128 + HUP] * 2
    signal.raise_signal(TERM)  # one more changes nothing
    assert process.desk._last_word == now + LAST_WORD
    for each in (safe, moves):
        each.watch.stop()


@alone
async def test_the_process_has_its_time_from_the_first_signal_on(
    process: Process,
) -> None:
    """Whatever its loop does about it; then it is left as a signal would have."""
    robot, loop = Robot(), asyncio.get_running_loop()
    robot.watch.start(interrupts=False)
    robot.watch.last = last = Ending(loop, patience=5.0)
    signal.raise_signal(TERM)
    now = time.monotonic()
    last.look(now)
    await turn()
    last.look(now + 4.0)
    assert process.left == []
    last.look(now + 5.0)
    assert process.left == [128 + TERM]
    robot.watch.stop()


@alone
async def test_a_robot_of_another_thread_is_told_if_somebody_hears_signals(
    process: Process,
) -> None:
    """Only the main thread can: a robot there hears them for all."""
    away, here = Robot(), Robot()

    def start() -> bool:
        return process.desk.join(away.watch, interrupts=True)

    assert not await asyncio.to_thread(start)
    assert signal.getsignal(TERM) is signal.SIG_DFL
    process.desk.leave(away.watch)
    here.watch.start(interrupts=False)
    assert await asyncio.to_thread(start)
    signal.raise_signal(TERM)
    assert away.watch.number == TERM
    process.desk.leave(away.watch)
    here.watch.stop()


@alone
async def test_one_that_starts_while_others_end_ends_too(process: Process) -> None:
    """A signal is for all that runs in the process."""
    robots = [Robot(), Robot()]
    robots[0].watch.start(interrupts=False)
    signal.raise_signal(TERM)
    robots[1].watch.start(interrupts=False)
    await turn()
    assert robots[1].told == [TERM]
    for each in robots:
        each.watch.stop()
    again = Robot()
    again.watch.start(interrupts=False)
    await turn()
    assert again.told == []
    signal.raise_signal(TERM)
    await turn()
    assert again.told == [TERM]
    again.watch.stop()


@alone
async def test_one_that_has_stopped_hears_no_more(process: Process) -> None:
    """The others do."""
    robots = [Robot(), Robot()]
    for each in robots:
        each.watch.start(interrupts=False)
    robots[0].watch.stop()
    robots[0].watch.stop()
    signal.raise_signal(TERM)
    await turn()
    assert [each.told for each in robots] == [[], [TERM]]
    robots[1].watch.stop()


@pytest.mark.promise("ROB-5")
@alone
async def test_all_is_put_back_by_the_last_robot(process: Process) -> None:
    """Its handlers, and who reads the bytes of signals."""
    read, write = os.pipe()
    os.set_blocking(write, False)
    signal.set_wakeup_fd(write, warn_on_full_buffer=False)
    robots = [Robot(), Robot()]
    for each in robots:
        each.watch.start(interrupts=False)
    assert {signal.getsignal(number) for number in ENDING} == {process.desk._handle}
    assert signal.getsignal(signal.SIGURG) == process.desk._kicked
    signal.raise_signal(TERM)
    assert os.read(read, 9) == bytes([TERM])  # a loop with handlers of its own
    robots[0].watch.stop()
    assert {signal.getsignal(number) for number in ENDING} == {process.desk._handle}
    robots[1].watch.stop()
    assert signal.getsignal(INT) is signal.default_int_handler
    for number in (TERM, HUP, signal.SIGURG, signal.SIGALRM):
        assert signal.getsignal(number) is signal.SIG_DFL
    assert signal.set_wakeup_fd(-1) == write
    assert process.overseer.looks == []
    for fd in (read, write):
        os.close(fd)


@pytest.mark.promise("ROB-5")
@alone
async def test_what_somebody_has_set_since_stays(process: Process) -> None:
    """It is his: a handler, and who reads the bytes."""

    def mine(_number: int, _frame: Any) -> None:
        """Hear nothing."""

    robot = Robot()
    robot.watch.start(interrupts=False)
    signal.signal(TERM, mine)
    read, write = os.pipe()
    os.set_blocking(write, False)
    signal.set_wakeup_fd(write)
    signal.raise_signal(HUP)  # its byte goes to him, and it is counted all the same
    await turn()
    assert robot.told == [HUP]
    robot.watch.stop()
    assert signal.getsignal(TERM) is mine
    assert signal.getsignal(HUP) is signal.SIG_DFL
    assert signal.set_wakeup_fd(-1) == write
    for fd in (read, write):
        os.close(fd)


@pytest.mark.promise("ROB-5")
@pytest.mark.parametrize("interrupts", [False, True])
@alone
async def test_a_handler_of_the_program_is_its_own(
    process: Process, interrupts: bool
) -> None:
    """But for that of Ctrl-C where `esair.run` has the whole process."""
    heard: list[int] = []
    for number in (INT, TERM):
        signal.signal(number, lambda number, _frame: heard.append(number))
    robot = Robot()
    robot.watch.start(interrupts=interrupts)
    signal.raise_signal(TERM)
    signal.raise_signal(INT)
    await turn()
    assert heard == ([TERM] if interrupts else [TERM, INT])
    assert robot.told == ([INT] if interrupts else [])
    robot.watch.stop()
    signal.raise_signal(INT)
    assert heard[-1] == INT


@alone
async def test_others_are_those_of_the_same_loop_by_other_tasks(
    process: Process,
) -> None:
    """The end of the process waits for them, as long as it may."""
    robot, same, other = Robot(), Robot(), Robot()
    for each in (robot, same):
        each.watch.start(interrupts=False)
    assert not process.desk.others(robot.watch)

    async def start() -> None:
        other.watch.start(interrupts=False)

    await asyncio.create_task(start())
    assert process.desk.others(robot.watch)
    other.watch.loop = None
    assert not process.desk.others(robot.watch)
    other.watch.loop = asyncio.get_running_loop()
    await robot.watch.others_stopped(0.02)
    assert process.desk.others(robot.watch)
    other.watch.loop.call_later(1.0, other.watch.stop)
    await robot.watch.others_stopped(5.0)
    assert not process.desk.others(robot.watch)
    for each in (robot, same):
        each.watch.stop()


@alone
async def test_who_holds_the_loop_at_a_signal_is_interrupted(
    process: Process, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And then has its time to end in peace."""
    broken: list[bool] = []

    def break_out(_frame: Any, *, forced: bool) -> None:
        broken.append(forced)
        raise LoopHeldError

    monkeypatch.setattr(_signals, "break_out", break_out)
    robot = Robot()
    robot.watch.start(interrupts=False)
    signal.raise_signal(signal.SIGURG)
    assert broken == []
    signal.raise_signal(TERM)
    assert signal.getitimer(signal.ITIMER_REAL)[0] > 0.0
    with pytest.raises(LoopHeldError):
        signal.raise_signal(signal.SIGURG)
    signal.raise_signal(signal.SIGURG)
    assert broken == [False]
    assert signal.getitimer(signal.ITIMER_REAL)[0] > 0.0
    await turn()
    signal.raise_signal(signal.SIGURG)
    assert broken == [False]
    assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)
    robot.watch.stop()


@alone
async def test_a_fork_of_a_robots_process_is_no_robot(process: Process) -> None:
    """It has the program's handlers, and leaves if it goes on as the robot."""
    robot = Robot()
    robot.watch.start(interrupts=False)
    process.desk.forget()
    assert signal.getsignal(TERM) is signal.SIG_DFL
    assert signal.getsignal(INT) is signal.default_int_handler
    assert signal.set_wakeup_fd(-1) == -1
    await turn()
    assert process.left == [1]
    assert not process.desk.others(robot.watch)


def test_a_signal_after_the_end_of_a_run_is_not_lost(
    process: Process, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It ends the program with the code of the first; the interpreter's end hears none."""
    at_exit: list[Callable[[], object]] = []
    monkeypatch.setattr(_signals, "atexit", SimpleNamespace(register=at_exit.append))
    with LateSignals() as signals:
        assert signals.number is None
        signal.raise_signal(TERM)
        assert signals.number == TERM
    with pytest.raises(SystemExit) as ended:
        signal.raise_signal(INT)
    assert ended.value.code == 128 + TERM
    with LateSignals():  # one more run takes them again
        assert signal.getsignal(TERM) == process.desk._handle
    (hear_no_more,) = at_exit
    signal.signal(HUP, signal.SIG_DFL)
    hear_no_more()
    assert signal.getsignal(INT) is signal.SIG_IGN
    assert signal.getsignal(HUP) is signal.SIG_DFL


def test_a_run_without_a_signal_leaves_all_as_it_was(process: Process) -> None:
    """Ctrl-C interrupts the program again."""
    with LateSignals():
        pass
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(INT)
    assert signal.getsignal(TERM) is signal.SIG_DFL


@pytest.mark.promise("ROB-5")
@alone
async def test_what_is_changed_of_the_process_is_named(process: Process) -> None:
    """A handler, also one of asyncio, and the task factory."""
    loop = asyncio.get_running_loop()
    watch = ProcessWatch(loop)
    assert watch.changes() == []
    before = loop.get_task_factory()
    signal.signal(HUP, signal.SIG_IGN)
    loop.set_task_factory(
        lambda loop, coroutine, **_: asyncio.Task(coroutine, loop=loop)
    )
    assert watch.changes() == [
        "the handler of SIGHUP",
        "the task factory of the event loop",
    ]
    loop.set_task_factory(before)
    signal.signal(HUP, signal.SIG_DFL)
    assert watch.changes() == []


def test_asyncios_runner_hears_of_the_first_interrupt(process: Process) -> None:
    """It cancels its program; the second is the robot's, which hurries."""
    robot = Robot()
    ends: list[str] = []

    async def program() -> None:
        runners = signal.getsignal(INT)
        robot.watch.start(interrupts=False)
        signal.raise_signal(INT)
        try:
            await asyncio.sleep(10.0)
        except asyncio.CancelledError:
            ends.append("cancelled")
        await asyncio.sleep(0)
        assert robot.told == []
        signal.raise_signal(INT)
        await turn()
        assert robot.told == [INT]
        robot.watch.stop()
        assert signal.getsignal(INT) is runners

    with asyncio.Runner() as runner:
        runner.run(program())
    assert ends == ["cancelled"]
    assert signal.getsignal(INT) is signal.default_int_handler


def test_without_a_runner_the_first_interrupt_is_the_robots(process: Process) -> None:
    """One that ran before has nothing to do with it."""

    async def program() -> None:
        before = Robot()
        before.watch.start(interrupts=False)
        before.watch.stop()

    @alone
    async def later() -> None:
        robot = Robot()
        robot.watch.start(interrupts=False)
        signal.raise_signal(INT)
        await turn()
        assert robot.told == [INT]
        robot.watch.stop()

    with asyncio.Runner() as runner:
        runner.run(program())
    later()


@pytest.mark.promise("ROB-5")
def test_a_robot_that_outlives_the_runner_puts_back_what_that_would(
    process: Process,
) -> None:
    """The runner's own handler would cancel what has ended."""
    robot = Robot()

    async def program() -> None:
        robot.watch.start(interrupts=False)

    with asyncio.Runner() as runner:
        runner.run(program())
        assert signal.getsignal(INT) == process.desk._handle
        robot.watch.stop()
        assert signal.getsignal(INT) is signal.default_int_handler


@pytest.mark.promise("ROB-5")
@alone
async def test_a_signal_after_a_robot_that_ended_in_another_thread(
    process: Process,
) -> None:
    """Only the main thread can put the handlers back: it does so at the signal."""
    robot = Robot()
    robot.watch.start(interrupts=False)
    other = threading.Thread(target=robot.watch.stop)
    other.start()
    other.join()
    again = Robot()
    again.watch.start(interrupts=False)
    other = threading.Thread(target=again.watch.stop)
    other.start()
    other.join()
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(INT)
    assert robot.told == again.told == []
    assert process.overseer.looks == []
    assert signal.getsignal(TERM) is signal.SIG_DFL
