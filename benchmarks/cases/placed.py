"""P23: a component in a process of its own: its calls, its CPU, its start, its memory."""

from __future__ import annotations

import asyncio
import statistics
import time
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import attrs

import esair
from benchmarks import harness
from benchmarks.harness import (
    Row,
    future_round_trip,
    ms,
    neighbors,
    percent,
    repeated,
    us,
)
from esair.testing import FakeActuator, FakeSensor

COUNT = 300
"""How many calls are made for one measurement."""

STARTS = 11
SECONDS = 3.0
IDLE = 20


class Calls(esair.Behavior):
    """Makes calls when it is asked to, and says how long one has taken."""

    sonar = esair.reads(float)
    wheels = esair.writes(float)

    async def run(self) -> None:
        while True:
            what, count = await self.receive()
            call = getattr(self, f"_{what}")
            begin = time.perf_counter()
            for _ in range(count):
                await call()
            seconds = (time.perf_counter() - begin) / count
            await self.put("bench", seconds)

    async def _read(self) -> None:
        await self.sonar.read()

    async def _put(self) -> None:
        await self.put("taker", 1.0)

    async def _write(self) -> None:
        await self.wheels.write(0.5)

    async def _ask(self) -> None:
        await self.ask("taker", Question(1.0))


@attrs.frozen
class Question(esair.Request[float]):
    """A question with a short answer."""

    value: float


class Idle(esair.Behavior):
    """Does nothing."""

    placement = "process"

    async def run(self) -> None:
        await asyncio.Event().wait()


class Steps(esair.Behavior):
    """Reads, computes a little and writes, a hundred times a second."""

    sonar = esair.reads(float)
    wheels = esair.writes(float)

    async def run(self) -> None:
        async for _ in esair.every(0.01):
            await self.wheels.write(min(1.0, await self.sonar.read()))


class ThreadSteps(esair.ThreadBehavior):
    """The same in a thread."""

    sonar = esair.reads(float)
    wheels = esair.writes(float)

    def run(self) -> None:
        for _ in esair.every(0.01):
            self.wheels.write(min(1.0, self.sonar.read()))


class Taker(esair.Behavior):
    """Takes what is put, and answers."""

    @esair.answers
    async def question(self, request: Question) -> float:
        return request.value

    async def run(self) -> None:
        while True:
            await self.receive()


class Bench(esair.Behavior):
    """Who waits for what was measured."""

    def __init__(self) -> None:
        super().__init__(name="bench")
        self.found: asyncio.Queue[float] = asyncio.Queue()

    async def run(self) -> None:
        while True:
            self.found.put_nowait(await self.receive())


def parts() -> list[Any]:
    wheels: FakeActuator[float] = FakeActuator("wheels", safe=0.0)
    return [wheels, FakeSensor("sonar", 0.5, rate=100.0, type=float)]


def placed(component: Any) -> Any:
    component.placement = "process"
    return component


def cpu_of(pid: int) -> float:
    """Return the CPU of another process, all its threads, in seconds."""
    tasks = Path(f"/proc/{pid}/task").glob("*/schedstat")
    return sum(int(each.read_text().split()[0]) for each in tasks) / 1e9


def private_of(pid: int) -> int:
    """Return the memory that a process shares with no other, in bytes."""
    told = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
    return sum(
        int(line.split()[1]) << 10 for line in told if line.startswith("Private_")
    )


async def rows() -> list[Row]:
    """Measure what a process of its own costs."""
    return [*await _calls(), await _cpu(), *await _starts(), await _idle()]


async def _calls() -> list[Row]:
    found: list[Row] = []
    calls, bench = placed(Calls(name="calls")), Bench()
    async with esair.Robot(
        resources=parts(), behaviors=[calls, Taker(name="taker"), bench]
    ) as robot:

        def measure(what: str) -> Callable[[], Awaitable[float]]:
            async def call() -> float:
                act = what, 20 if harness.smoke else COUNT
                await robot.behaviors.put(act, sender="user", receiver="calls")
                return await bench.found.get()

            return call

        for what, goal in (("read", 12), ("put", 12), ("write", 18), ("ask", 25)):
            mine, limit, ratio = await neighbors(
                measure(what), lambda: future_round_trip(1000)
            )
            case = f"P23 a placed behavior's {what}, F"
            found.append(Row(case, us(mine), us(limit), ratio, goal))
    return found


async def _cpu_of_steps(kind: Any, *, in_child: bool) -> float:
    """Return which part of a core the robot and a behavior with 100 steps/s use."""
    steps = kind(name="steps")
    if in_child:
        placed(steps)
    seconds = 0.3 if harness.smoke else SECONDS
    async with esair.Robot(resources=parts(), behaviors=[steps]) as robot:
        await asyncio.sleep(0.3)
        pid = robot.behaviors.query("steps").pid
        theirs = 0.0 if pid is None else cpu_of(pid)
        begin, cpu = time.perf_counter(), time.process_time()
        await asyncio.sleep(seconds)
        theirs = 0.0 if pid is None else cpu_of(pid) - theirs
        cpu = time.process_time() - cpu
        return (cpu + theirs) / (time.perf_counter() - begin)


async def _cpu() -> Row:
    child, thread, ratio = await neighbors(
        lambda: _cpu_of_steps(Steps, in_child=True),
        lambda: _cpu_of_steps(ThreadSteps, in_child=False),
        3,
    )
    case = "P23 CPU of 100 steps/s, a process / a thread"
    return Row(case, percent(child), percent(thread), ratio, 1.5)


async def _starts() -> list[Row]:
    walls, cpus, sizes = [], [], []
    async with esair.Robot(resources=parts(), behaviors=[Idle(name="first")]) as robot:
        for _ in repeated(STARTS):
            own = time.process_time()
            begin = time.perf_counter()
            await robot.behaviors.add(Idle(name="idle"))
            walls.append(time.perf_counter() - begin)
            own = time.process_time() - own
            pid = robot.behaviors.query("idle").pid
            assert pid is not None
            cpus.append(own + cpu_of(pid))
            await asyncio.sleep(0.05)
            sizes.append(private_of(pid))
            await robot.behaviors.remove("idle")
    wall, cpu, size = (statistics.median(each) for each in (walls, cpus, sizes))
    megabytes = size / (1 << 20)
    return [
        Row("P23 add of a placed behavior", ms(wall), "40 ms", wall / 0.04, 1),
        Row("P23 CPU of that", ms(cpu), "25 ms", cpu / 0.025, 1),
        Row(
            "P23 its private memory", f"{megabytes:.1f} MB", "10 MB", megabytes / 10, 1
        ),
    ]


async def _idle() -> Row:
    seconds = 0.3 if harness.smoke else SECONDS
    behaviors = [Idle(name=f"idle_{each}") for each in range(IDLE)]
    async with esair.Robot(resources=parts(), behaviors=behaviors) as robot:
        await asyncio.sleep(0.5)
        pids = [robot.behaviors.query(each.name).pid for each in behaviors]
        begin, cpu = time.perf_counter(), time.process_time()
        before = sum(cpu_of(pid) for pid in pids if pid is not None)
        await asyncio.sleep(seconds)
        theirs = sum(cpu_of(pid) for pid in pids if pid is not None) - before
        cpu = time.process_time() - cpu
        share = (cpu + theirs) / (time.perf_counter() - begin)
    return Row(
        f"P23 {IDLE} idle placed behaviors", percent(share), "2 %", share / 0.02, 1
    )
