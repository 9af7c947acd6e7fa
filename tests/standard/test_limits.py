"""What happens at the limits of a process: descriptors, threads."""

from __future__ import annotations

import ast
import asyncio
import contextlib
import os
import resource
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

import esair
from esair.drivers.line import LineActuator, LineSensor
from esair.drivers.line.fake import FakeBoard
from esair.loop import Executor
from esair.testing import FakeSerial

READY, LOST = esair.ResourceState.READY, esair.ResourceState.LOST


async def until(condition: Callable[[], bool]) -> None:
    async with asyncio.timeout(10.0):
        while not condition():  # noqa: ASYNC110 - nobody tells
            await asyncio.sleep(0.01)


@contextlib.contextmanager
def no_descriptors_left() -> Iterator[None]:
    """Let nobody in this process open anything."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    first_free = os.dup(0)
    os.close(first_free)
    resource.setrlimit(resource.RLIMIT_NOFILE, (first_free, hard))
    taken: list[int] = []
    try:
        with contextlib.suppress(OSError):
            while True:
                taken.append(os.dup(0))
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
        for each in taken:
            os.close(each)


@contextlib.contextmanager
def no_more_threads() -> Iterator[None]:
    """Let nobody in this process start a thread."""
    start = threading.Thread.start

    def refuse(_: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    threading.Thread.start = refuse  # type: ignore[method-assign, assignment]
    try:
        yield
    finally:
        threading.Thread.start = start  # type: ignore[method-assign]


class Drive(esair.Behavior):
    """Drives while it sees, and at once when not."""

    speed = esair.writes(float)

    async def run(self) -> None:
        async for _ in esair.every(0.02):
            await self.speed.write(0.5)


@pytest.mark.real_clock
@pytest.mark.fault("O11")
@pytest.mark.parametrize("comes_back", [True, False])
async def test_out_of_descriptors(comes_back: bool) -> None:
    """What is open works on and ends safe; what needs one waits until there are some."""
    wheels, eyes = FakeSerial("wheels"), FakeSerial("eyes")
    FakeBoard(wheels, {}, {"speed": 0.0})
    FakeBoard(eyes, {"sight": 1.0}, {}, period=0.02)
    robot = esair.Robot(
        resources=[
            LineSensor(name="sight", bus=eyes),
            LineActuator(name="speed", safe=0.0, bus=wheels),
        ],
        behaviors=[Drive()],
    )
    with contextlib.ExitStack() as limits:
        async with robot:
            await wheels.until(b"speed=0.5", timeout=10.0)
            limits.enter_context(no_descriptors_left())
            eyes.unplug()
            eyes.plug()
            await until(lambda: robot.resources.query("sight").state is LOST)
            wheels.sent.clear()
            await wheels.until(b"speed=0.5", timeout=10.0)
            if comes_back:
                limits.close()
                await until(lambda: robot.resources.query("sight").state is READY)
                assert robot.behaviors.query("drive").restarts == 0
    assert wheels.sent[-1] == b"speed=0"


@pytest.mark.real_clock
@pytest.mark.fault("O13")
async def test_a_lane_whose_thread_cannot_start_is_busy() -> None:
    """Nothing half-made is left: the next call starts it."""
    executor = Executor("bus")

    with no_more_threads(), pytest.raises(esair.BusyError, match="limit of threads"):
        await executor.call(int, "7", timeout=1.0)

    assert executor.waiting == 0
    assert await executor.call(int, "7", timeout=5.0) == 7
    executor.close()


class Plain(esair.Behavior):
    """A behavior that needs a thread."""

    speed = esair.writes(float)

    def run(self) -> None:
        for _ in esair.every(0.02):
            self.speed.write(0.5)  # type: ignore[unused-coroutine]


@pytest.mark.real_clock
@pytest.mark.fault("O13")
async def test_a_behavior_whose_thread_cannot_start_begins_later() -> None:
    """It is a failure of the behavior like any other; the robot goes on."""
    wheels = FakeSerial("wheels")
    FakeBoard(wheels, {}, {"speed": 0.0})
    resources = [LineActuator(name="speed", safe=0.0, bus=wheels)]
    async with esair.Robot(resources=resources) as robot:
        with no_more_threads():
            await robot.behaviors.add(Plain())
            await until(lambda: robot.behaviors.query("plain").restarts > 0)
            assert b"speed=0.5" not in wheels.sent

        await wheels.until(b"speed=0.5", timeout=10.0)
    assert wheels.sent[-1] == b"speed=0"


LIBRARIES = ["asyncio", "anyio"]  # `bus.wait_for` is another thing
CORE = ["actions", "connections", "loop", "resources", "supervisors", "buses", "abc.py"]


@pytest.mark.long
@pytest.mark.fault("X08")
@pytest.mark.parametrize("part", CORE)
def test_the_core_uses_nothing_that_loses_a_cancellation(part: str) -> None:
    """``wait_for`` and a nested ``TaskGroup`` do, in some versions of Python."""
    root = Path(esair.__file__).parent / part
    files = sorted(root.rglob("*.py")) if root.is_dir() else [root]
    names = {
        node.attr if isinstance(node, ast.Attribute) else node.id
        for file in files
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        if isinstance(node, ast.Name)
        or (isinstance(node, ast.Attribute) and ast.unparse(node.value) in LIBRARIES)
    }

    assert names
    assert not names & {"wait_for", "TaskGroup"}
