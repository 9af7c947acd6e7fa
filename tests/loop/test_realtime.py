"""A robot in real time: its loop goes first, and says so where it may not."""

from __future__ import annotations

import asyncio
import json
import os
import subprocess
import sys
from typing import Any

import pytest

import esair
from esair.loop import check_priority, refusal
from esair.testing import VirtualLoop

pytestmark = pytest.mark.real_clock

allowed = pytest.mark.skipif(
    bool(refusal(50)), reason=f"real time is not to be had here: {refusal(50)}"
)

SEEN = """
import asyncio, json, logging, os, subprocess, sys, threading
import esair
from esair.loop._overseer import overseer

said = []

class Kept(logging.Handler):
    def emit(self, record):
        if "real time" in record.getMessage():
            said.append(record.getMessage())

logging.getLogger("esair").addHandler(Kept())

def seen():
    found = {}
    for each in os.listdir("/proc/self/task"):
        policy = os.sched_getscheduler(int(each)) & ~os.SCHED_RESET_ON_FORK
        rank = os.sched_getparam(int(each)).sched_priority
        name = [t.name for t in threading.enumerate() if t.native_id == int(each)]
        found[(name or ["?"])[0]] = [policy == os.SCHED_FIFO, rank]
    with open("/proc/self/status") as file:
        locked = [line.split()[1] for line in file if line.startswith("VmLck")]
    found["locked"] = int(locked[0]) > 0
    found["switch"] = sys.getswitchinterval()
    return found

class Wait(esair.ThreadBehavior):
    def run(self):
        threading.Event().wait(0.6)

class Motor(esair.Actuator[float]):
    safe = 0.0
    async def write(self, command): ...
    def safe_frames(self): return ()

class Steps(esair.Reaction):
    rate = 100.0
    def react(self): ...

async def main():
    found = {"before": seen()}
    robot = esair.Robot(behaviors=[Wait(), Steps()], realtime=REALTIME, watchdog=True)
    async with robot:
        await asyncio.sleep(0.3)
        found["during"] = seen()
        child = "import os; print(os.sched_getscheduler(0))"
        found["child"] = subprocess.check_output([sys.executable, "-c", child], text=True)
        found["steps"] = robot.behaviors.query("steps").steps
        pid = robot._keeper.watchdog._process.pid
        found["watchdog"] = [os.sched_getscheduler(pid), os.sched_getparam(pid)[0]]
    found["after"] = seen()
    found["said"] = said
    print(json.dumps(found))

asyncio.run(main())
"""


def run(program: str, realtime: object, before: str = "") -> Any:
    """Run the program in a process of its own; returns what it has seen."""
    text = f"{before}\nREALTIME = {realtime!r}\n{program}"
    done = subprocess.run(
        [sys.executable, "-c", text], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


@pytest.mark.long
@allowed
@pytest.mark.parametrize(("realtime", "priority"), [(True, 50), (7, 7)])
def test_the_thread_of_the_loop_goes_first(realtime: object, priority: int) -> None:
    """What watches it goes before it; others stay, and all is as it was at the end."""
    found = run(SEEN, realtime)
    during = found["during"]
    assert during["MainThread"] == [True, priority]
    assert during["esair-overseer"] == [True, priority + 1]
    assert found["watchdog"][1] == priority + 1
    assert during["locked"]
    assert during["switch"] < found["before"]["switch"]
    rest = {
        name: each
        for name, each in during.items()
        if name not in {"MainThread", "esair-overseer", "locked", "switch"}
    }
    assert rest  # the thread of the behavior
    assert {tuple(each) for each in rest.values()} == {(False, 0)}
    assert int(found["child"]) == os.SCHED_OTHER
    for moment in ("before", "after"):
        assert found[moment]["MainThread"] == [False, 0]
        assert not found[moment]["locked"]
    assert found["after"]["switch"] == found["before"]["switch"]
    assert found["said"] == []


WITHOUT = """
import ctypes, os, sys
if "again" not in os.environ:
    libc = ctypes.CDLL(None)
    for capability in (14, 23):  # of root: IPC_LOCK and SYS_NICE
        libc.prctl(24, capability, 0, 0, 0)
    os.environ["again"] = "yes"
    os.execv(sys.executable, [sys.executable, "-c", *sys.orig_argv[2:]])
"""


@pytest.mark.long
def test_where_it_may_not_one_line_says_what_to_do() -> None:
    """The robot runs as it would without."""
    found = run(SEEN, True, WITHOUT)
    (said,) = found["said"]
    assert said.startswith("robot 'robot': not in real time: ")
    if os.geteuid() == 0:
        assert "--cap-add=SYS_NICE" in said
    else:
        assert "sudo prlimit --pid $$ --rtprio=51 --memlock=unlimited" in said
    assert found["during"]["MainThread"] == [False, 0]
    assert found["during"]["switch"] == found["before"]["switch"]
    assert not found["during"]["locked"]
    assert found["steps"] > 5


def test_what_a_user_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """The command is for the shell that he sits at, and names the watchdog's priority."""

    def refused(*_: object) -> None:
        raise PermissionError

    monkeypatch.setattr(os, "sched_setscheduler", refused)
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    assert "sudo prlimit --pid $$ --rtprio=61 --memlock=unlimited" in refusal(60)


@pytest.mark.parametrize("wrong", [0, 99, -1, 1.5, "yes", None])
def test_what_is_no_priority_is_refused(wrong: Any) -> None:
    with pytest.raises(esair.ConfigError, match=r"realtime.*priority of 1 to 98"):
        esair.Robot(realtime=wrong)
    assert check_priority("a", False) is None


def test_on_the_virtual_clock_nothing_changes() -> None:
    """Time passes there by itself."""
    before = os.sched_getscheduler(0)

    async def main() -> int:
        async with esair.Robot(realtime=True):
            return os.sched_getscheduler(0)

    with asyncio.Runner(loop_factory=VirtualLoop) as runner:
        assert runner.run(main()) == before
