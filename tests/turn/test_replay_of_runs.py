"""A run in real time is repeated, without its devices, in another process."""

from __future__ import annotations

import asyncio
import concurrent.futures
import contextlib
import functools
import itertools
import os
import pickle
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import esair
from esair.journal import Kind
from esair.loop import (
    LightTask,
    News,
    Owner,
    Player,
    Portal,
    Scheduler,
    TapeWriter,
    TurnLoop,
    arrive,
)
from esair.testing import FakeActuator, FakeSensor

ROOT = Path(__file__).parents[2]

pytestmark = pytest.mark.real_clock


def run(what: str, seed: int, file: Path, hash_seed: int, seconds: float) -> list[str]:
    """Record or replay the robot of a seed; return what it decided."""
    arguments = [what, str(seed), str(file), str(seconds)]
    done = subprocess.run(
        [sys.executable, "-m", "tests.turn.recorded", *arguments],
        cwd=ROOT,
        env={**os.environ, "PYTHONHASHSEED": str(hash_seed)},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "a driver was called" not in done.stderr
    return done.stdout.splitlines()


@pytest.mark.long
@pytest.mark.promise("TURN-1", "TURN-6")
def test_live_runs_repeat_exactly(
    tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    """Same command, outcome, reading and turn, with threads and any kind of driver."""
    seeds, seconds = [8], 0.7
    if request.config.getoption("--esair-soak"):
        seeds, seconds = [*range(20)], 5.0
    for seed in seeds:
        file = tmp_path / f"{seed}.tape"
        live = run("record", seed, file, 1, seconds)
        assert len(live) > 50
        assert run("replay", seed, file, 4711, seconds) == live


@pytest.mark.promise("TURN-6")
@pytest.mark.long
def test_a_changed_decision_shows(tmp_path: Path) -> None:
    """One behavior decides otherwise: the replay differs from there on."""
    file = tmp_path / "run.tape"
    live = run("record", 8, file, 1, 0.5)

    assert run("replay", 8, file, 2, 0.5) == live
    assert run("changed", 8, file, 2, 0.5) != live


class Way(esair.Derived[float]):
    """How far it was, in all; computed in a replay too, for it is no device."""

    sonar = esair.reads(float)

    def open(self) -> None:
        self.sum = 0.0

    def compute(self, sonar: float) -> float:
        self.sum += sonar
        return self.sum


class Follows(esair.Reaction):
    """Drives as fast as the way is long."""

    sonar = esair.reads(float)
    way = esair.reads(float)
    motor = esair.writes(float)

    def react(self, sonar: float, way: float) -> float:
        return sonar / 2 + way


def play(
    loop: TurnLoop, tape: list[Any], sleep: Callable[[], object] | None = None
) -> list[tuple[Any, ...]]:
    """Run a robot whose sensor is pulled out and comes back, or that falls asleep."""
    events: list[Any] = []
    sonar, motor = FakeSensor("sonar", 1.0), FakeActuator("motor", safe=0.0)

    async def main() -> None:
        robot = esair.Robot(resources=[sonar, Way(), motor], behaviors=[Follows()])
        robot.journal.listen(events.append)
        if loop.player is None:
            loop.keep(TapeWriter(tape.append))
        else:
            loop.play()
        async with robot:
            for value in (2.0, 3.0):
                sonar.feed(value)
                await asyncio.sleep(0.05)
            if sleep is None:
                sonar.unplug()
                await asyncio.sleep(0.1)
                sonar.plug()
                await asyncio.sleep(1.2)
            else:
                sleep()
                await asyncio.sleep(0.3)
            sonar.feed(7.0)
            await asyncio.sleep(0.05)
        loop.keep(None)

    with asyncio.Runner(loop_factory=lambda: loop) as runner:
        runner.run(main())
    turns = {
        moment: turn
        for turn, moment in enumerate(each for each in tape if type(each) is float)
    }
    kinds = {Kind.READING, Kind.SENT, Kind.SAFE, Kind.DOWN, Kind.UP}
    return [
        (turns.get(each.time), each.kind, each.component, repr(each.value)[:60])
        for each in events
        if each.kind in kinds
    ]


@pytest.mark.promise("TURN-1", "TURN-6")
def test_a_device_that_was_lost_and_came_back_is_repeated() -> None:
    """Losses and arrivals are entries too; the tape goes through bytes."""
    tape: list[Any] = []
    live = play(TurnLoop(), tape)
    kept = pickle.loads(pickle.dumps(tape))

    assert {Kind.DOWN, Kind.SENT} <= {kind for _, kind, *_ in live}
    assert play(TurnLoop(player=Player(kept)), kept) == live


@pytest.mark.promise("REP-2")
@pytest.mark.fault("T02")
def test_a_sleep_of_the_computer_is_repeated(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """The clocks of the replay know nothing of it; it is told, and tells, once."""
    real = time.clock_gettime
    tape: list[Any] = []

    def sleep() -> None:
        monkeypatch.setattr(time, "clock_gettime", lambda clock: real(clock) + 60.0)

    live = play(TurnLoop(), tape, sleep)
    monkeypatch.setattr(time, "clock_gettime", real)
    assert sum("slept" in each for each in caplog.messages) == 1
    kept = pickle.loads(pickle.dumps(tape))

    assert play(TurnLoop(player=Player(kept)), kept, lambda: None) == live


class Plans(esair.Behavior):
    """Computes for a while between what it reads and what it does, not in a replay."""

    sonar = esair.reads(float)
    motor = esair.writes(float)
    computes: Callable[[float], object]

    async def run(self) -> None:
        while True:
            seen = await self.sonar.read()
            type(self).computes(esair.random.uniform(0.0, 0.012))
            await self.motor.write(seen + esair.random.random())
            await self.put("thinks", seen)


class Thinks(esair.Behavior):
    """Is told what was seen, and computes too."""

    motor = esair.writes(float)

    async def run(self) -> None:
        while True:
            seen = await self.receive()
            Plans.computes(esair.random.uniform(0.0, 0.008))
            await self.motor.write(-seen - esair.random.random())


@pytest.mark.promise("TURN-4", "TURN-6")
def test_who_gave_way_because_it_computed_does_so_again() -> None:
    """However long its computation takes in the replay: it has no clock of its own."""

    def play(loop: TurnLoop, tape: list[Any]) -> list[Any]:
        events: list[Any] = []
        sonar, motor = FakeSensor("sonar", 1.0), FakeActuator("motor", safe=0.0)
        Plans.computes = await_nothing if loop.player is None else float

        async def main() -> None:
            behaviors = [Plans(), Thinks()]
            robot = esair.Robot(resources=[sonar, motor], behaviors=behaviors, seed=7)
            robot.journal.listen(events.append)
            if loop.player is None:
                loop.keep(TapeWriter(tape.append))
            else:
                loop.play()
            async with robot:
                for value in range(20):
                    sonar.feed(float(value))
                    await asyncio.sleep(0.02)
            loop.keep(None)

        with asyncio.Runner(loop_factory=lambda: loop) as runner:
            runner.run(main())
        moments = [each for each in tape if type(each) is float]
        turns = {moment: turn for turn, moment in enumerate(moments)}
        kinds = {Kind.READING, Kind.COMMAND, Kind.SENT, Kind.SAFE, Kind.PUT}
        return [
            (turns.get(each.time), each.kind, each.component, repr(each.value)[:60])
            for each in events
            if each.kind in kinds
        ]

    tape: list[Any] = []
    live = play(TurnLoop(), tape)
    kept = pickle.loads(pickle.dumps(tape))

    assert (
        sum(each[0] == ("turn", "gave way") for each in kept if type(each) is tuple) > 5
    )
    assert play(TurnLoop(player=Player(kept)), kept) == live


@pytest.mark.promise("PLC-7", "REP-2")
def test_who_goes_on_with_what_comes_does_so_before_all_that_is_ready_again() -> None:
    """As what a placed behavior has asked for: so its process is told in the same order."""

    def play(loop: TurnLoop, tape: list[Any]) -> list[str]:
        told: list[str] = []

        async def main() -> None:
            if loop.player is None:
                loop.keep(TapeWriter(tape.append))
            else:
                loop.play()
            comes: asyncio.Future[int] = loop.create_future()

            async def waits() -> None:
                await comes
                told.append("waits")

            light = LightTask(loop, "waits")
            light.begin(waits())
            light.then(lambda *_: None)
            News(loop, ("bell",), lambda value: arrive(comes, value)).tell(1)
            loop.call_soon(told.append, "ready")
            await asyncio.sleep(0.01)
            loop.keep(None)

        with asyncio.Runner(loop_factory=lambda: loop) as runner:
            runner.run(main())
        return told

    tape: list[Any] = []
    live = play(TurnLoop(), tape)

    assert live == ["waits", "ready"]
    assert play(TurnLoop(player=Player(tape)), tape) == live


class GivesUp(esair.Behavior):
    """Waits for a thread no longer, which ends all the same."""

    async def run(self) -> None:
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(0.02):
                await asyncio.to_thread(time.sleep, 0.04)
        await asyncio.sleep(0.1)


@pytest.mark.promise("REP-2")
def test_a_thread_that_nobody_waits_for_any_more_holds_up_no_repetition(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """There it is given up sooner than it has begun: time is quicker, threads are not."""
    monkeypatch.setattr("esair.loop._tape.PATIENCE", 1.0)

    def play(loop: TurnLoop, tape: list[Any]) -> None:
        async def main() -> None:
            if loop.player is None:
                loop.keep(TapeWriter(tape.append))
            else:
                threads.submit(time.sleep, 0.1)
                loop.play()
            async with esair.Robot(behaviors=[GivesUp()]):
                await asyncio.sleep(0.2)
            loop.keep(None)

        # No Runner: at its end it waits for threads by the clock, which is quicker here.
        with (
            concurrent.futures.ThreadPoolExecutor(1) as threads,
            contextlib.closing(loop),
        ):
            loop.set_default_executor(threads)
            loop.run_until_complete(main())

    tape: list[Any] = []
    play(TurnLoop(), tape)
    player = Player(tape)
    play(TurnLoop(player=player), tape)

    assert any(type(each) is tuple and each[0][0] == "thread" for each in tape)
    assert player.late == ""


@pytest.mark.promise("REP-2")
def test_two_threads_of_one_name_are_told_apart() -> None:
    """One that is replaced works on beside the new one; now the other is quicker."""

    def play(loop: TurnLoop, tape: list[Any], *naps: float) -> list[float]:
        told: list[float] = []

        async def main() -> None:
            if loop.player is None:
                loop.keep(TapeWriter(tape.append))
            else:
                loop.play()

            def works(own: Portal, number: int) -> None:
                time.sleep(naps[number])
                own.call(tells, number)

            async def tells(number: int) -> None:
                told.append(number)

            owner = Owner()
            async with asyncio.TaskGroup() as tasks:
                for number in range(2):
                    own = Portal("drive", owner)
                    tasks.create_task(own.run(functools.partial(works, own, number)))
            loop.keep(None)

        with asyncio.Runner(loop_factory=lambda: loop) as runner:
            runner.run(main())
        return told

    tape: list[Any] = []
    assert play(TurnLoop(), tape, 0.0, 0.2) == [0, 1]
    assert play(TurnLoop(player=Player(tape)), tape, 0.2, 0.0) == [0, 1]


class Stops(esair.Behavior):
    """Halts its robot from a thread, which waits until all is safe."""

    def __init__(self) -> None:
        super().__init__()
        self.over = asyncio.Event()
        self.waited = False

    def halt(self) -> None:
        self.halt_robot("enough").result(timeout=1.0)

    async def run(self) -> None:
        try:
            await asyncio.to_thread(self.halt)
        except TimeoutError:
            self.waited = True
        self.over.set()


@pytest.mark.promise("REP-2")
def test_a_thread_that_halts_the_robot_does_not_wait_for_that_in_a_repetition() -> None:
    """What its halt did is on the tape, with its moment; the thread goes on."""

    def play(loop: TurnLoop, tape: list[Any]) -> bool:
        stops = Stops()

        async def main() -> None:
            if loop.player is None:
                loop.keep(TapeWriter(tape.append))
            else:
                loop.play()
            wheels = FakeActuator("wheels", safe=0.0)
            async with esair.Robot(resources=[wheels], behaviors=[stops]):
                await stops.over.wait()
            loop.keep(None)

        with asyncio.Runner(loop_factory=lambda: loop) as runner:
            runner.run(main())
        return stops.waited

    tape: list[Any] = []
    assert not play(TurnLoop(), tape)
    assert not play(TurnLoop(player=Player(tape)), tape)


@pytest.mark.real_clock
@pytest.mark.promise("REP-2")
def test_a_thread_may_end_after_a_repetition(recwarn: pytest.WarningsRecorder) -> None:
    """asyncio waits for it by a clock that goes on as usual: it is not said to hang."""

    async def main(loop: TurnLoop) -> None:
        loop.play()
        loop.run_in_executor(None, time.sleep, 0.1)
        await asyncio.sleep(1.0)

    loop = TurnLoop(player=Player([]))
    with asyncio.Runner(loop_factory=lambda: loop) as runner:
        runner.run(main(loop))
    assert [str(each.message) for each in recwarn] == []


def await_nothing(seconds: float) -> None:
    """Keep the loop busy."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        pass


def test_the_clock_stands_still_in_a_turn() -> None:
    """All that is decided in a turn is decided at one moment."""

    async def main() -> None:
        loop: Any = asyncio.get_running_loop()
        before, turn = loop.time(), loop.turn
        await_nothing(0.01)
        assert (loop.time(), loop.turn) == (before, turn)
        await asyncio.sleep(0)
        assert loop.time() >= before + 0.01
        assert loop.turn == turn + 1

    with asyncio.Runner(loop_factory=TurnLoop) as runner:
        runner.run(main())


def test_timers_of_one_moment_go_off_in_the_order_of_their_calls() -> None:
    """However many others are between them, and whichever are cancelled."""
    fired: list[int] = []

    async def main() -> None:
        loop = asyncio.get_running_loop()
        when = loop.time() + 0.01
        handles = [loop.call_at(when, fired.append, i) for i in range(50)]
        for handle in handles[::3]:
            handle.cancel()
        await asyncio.sleep(0.05)

    with asyncio.Runner(loop_factory=TurnLoop) as runner:
        runner.run(main())
    assert fired == [i for i in range(50) if i % 3]


def test_no_step_is_lost_where_turns_have_a_border() -> None:
    """The timer is set anew before its own callback runs: nothing sleeps on.

    A busy computer loses steps too, but it does not lose each second one.
    """
    period = 0.002
    calls: list[float] = []
    enough = asyncio.Event()

    def call(now: float) -> None:
        calls.append(now)
        gaps = [b - a for a, b in itertools.pairwise(calls)]
        if sum(gap < 1.5 * period for gap in gaps) == 50:
            enough.set()

    async def main() -> None:
        job = Scheduler.of(asyncio.get_running_loop()).every(period, call)
        async with asyncio.timeout(60.0):
            await enough.wait()
        job.stop()
        assert len(calls) + job.skipped >= (calls[-1] - calls[0]) / period - 1

    with asyncio.Runner(loop_factory=TurnLoop) as runner:
        runner.run(main())
