"""The collector works in the gaps, and takes little of them."""

from __future__ import annotations

import collections
import gc
import json
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from esair.loop import _garbage
from esair.loop._garbage import Collector

pytestmark = pytest.mark.real_clock


@pytest.fixture
def collector(monkeypatch: pytest.MonkeyPatch) -> Iterator[Collector]:
    """One for which each collection is a long one."""
    monkeypatch.setattr(_garbage, "LONG", 0.0)
    monkeypatch.setattr(_garbage, "_USUAL", 1e-12)
    collector = Collector()
    collector.start()
    collector.is_up()
    yield collector
    collector.is_down()
    collector.stop()


@pytest.mark.long
@pytest.mark.promise("ROB-7")
def test_what_is_set_aside_is_not_even_counted(collector: Collector) -> None:
    """A collection takes less than it would take to count what it need not look at."""
    held = [[number] for number in range(300_000)]
    gc.freeze()
    collected = min(cost(collector.collect) for _ in range(5))
    counted = min(cost(gc.get_freeze_count) for _ in range(5))
    assert collected < counted
    assert len(held) == 300_000


@pytest.mark.long
@pytest.mark.promise("ROB-7", "ROB-2")
@pytest.mark.parametrize(("stops", "looks"), [(False, True), (True, False)])
def test_nothing_is_looked_at_while_a_robot_stops(*, stops: bool, looks: bool) -> None:
    """What it takes to stop is kept: a look at it would only come before safe."""
    held = [[number] for number in range(500_000)]
    collector = Collector()
    collector.start()
    collector.is_up()
    if stops:
        collector.is_down()
    collections = gc.get_stats()[2]["collections"]
    held += [[number] for number in range(150_000)]
    assert (gc.get_stats()[2]["collections"] > collections) is looks
    if not stops:
        collector.is_down()
    collector.stop()
    assert len(held) == 650_000


@pytest.mark.promise("ROB-7")
@pytest.mark.parametrize(("grown", "looks"), [(1.9, False), (2.1, True)])
def test_all_is_looked_at_when_there_is_twice_as_much(
    monkeypatch: pytest.MonkeyPatch, grown: float, looks: bool
) -> None:
    """What became garbage after it was set aside is collected then, and not before.

    A look takes as long as the whole program is large, so that it may not come when a
    large one has grown by a little: a robot of a thousand sensors fills its histories.
    """
    monkeypatch.setattr(_garbage, "LONG", 0.0)  # each collection is a long one
    monkeypatch.setattr(_garbage, "_USUAL", 1e-12)
    monkeypatch.setattr(sys, "getallocatedblocks", lambda: 1_000_000)
    collector = Collector()
    collector.start()
    collector.is_up()
    circle: list[object] = []
    circle.append(circle)
    held = [[number] for number in range(50_000)]
    monkeypatch.setattr(sys, "getallocatedblocks", lambda: round(grown * 1_000_000))
    collector.collect()  # sets it aside
    del circle
    before = collector.collected
    collector.collect()
    assert (collector.collected > before) is looks
    collector.is_down()
    collector.stop()
    assert len(held) == 50_000


@pytest.mark.promise("ROB-7")
def test_what_came_is_not_taken_for_less() -> None:
    """The pause of a collection is bounded by it; most has died young meanwhile."""
    alive: collections.deque[object] = collections.deque(maxlen=4_000)
    collector = Collector()
    collector.start()
    collector.is_up()
    gc.collect()
    collector.is_down()  # it tells the interpreter anew, and begins to count
    for _ in range(100_000):
        circle: list[object] = []
        circle.append(circle)
        alive.append(circle)
    came = collector.came()
    assert gc.collect() <= came <= 60_000  # those that are alive, too
    collector.stop()


LITTER = """
import asyncio, collections, gc, json, os, time
from pathlib import Path
import esair

RATE, SECONDS, ALIVE, PAUSE = {rate}, {seconds}, {alive}, {pause!r}
began, longest = 0.0, 0.0

def see(phase, info):
    global began, longest
    if phase == "start":
        began = time.thread_time()
    elif info["generation"] == 2:
        longest = max(longest, time.thread_time() - began)

def resident():
    return int(Path("/proc/self/statm").read_text().split()[1])

class Beat(esair.Behavior):
    async def run(self):
        async for _ in esair.every(0.01):
            pass

class Litter(esair.Behavior):
    {define} run(self):
        {up}  # so that the robot runs
        gc.callbacks.append(see)
        alive = collections.deque(maxlen=ALIVE)
        start, most, made, begin = resident(), 0, 0, time.monotonic()
        looked = 0
        while made < RATE * SECONDS:
            due = min(time.monotonic() - begin, SECONDS) * RATE
            while made < due:
                circle = []
                circle.append(circle)
                alive.append(circle)
                made += 1
            if made - looked > 2_000:  # a look takes as long as many circles
                most, looked = max(most, resident()), made
            {pause}
        print(json.dumps(dict(start=start, most=most, longest=longest, made=made,
              freed=sum(each["collected"] for each in gc.get_stats()),
              **robot.journal.counts()["collector"])), flush=True)
        os._exit(0)

robot = esair.Robot(behaviors=[Beat(), Litter()])
esair.run(robot, stall_warning=None)
"""

HOW = {
    "in gaps": ("async def", "await asyncio.sleep(0.002)"),
    "without gaps": ("async def", "await asyncio.sleep(0)"),
    "in a thread": ("def", "time.sleep(0.002)"),
    "held up": ("async def", "pass"),
}


def litter(how: str, rate: int, seconds: float, alive: int) -> dict[str, Any]:
    """Run a robot in whose process circles become garbage; return what was seen."""
    define, pause = HOW[how]
    up = "time.sleep(0.3)" if define == "def" else "await asyncio.sleep(0.3)"
    code = LITTER.format(
        rate=rate, seconds=seconds, alive=alive, define=define, pause=pause, up=up
    )
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code)],
        capture_output=True,
        timeout=seconds + 30.0,
        check=False,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    seen: dict[str, Any] = json.loads(done.stdout)
    return seen


@pytest.mark.long
@pytest.mark.promise("ROB-7")
@pytest.mark.parametrize(
    "how",
    [
        "in gaps",
        *(pytest.param(h, marks=pytest.mark.long) for h in HOW if h != "in gaps"),
    ],
)
@pytest.mark.parametrize("alive", [1_000, pytest.param(20_000, marks=pytest.mark.long)])
def test_the_pile_does_not_grow(request: Any, how: str, alive: int) -> None:
    """Wherever the garbage is made, memory is bounded, and so is the longest pause."""
    seconds = 60.0 if request.config.getoption("--esair-soak") else 2.5
    seen = litter(how, 167_000, seconds, alive)
    assert seen["made"] >= 167_000 * seconds
    assert seen["most"] < 3 * seen["start"], seen
    assert seen["longest"] < 0.05, seen
    assert seen["freed"] > seen["made"] / 2, seen  # young ones the interpreter itself


@pytest.mark.long
@pytest.mark.promise("ROB-7")
def test_what_comes_too_fast_is_collected_in_the_midst_and_counted() -> None:
    """Of code that never lets go of the loop, with the pause in which it is bounded."""
    seen = litter("held up", 400_000, 1.0, 50_000)  # none of them dies young
    assert seen["forced"] > 0
    assert seen["most"] < 3 * seen["start"], seen
    assert 0 < seen["longest_forced_us"] < 50_000


def cost(function: Callable[[], object]) -> float:
    """Return what a call takes of this thread, in seconds."""
    began = time.thread_time()
    function()
    return time.thread_time() - began
