"""OPS: a stop beside a flood of settings, a seat that nobody uses, a page that is open."""

from __future__ import annotations

import asyncio
import contextlib
import os
import sys
import tempfile
import time
from collections.abc import AsyncIterator
from typing import Any

import esair
from benchmarks.cases.components import Meter
from benchmarks.harness import Row, cpu_share, ms, percent, percentile, repeated

STOPS = 200
SECONDS = 4.0

FLOOD = """
import time
from esair.seat import connect
with connect("bench") as client:
    begin, sent = time.monotonic(), 0
    while True:
        client.send("set", {"setting": "wheels.speed", "value": sent % 10 / 10})
        sent += 1
        for _ in client.lines(0.0):
            pass
        time.sleep(max(0.0, begin + sent / 1000 - time.monotonic()))
"""
"""A program that changes a setting 1,000 times a second."""

HAND = """
import sys, time
from esair.seat import connect
with connect("bench") as client:
    for _ in range(int(sys.argv[1])):
        time.sleep(0.01)
        begin = time.monotonic()
        client.do("stop")
        print(begin, flush=True)
        client.do("resume")
"""
"""A program that stops and resumes, and says when it began to stop."""

BROWSER = """
import json, sys
from websockets.sync.client import connect
host = sys.argv[1]
with connect(f"ws://{host}/operate", origin=f"http://{host}") as link:
    link.send(sys.argv[2])  # the token
    link.send(json.dumps({"v": 1, "id": "w", "act": "watch", "every": 0.25}))
    print("looks", flush=True)
    while True:
        link.recv()
"""
"""A program that looks at the page's pictures as a browser does."""


class Wheels(esair.Actuator[float]):
    """Notes when it was told its safe command."""

    safe = 0.0
    speed = esair.setting(0.5, min=0.0, max=1.0)

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.stopped: list[float] = []
        self.applied = 0

    async def apply(self, **_: object) -> None:
        self.applied += 1

    async def write(self, command: float) -> None:
        if command == self.safe:
            self.stopped.append(time.monotonic())


class Drive(esair.Behavior):
    """Writes a hundred times a second."""

    wheels = esair.writes(float)

    async def run(self) -> None:
        async for _ in esair.every(0.01):
            await self.wheels.write(1.0)


class Look(esair.Behavior):
    """Follows a sensor."""

    meter = esair.reads(float)

    def __init__(self, number: int) -> None:
        reads = {"meter": esair.reads(float, name=f"meter_{number}")}
        super().__init__(name=f"look_{number}", reads=reads)

    async def run(self) -> None:
        async for _ in self.meter:
            pass


def _robot(**options: Any) -> esair.Robot:
    return esair.Robot(
        name="bench",
        resources=[Wheels(), *(Meter(name=f"meter_{n}", rate=20.0) for n in range(10))],
        behaviors=[Drive(), *(Look(n) for n in range(10))],
        **options,
    )


async def rows() -> list[Row]:
    with tempfile.TemporaryDirectory() as folder:
        before = os.environ.get("XDG_RUNTIME_DIR")
        os.environ["XDG_RUNTIME_DIR"] = folder
        try:
            return [await _stop(), *await _shares()]
        finally:
            os.environ.pop("XDG_RUNTIME_DIR")
            if before is not None:
                os.environ["XDG_RUNTIME_DIR"] = before


@contextlib.asynccontextmanager
async def _program(text: str, *words: str) -> AsyncIterator[asyncio.subprocess.Process]:
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-c", text, *words, stdout=asyncio.subprocess.PIPE
    )
    try:
        yield process
    finally:
        with contextlib.suppress(ProcessLookupError):
            process.kill()
        await process.wait()


async def _stop() -> Row:
    """A stop from another process until the driver was told, by one clock."""
    count = len(repeated(STOPS))
    late: list[float] = []
    robot = _robot(socket=True)
    async with robot, _program(FLOOD), _program(HAND, str(count)) as hand:
        wheels: Any = robot.resources.get("wheels")
        assert hand.stdout is not None
        begun, applied = time.perf_counter(), wheels.applied
        async for line in hand.stdout:
            begin = float(line)
            late.append(next(each for each in wheels.stopped if each >= begin) - begin)
            wheels.stopped.clear()
        rate = (wheels.applied - applied) / (time.perf_counter() - begun)
    p99 = percentile(late, 0.99)
    note = f"{len(late)} stops, median {ms(percentile(late, 0.5))}; {rate:.0f} set/s"
    return Row(
        "OPS a stop to the wire, 1,000 set/s", ms(p99), "20 ms", p99 / 0.02, 1.0, note
    )


async def _shares() -> list[Row]:
    """What the seat costs beside what the robot does: with and without, in turn."""
    nobody, page = [], []
    for _ in repeated(5):
        async with _robot():
            bare = await cpu_share(SECONDS)
        async with _robot(socket=True):
            nobody.append(await cpu_share(SECONDS) - bare)
        robot = _robot(socket=True, page=esair.Page(port=0))
        async with robot:
            assert robot._seat.seat is not None
            host = f"127.0.0.1:{robot._seat.seat.port}"
            served = robot._seat.seat._page
            assert served is not None
            token = served.token
            async with _program(BROWSER, host, token) as browser:
                assert browser.stdout is not None
                await browser.stdout.readline()
                page.append(await cpu_share(SECONDS) - bare)
    found = []
    for name, shares, goal in (
        ("OPS a socket without a client", nobody, 0.005),
        ("OPS one page at 4 Hz, 22 components", page, 0.03),
    ):
        share = percentile(shares, 0.5)
        note = f"of a core; {percent(min(shares))} to {percent(max(shares))}"
        found.append(Row(name, percent(share), percent(goal), share / goal, 1.0, note))
    return found
