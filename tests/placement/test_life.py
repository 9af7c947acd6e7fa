"""Components in processes of their own: they do what they do in the robot's, and die alone."""

from __future__ import annotations

import asyncio
import contextvars
import gc
import importlib
import math
import os
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from tests.placement.parts import (
    AgedClock,
    Answering,
    Avoid,
    BlockingPusher,
    Clock,
    Dock,
    Docked,
    Docking,
    Drive,
    Echo,
    Impatient,
    Loaded,
    OneByOne,
    PushedClock,
    Pusher,
    Registers,
    SmallAvoid,
    SmallSonar,
    Sonar,
    Stopwatch,
    ThreadDrive,
    Twist,
    Writes,
)

import esair
from esair.placement import Seat
from esair.placement._wire import Wire
from esair.testing import FakeActuator, FakeSensor

pytestmark = [pytest.mark.real_clock, pytest.mark.xdist_group("placement")]

STOP = Twist(0.0, 0.0)


def fake_wheels(timeout: float | None = 0.2) -> FakeActuator[Twist]:
    wheels: FakeActuator[Twist] = FakeActuator("wheels", safe=STOP)
    wheels.command_timeout = timeout  # type: ignore[assignment]
    return wheels


async def until(condition: Callable[[], Any], within: float = 10.0) -> None:
    """Wait until something is so."""
    end = time.monotonic() + within
    while not condition():
        assert time.monotonic() < end, "it did not come to that"
        await asyncio.sleep(0.005)


def place(component: Any, where: Any) -> None:
    """Say of one component where it lives."""
    component.placement = where


def lives(pid: int | None) -> bool:
    return Path(f"/proc/{pid}").exists()


class Listen(esair.Behavior):
    """Reads a sensor, in the robot's process."""

    sonar = esair.reads(float)

    def __init__(self, sensor: str = "sonar") -> None:
        super().__init__(reads={"sonar": esair.reads(float, name=sensor)})
        self.heard: list[float] = []

    async def run(self) -> None:
        async for value in self.sonar:
            self.heard.append(value)


@pytest.mark.promise("PLC-1")
@pytest.mark.parametrize("kind", [Sonar, Pusher, BlockingPusher])
async def test_a_sensor_is_read_from_its_process(kind: type[Any]) -> None:
    """What a driver gives in a child is heard, in order, and is of no thread of the robot."""
    sensor = kind(name="sonar", rate=100.0)
    listen = Listen()
    async with esair.Robot(resources=[sensor], behaviors=[listen]) as robot:
        await until(lambda: len(listen.heard) >= 5)
        status = robot.resources.query("sonar")
        assert status.placement == "process"
        assert status.pid not in {None, os.getpid()}
        assert listen.heard == sorted(set(listen.heard))


@pytest.mark.promise("BEH-5", "PLC-1")
async def test_time_goes_on_in_a_plain_method_of_a_driver() -> None:
    """A driver that waits by the robot's clock is through when its time is over."""
    listen = Listen("echo")
    async with esair.Robot(resources=[Echo(name="echo")], behaviors=[listen]):
        await until(lambda: len(listen.heard) >= 3)
    assert all(0.01 <= each < 0.2 for each in listen.heard)


@pytest.mark.promise("PLC-7")
async def test_a_call_is_one_message_there_and_one_back(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Each message wakes a process: that is most of what a call costs."""
    sent: list[bytes] = []
    send = Wire.send

    def counted(wire: Wire, kind: bytes, *message: Any) -> None:
        sent.append(kind)
        send(wire, kind, *message)

    monkeypatch.setattr(Wire, "send", counted)
    costs = []
    async with esair.Robot(
        resources=[fake_wheels()], behaviors=[Writes(name="writes")]
    ) as robot:
        for count in (5, 25):
            begun = len(sent)
            await robot.behaviors.put(count, sender="user", receiver="writes")
            await robot.behaviors.get(sender="writes", receiver="user", interval=10.0)
            costs.append(len(sent) - begun)
    assert costs[1] - costs[0] == 20


@pytest.mark.promise("BEH-5", "PLC-1")
async def test_a_thread_hears_what_time_it_is_now() -> None:
    """Not what it was when it began to compute."""
    async with esair.Robot(behaviors=[Stopwatch(name="stopwatch")]) as robot:
        get = robot.behaviors.get
        for _ in range(3):
            took = await get(sender="stopwatch", receiver="user", interval=10.0)
            assert 0.1 <= took < 0.5


class Late(esair.Reaction):
    """Keeps how old the time was that it decided on."""

    clock = esair.reads(float, max_age=0.15)

    def __init__(self) -> None:
        super().__init__()
        self.ages: list[float] = []

    def react(self, clock: float) -> None:
        self.ages.append(time.monotonic() - clock)


@pytest.mark.promise("SC-3", "SC-4", "PLC-1")
@pytest.mark.parametrize("kind", [Clock, AgedClock, PushedClock])
async def test_what_lay_in_the_socket_is_as_old_as_it_is(kind: type[Any]) -> None:
    """What a child measured while the robot stood still is not new when that goes on."""
    late = Late()
    async with esair.Robot(resources=[kind(name="clock")], behaviors=[late]):
        for _ in range(4):
            wanted = len(late.ages) + 2
            await until(lambda wanted=wanted: len(late.ages) >= wanted)  # type: ignore[misc]
            await asyncio.sleep(0.02)  # amid a measurement
            time.sleep(0.3)  # noqa: ASYNC251 - that is the point
        await asyncio.sleep(0.5)
    assert max(late.ages) < 0.22


@pytest.mark.promise("PLC-1")
@pytest.mark.parametrize("kind", [Drive, ThreadDrive])
async def test_a_behavior_drives_from_its_process(kind: type[Any]) -> None:
    """Its writes are those of a behavior; when it is removed what it moved is safe."""
    wheels = fake_wheels()
    behavior = kind(name="drive")
    async with esair.Robot(resources=[wheels], behaviors=[behavior]) as robot:
        await wheels.until(Twist(0.3, 0.0), timeout=10.0)
        status = robot.behaviors.query("drive")
        assert (status.placement, status.state) == (
            "process",
            esair.BehaviorState.RUNNING,
        )
        pid = status.pid
        assert pid is not None
        assert robot.resources.why("wheels").holder == "drive"

        await robot.behaviors.remove("drive")

        assert wheels.commands[-1] == STOP
        await until(lambda: not lives(pid))


async def test_a_process_begins_with_what_the_robot_has_of_esair() -> None:
    """It is one for all of them: loaded once, not by each, and one memory."""

    class Taker(esair.Behavior):
        told: Any = None

        async def run(self) -> None:
            self.told = await self.receive()

    taker = Taker(name="taker")
    async with esair.Robot(behaviors=[taker, Loaded(name="loaded")]):
        await until(lambda: taker.told is not None)
        assert taker.told == []


@pytest.mark.promise("PLC-1")
async def test_a_reaction_decides_in_its_process() -> None:
    """Its command takes the actuator by its priority; "no opinion" gives it back."""
    wheels, sonar = fake_wheels(), FakeSensor("sonar", 1.0)
    wander = Drive(name="wander")
    place(wander, None)
    async with esair.Robot(resources=[wheels, sonar], behaviors=[Avoid(), wander]):
        await wheels.until(Twist(0.3, 0.0), timeout=10.0)
        sonar.feed(0.2)
        await wheels.until(Twist(0.0, 1.2), timeout=10.0)
        sonar.feed(1.0)
        await wheels.until(Twist(0.3, 0.0), timeout=10.0)


@pytest.mark.promise("PLC-1", "PLC-5")
@pytest.mark.parametrize("kind", [Docking, Answering])
async def test_asks_are_answered_from_a_process(kind: type[Any]) -> None:
    """A request and its answer cross equal and of their class."""
    async with esair.Robot(behaviors=[kind(name="docking")]) as robot:
        answer = await robot.behaviors.ask(Dock(3), sender="user", receiver="docking")
    assert answer == Docked(3)
    assert type(answer) is Docked


@pytest.mark.promise("PLC-1", "PLC-4")
async def test_a_loop_for_each_request_leaves_nothing_in_the_robot() -> None:
    """A behavior may begin loops for as long as the robot lives."""

    def kept() -> int:
        gc.collect()
        kinds = (contextvars.Context, Dock)
        return sum(isinstance(each, kinds) for each in gc.get_objects())

    async with esair.Robot(behaviors=[OneByOne(name="docking")]) as robot:

        async def ask(count: int) -> None:
            for bay in range(count):
                asked = robot.behaviors.ask(
                    Dock(bay), sender="user", receiver="docking"
                )
                assert await asked == Docked(bay)

        await ask(5)
        before = kept()
        await ask(40)
        assert kept() - before < 10


@pytest.mark.promise("PLC-1", "ROB-7")
async def test_the_same_registration_again_leaves_nothing_in_the_robot() -> None:
    """A behavior may register for each of its jobs for as long as the robot lives."""
    sonar = FakeSensor("sonar", 1.0)
    registers = Registers(name="registers")
    async with esair.Robot(resources=[sonar], behaviors=[registers]) as robot:
        get = robot.behaviors.get
        assert await get(sender="registers", receiver="user", interval=10.0) == "done"
        cells = [each.cell_contents for each in vars(registers)["run"].__closure__]
        (seat,) = [each for each in cells if isinstance(each, Seat)]
        assert len(seat._verbs._registered) == 1  # type: ignore[attr-defined]


@pytest.mark.promise("PLC-1", "PLC-5")
async def test_a_get_is_answered_from_a_process() -> None:
    """`provide` runs in the child, for whoever asks."""
    async with esair.Robot(behaviors=[Answering()]) as robot:
        given = await robot.behaviors.get(sender="answering", receiver="user")
    assert given == Twist(1.0, 2.0)


DEATHS = ["kill", "segfault", "exit", "abort"]
LONG_STOP = pytest.param("stop", marks=pytest.mark.long)


@pytest.mark.promise("PLC-3", "PLC-4")
@pytest.mark.fault("B05")
@pytest.mark.parametrize("fault", [*DEATHS, "raise"])
async def test_the_death_of_a_behavior_is_a_crash(fault: str) -> None:
    """What it moved is safe, it is started again as it was added, and drives on."""
    wheels = fake_wheels(timeout=5.0)
    async with esair.Robot(resources=[wheels], behaviors=[Drive(fault=fault)]) as robot:
        await until(lambda: robot.behaviors.query("drive").restarts == 1)
        error = robot.behaviors.query("drive").error
        await until(lambda: STOP in wheels.commands[5:])
        before = len(wheels.commands)
        await until(lambda: Twist(0.3, 0.0) in wheels.commands[before:])
    if fault != "raise":
        assert isinstance(error, esair.ProcessDiedError)
        assert {
            "kill": "SIGKILL",
            "segfault": "SIGSEGV",
            "exit": "7",
            "abort": "SIGABRT",
        }[fault] in str(error)
    if fault == "segfault":
        assert "misbehave" in error.words  # type: ignore[union-attr] # where it was


@pytest.mark.long
@pytest.mark.promise("PLC-3")
@pytest.mark.fault("B07")
@pytest.mark.parametrize("fault", ["hang", LONG_STOP])
async def test_a_behavior_that_hangs_is_killed(fault: str) -> None:
    """The dead man stops what it moves; after `stall` it is killed, and started again."""
    wheels = fake_wheels(timeout=0.2)
    drive = Drive(fault=fault)
    place(drive, esair.Placement(stall=0.6))
    async with esair.Robot(resources=[wheels], behaviors=[drive]) as robot:
        await wheels.until(Twist(0.3, 0.0), timeout=10.0)
        await until(lambda: wheels.commands[-1] == STOP)
        assert robot.behaviors.query("drive").restarts == 0  # not killed yet
        await until(lambda: robot.behaviors.query("drive").restarts == 1)
        error = robot.behaviors.query("drive").error
        await wheels.until(Twist(0.3, 0.0), timeout=10.0)
    assert "hung for 0.6 s" in str(error)
    if fault == "hang":
        assert "misbehave" in str(error)


@pytest.mark.long
@pytest.mark.promise("PLC-3", "PLC-2")
@pytest.mark.parametrize("fault", DEATHS)
async def test_a_reaction_that_dies_is_blind(fault: str) -> None:
    """Nobody of its priority or a lower one moves until it decides again."""
    wheels, sonar = fake_wheels(timeout=1.0), FakeSensor("sonar", 1.0)
    wander = Drive(name="wander")
    place(wander, None)
    avoid = Avoid(fault=fault, at=30)
    avoid.restart = esair.Restart(max=3, within=30, delay=0.3)
    sonar.rate = 50.0
    async with esair.Robot(
        resources=[wheels, sonar], behaviors=[avoid, wander]
    ) as robot:
        await wheels.until(Twist(0.3, 0.0), timeout=10.0)
        await until(lambda: robot.behaviors.query("avoid").restarts == 1)
        await until(lambda: wheels.commands[-1] == STOP, within=0.25)
        await wheels.until(Twist(0.3, 0.0), timeout=10.0)


@pytest.mark.long
@pytest.mark.promise("PLC-2")
@pytest.mark.parametrize("fault", ["hang", LONG_STOP])
async def test_a_reaction_that_owes_an_answer_is_blind(fault: str) -> None:
    """Its last word was "no opinion": after `command_timeout` nobody drives on by it."""
    wheels, sonar = fake_wheels(timeout=0.3), FakeSensor("sonar", 1.0)
    wander = Drive(name="wander")
    place(wander, None)
    avoid = Avoid(fault=fault, at=10)
    place(avoid, esair.Placement(stall=1.5))
    sonar.rate = 50.0
    async with esair.Robot(
        resources=[wheels, sonar], behaviors=[avoid, wander]
    ) as robot:
        await wheels.until(Twist(0.3, 0.0), timeout=10.0)
        await until(lambda: "owes an answer" in robot.behaviors.query("avoid").detail)
        await until(lambda: wheels.commands[-1] == STOP, within=0.25)
        assert robot.behaviors.query("avoid").restarts == 0
        await until(lambda: robot.behaviors.query("avoid").restarts == 1)
        await wheels.until(Twist(0.3, 0.0), timeout=10.0)


@pytest.mark.long
@pytest.mark.promise("PLC-3")
@pytest.mark.fault("D01")
@pytest.mark.parametrize("fault", [*DEATHS, "hang", LONG_STOP])
async def test_a_driver_that_dies_or_hangs_is_lost_and_back(fault: str) -> None:
    """The device is LOST, and opened again in a new process."""
    sonar = Sonar(fault=fault, at=5, rate=50.0)
    listen = Listen()
    async with esair.Robot(resources=[sonar], behaviors=[listen]) as robot:
        await until(lambda: len(listen.heard) >= 3)
        pid = robot.resources.query("sonar").pid
        await until(lambda: robot.resources.query("sonar").losses == 1)
        await until(lambda: robot.resources.query("sonar").pid not in {pid, None})
        heard = len(listen.heard)
        await until(lambda: len(listen.heard) > heard)
        assert not lives(pid)


@pytest.mark.promise("PLC-3")
async def test_a_driver_that_dies_at_open_is_tried_again() -> None:
    """It is LOST; the robot starts all the same, and says why."""
    sonar = Sonar(fault="exit at open")
    async with esair.Robot(resources=[sonar]) as robot:
        status = robot.resources.query("sonar")
        assert status.state is not esair.ResourceState.READY
        assert "exited with 3" in str(status.error)


SLOW = """
import sys
import time

import esair

if "esair.placement._child" in sys.modules:
    time.sleep({})


class Slow(esair.Sensor[float]):
    placement = "process"
    deadline = 0.1

    def read(self):
        return 1.0
"""


def slow_sensor(path: Path, seconds: float) -> Any:
    """Make a sensor whose module takes so long to import in a process of its own."""
    name = f"slow_{seconds:.0f}"
    (path / f"{name}.py").write_text(SLOW.format(seconds))
    return importlib.import_module(name).Slow(name="slow")


@pytest.mark.promise("PLC-1", "RES-2")
async def test_an_import_may_take_longer_than_a_call_of_the_driver(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A sensor is ready when its module is there, whatever its deadline."""
    monkeypatch.syspath_prepend(tmp_path)
    async with esair.Robot(resources=[slow_sensor(tmp_path, 1.2)]) as robot:
        status = robot.resources.query("slow")
        assert (status.state, status.losses) == (esair.ResourceState.READY, 0)


@pytest.mark.promise("PLC-3")
async def test_an_import_that_hangs_is_killed_and_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The error says what has not ended, and what gives it more time."""
    monkeypatch.syspath_prepend(tmp_path)
    sensor = slow_sensor(tmp_path, 60.0)
    sensor.placement = esair.Placement(stall=0.3)
    async with esair.Robot(resources=[sensor]) as robot:
        status = robot.resources.query("slow")
        assert "hung for 0.3 s; it was killed in its import" in str(status.error)
        assert "a longer `stall`" in str(status.error)


@pytest.mark.promise("PLC-1", "MIN-2")
async def test_classes_of_min_are_placed_too() -> None:
    """A sensor and a reaction that were written for a board, each in a process."""
    wheels: FakeActuator[float] = FakeActuator("wheels", safe=0.0)
    sonar, avoid = SmallSonar(name="sonar"), SmallAvoid(0.7)
    async with esair.Robot(resources=[sonar, wheels], behaviors=[avoid]) as robot:
        await wheels.until(0.7, timeout=10.0)
        assert robot.behaviors.query("small_avoid").placement == "process"
        assert robot.resources.query("sonar").placement == "process"


class Source(esair.Behavior):
    """Offers what it is told to."""

    async def run(self) -> None:
        await asyncio.sleep(math.inf)


@pytest.mark.promise("BS-4", "BS-9", "BS-10", "PLC-1")
@pytest.mark.parametrize("way", ["receive", "get", "ask"])
async def test_who_is_cancelled_has_taken_nothing(way: str) -> None:
    """What comes in the instant of a timeout is there for who asks next."""
    source, got = Source(name="source"), []
    waits = Impatient(way, 0.01, name="waits")
    async with esair.Robot(behaviors=[source, waits]) as robot:
        there = robot.behaviors
        for each in range(100):
            await asyncio.sleep(0.0003 * each % 0.011)
            if way == "ask":
                asked = there.ask(
                    Dock(each), sender="user", receiver="waits", timeout=5
                )
                got.append((await asked).bay)
            elif way == "get":
                source.offer(each)
            else:
                await there.put(each, sender="user", receiver="waits")
        while way != "ask" and len(got) < 100:
            got.append(await there.get(sender="waits", receiver="user", interval=5.0))
    assert got == list(range(100))


@pytest.mark.promise("BS-4", "BS-10", "PLC-6")
@pytest.mark.parametrize("way", ["receive", "get", "ask"])
@pytest.mark.parametrize("fault", [signal.SIGSTOP, signal.SIGKILL])
async def test_who_dies_while_it_waits_has_taken_nothing(way: str, fault: int) -> None:
    """What is delivered before the robot knows of it is there for its next process."""
    source = Source(name="source")
    waits = Impatient(way, 60.0, name="waits")
    async with esair.Robot(behaviors=[source, waits]) as robot:
        there = robot.behaviors
        await asyncio.sleep(0.2)
        pid = there.query("waits").pid
        assert pid is not None
        os.kill(pid, fault)
        if way == "ask":
            asked = there.ask(Dock(7), sender="user", receiver="waits", timeout=20.0)
            assert await asked == Docked(7)
            return
        if way == "get":
            source.offer(7)
        else:
            await there.put(7, sender="user", receiver="waits", interval=20.0)
        await until(lambda: there.query("waits").restarts == 1)
        assert await there.get(sender="waits", receiver="user", interval=20.0) == 7
        told = [each for each in there.outcomes() if each.receiver == "waits"]
        ended = [each.outcome.value for each in told]
        assert ended == (["withdrawn", "delivered"] if way == "get" else ["delivered"])
