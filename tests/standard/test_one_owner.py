"""What belongs to a loop or to the process has one owner there, counted."""

from __future__ import annotations

import asyncio
import contextvars
import gc
import signal
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import pytest

import esair

pytestmark = pytest.mark.virtual_clock

MINE: contextvars.ContextVar[str] = contextvars.ContextVar("mine", default="none")


def whole_process() -> tuple[Any, ...]:
    """What a robot may not leave changed."""
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGURG)
    return (
        *(signal.getsignal(number) for number in numbers),
        gc.get_threshold(),
        gc.get_freeze_count(),
        asyncio.get_running_loop().get_task_factory(),
    )


@pytest.mark.long
@pytest.mark.promise("ROB-5")
async def test_robots_that_overlap_leave_nothing_behind(request: Any) -> None:
    """Rolling restarts: each starts before the one before it ends."""
    before, threads = whole_process(), threading.active_count()
    old = await esair.Robot().__aenter__()
    for _ in range(10_000 if request.config.getoption("--esair-soak") else 1_500):
        new = await esair.Robot().__aenter__()
        await old.__aexit__(None, None, None)
        await asyncio.ensure_future(asyncio.sleep(0))
        old = new
    await old.__aexit__(None, None, None)
    assert whole_process() == before
    assert threading.active_count() == threads


@pytest.mark.promise("ROB-5")
async def test_the_end_of_one_changes_nothing_for_the_other(fake_actuator: Any) -> None:
    """Its tasks are still owned, its signals still heard."""
    wheels = fake_actuator("wheels", safe=0.0)

    class Drive(esair.Behavior):
        wheels = esair.writes(float)

        async def run(self) -> None:
            asyncio.ensure_future(asyncio.sleep(1000)).set_name("child")
            await self.wheels.write(1.0, hold=100.0)
            await asyncio.sleep(1000)

    async with esair.Robot(name="first"):
        second = esair.Robot(name="second", resources=[wheels], behaviors=[Drive()])
        await second.__aenter__()
    assert signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL
    await wheels.until(1.0)
    await second.behaviors.remove("drive")
    names = {task.get_name() for task in asyncio.all_tasks()}
    assert "child" not in names
    await second.__aexit__(None, None, None)
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL


@pytest.mark.promise("ROB-5")
async def test_behaviors_begin_with_the_variables_of_the_script() -> None:
    """In a task, in a task of a task, and in a thread; nobody sees another's."""
    seen: list[str] = []

    class Look(esair.Behavior):
        async def run(self) -> None:
            async def child() -> None:
                seen.append(MINE.get())

            MINE.set(f"{MINE.get()} of {self.name}")
            await asyncio.ensure_future(child())

    class Thread(esair.Behavior):
        def run(self) -> None:
            seen.append(MINE.get())

    MINE.set("the script's")
    async with esair.Robot(
        behaviors=[Look(name="one"), Look(name="two"), Thread()]
    ) as robot:
        await robot.ended()
    assert sorted(seen) == [
        "the script's", "the script's of one", "the script's of two",
    ]  # fmt: skip


@pytest.mark.promise("ROB-5")
async def test_tools_see_the_name_and_the_stack_of_a_task() -> None:
    """A task of a component looks like any other one."""
    stacks: list[Any] = []

    async def its_own_work() -> None:
        await asyncio.sleep(1.0)

    class Child(esair.Behavior):
        async def run(self) -> None:
            task = asyncio.ensure_future(its_own_work())
            await asyncio.sleep(0.1)
            stacks.extend(task.get_stack())
            stacks.append(repr(task))
            await task

    async with esair.Robot(behaviors=[Child()]) as robot:
        await robot.ended()
    assert [frame.f_code.co_name for frame in stacks[:-1]] == ["its_own_work"]
    assert "its_own_work" in stacks[-1]


@pytest.mark.promise("ROB-5")
async def test_a_cancelled_scope_of_anyio_does_not_make_the_stop_spin(
    fake_actuator: Any,
) -> None:
    """The stop takes the turns that it needs, and the scope ends as it should."""
    import anyio

    hurried: list[float] = []

    class Slow(esair.Behavior):
        async def teardown(self) -> None:
            await asyncio.sleep(0.5)
            hurried.append(asyncio.get_running_loop().time())

    with anyio.move_on_after(1.0) as scope:
        async with esair.Robot(
            resources=[fake_actuator("wheels", safe=0.0)], behaviors=[Slow()]
        ) as robot:
            await asyncio.sleep(100)
    assert scope.cancelled_caught
    assert robot.stopped[0].safe
    assert len(hurried) == 1  # it was not cancelled again and again


@pytest.mark.real_clock
@pytest.mark.promise("ROB-5")
async def test_where_no_signal_is_heard_it_is_said(caplog: Any) -> None:
    """In another thread than the main one, unless a robot is in that."""

    async def short() -> None:
        async with esair.Robot(name="away"):
            pass

    await asyncio.to_thread(asyncio.run, short())
    assert "no signal stops it" in caplog.text
    caplog.clear()
    async with esair.Robot(name="here"):
        await asyncio.to_thread(asyncio.run, short())
    assert not caplog.records


@pytest.mark.real_clock
@pytest.mark.promise("ROB-5")
async def test_robots_of_several_threads_leave_nothing_behind() -> None:
    """They begin and end at once, and nobody is forgotten, or watched for ever."""

    class Short(esair.Behavior):
        async def run(self) -> None:
            """Be done at once."""

    def some() -> None:
        for _ in range(4):
            esair.run(esair.Robot(behaviors=[Short()]))

    await asyncio.gather(*(asyncio.to_thread(some) for _ in range(6)))
    assert "esair-overseer" not in [each.name for each in threading.enumerate()]


OUTLIVED = """
import asyncio, os, pathlib, signal, sys, threading, time
import esair

async def longer():
    async with esair.Robot(name="away"):
        await asyncio.sleep(0.3)

class Short(esair.Behavior):
    async def run(self):
        away.start()
        await asyncio.sleep(0.1)

away = threading.Thread(target=lambda: asyncio.run(longer()))
esair.run(esair.Robot(name="here", behaviors=[Short()]))
away.join()
files = [open(f"{sys.argv[1]}/{n}", "wb") for n in range(8)]
try:
    signal.raise_signal(signal.SIGINT)
    time.sleep(5)
except KeyboardInterrupt:
    print(sum(os.path.getsize(file.name) for file in files))
"""


@pytest.mark.real_clock
@pytest.mark.promise("ROB-5")
def test_a_robot_of_another_thread_that_ends_last_gives_the_signals_back(
    tmp_path: Path,
) -> None:
    """Ctrl-C interrupts the program again, and no byte of it goes to a file of others."""
    done = subprocess.run(
        [sys.executable, "-c", OUTLIVED, str(tmp_path)],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.stdout == "0\n", done.stderr
