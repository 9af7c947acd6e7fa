"""The watchdog's process, with real processes and a real line.

What counts is the last thing on the wire: looked at from the far end.
"""

from __future__ import annotations

import contextlib
import os
import re
import select
import signal
import statistics
import subprocess
import sys
import time
import tty
from contextlib import nullcontext
from pathlib import Path

import pytest
from tests.patience import TRIES
from tests.watchdog.cgroups import cgroup_of, killed_in

from esair.watchdog import SafeFrames, can_frame

pytestmark = pytest.mark.real_clock

VICTIM = Path(__file__).with_name("victim.py")
DEAD = ["kill", "segfault", "abort"]
STUCK = ["stop", "spin", "sleep", "regex"]
OOM_BYTES = 96 * 2**20
"""Both processes at rest take some sixty: with hardly more they never come to drive."""


class Run:
    """One victim, from the far end of its line."""

    def __init__(
        self, way: str, policy: str = "kill", *more: str, program: Path = VICTIM
    ) -> None:
        self.far, self.near = os.openpty()
        tty.setraw(self.near)
        self.received: list[tuple[float, bytes]] = []
        words = [str(program), os.ttyname(self.near), way, policy, *more]
        self.process = subprocess.Popen(
            [sys.executable, *words], stderr=subprocess.PIPE, text=True
        )
        self.pidfd = os.pidfd_open(self.process.pid)
        self.died = 0.0

    def hear(self, until: float, quiet: float = 0.3) -> None:
        """Listen until the process has ended and the line is quiet."""
        last = time.monotonic()
        while time.monotonic() < until:
            pidfds = [] if self.died else [self.pidfd]
            ready = select.select([self.far, *pidfds], [], [], 0.01)[0]
            if self.pidfd in ready:
                self.died = time.monotonic()
            if self.far in ready:
                last = self.read()
            elif not pidfds and time.monotonic() - last > quiet:  # dead before it
                return

    def read(self) -> float:
        now = time.monotonic()
        self.received.append((now, os.read(self.far, 4096)))
        return now

    @property
    def data(self) -> bytes:
        return b"".join(data for _, data in self.received)

    def close(self) -> str:
        with contextlib.suppress(ProcessLookupError):
            os.kill(self.process.pid, signal.SIGKILL)
        _, errors = self.process.communicate(timeout=60.0)  # the watchdog's last line
        while select.select([self.far], [], [], 0.0)[0]:
            self.read()
        for descriptor in (self.far, self.near, self.pidfd):
            os.close(descriptor)
        return errors

    def took(self, *, since_death: bool = False) -> float:
        """From the last motion, or the end of the process, to the safe command, in ms."""
        motion = max(when for when, data in self.received if b"GO" in data)
        safe = max(when for when, data in self.received if b"STOP" in data)
        return (safe - (self.died if since_death else motion)) * 1000


def run(*words: str, program: Path = VICTIM) -> tuple[Run, str]:
    victim = Run(*words, program=program)
    try:
        victim.hear(time.monotonic() + 60.0)
    finally:
        errors = victim.close()
    return victim, errors


@pytest.mark.promise("GRD-1")
@pytest.mark.fault("O04", "O08", "O09", "B07", "B08")
@pytest.mark.parametrize("way", [*DEAD, *STUCK])
def test_safe_is_the_last_thing_on_the_wire(way: str) -> None:
    """However the process dies or hangs, and with a motion that was cut in half."""
    tells = way in STUCK and way != "stop"  # that one tells nothing any more
    for _ in range(TRIES):
        victim, errors = run(way)
        # What was cut in half is ended by an empty line, or was thrown away with the queue.
        assert victim.data.endswith((b"GO\nGO\nSTOP\n", b"GO\n\nSTOP\n"))
        assert "esair watchdog: " in errors
        assert "wheels safe" in errors
        assert ("no turn for " in errors) is (way in STUCK)
        # Whoever has no processor for half of the limit cannot say what it executes.
        told = bool(re.search(r'in File ".*victim.py", line \d+ in die: ', errors))
        if told is tells:
            break
    assert told is tells


@pytest.mark.promise("GRD-1")
@pytest.mark.fault("O04", "O12")
def test_the_watchdog_outlives_a_robot_that_is_out_of_memory() -> None:
    """The kernel kills the one that has taken it all, in a group that both belong to."""
    for _ in range(TRIES):
        with cgroup_of(OOM_BYTES) as group:
            victim, errors = run("oom", "kill", str(group))
            assert victim.process.returncode == -signal.SIGKILL
            assert killed_in(group) == 1
        assert victim.data.endswith(b"STOP\n")
        # On a busy computer the kernel is not soon done with a process that is so large:
        # then the end of its line is seen before its own.
        if "its robot is gone, its process is not: wheels safe" not in errors:
            break
    assert re.fullmatch(
        r"esair watchdog: its process died: wheels safe, after .*\n", errors
    )


@pytest.mark.promise("GRD-3")
def test_an_orderly_exit_leaves_no_watchdog() -> None:
    """Nothing is sent by it, nothing is said, and its process is gone."""
    victim, errors = run("end")
    assert victim.process.returncode == 0
    assert victim.data.count(b"STOP") == 1
    assert errors == ""
    assert dogs_of(victim.process.pid) == []


@pytest.mark.fault("O05")
def test_a_frozen_process_stays_stopped() -> None:
    """By policy it is left for somebody to look at, and it does not move again."""
    victim = Run("sleep", "freeze")
    try:
        end = time.monotonic() + 60.0
        while b"STOP" not in victim.data and time.monotonic() < end:
            victim.hear(time.monotonic() + 0.2)
        assert victim.data.endswith(b"STOP\n")
        about, state = Path(f"/proc/{victim.process.pid}/stat"), ""
        while state != "T" and time.monotonic() < end:  # it stops when it has its turn
            victim.hear(time.monotonic() + 0.05)
            state = about.read_text("ascii").rpartition(")")[2].split()[0]
        assert state == "T"
        assert victim.data.endswith(b"STOP\n")
    finally:
        victim.close()


FORK = """
    if not os.fork():
        try:
            dog.close().send(None)
        finally:
            time.sleep(2)
            os._exit(0)
    for number"""


@pytest.mark.long
@pytest.mark.fault("O14")
def test_a_child_that_holds_everything_open_hides_no_death() -> None:
    """The pidfd tells, not the end of a pipe; and its good-bye is not the robot's."""
    source = VICTIM.read_text("utf-8").replace("\n    for number", FORK)
    changed = VICTIM.with_name("victim_that_forks.py")
    changed.write_text(source, "utf-8")
    try:
        victim, _ = run("kill", program=changed)
    finally:
        changed.unlink()
    assert victim.data.endswith(b"STOP\n")
    assert victim.took() < 500.0


def test_it_is_a_small_program() -> None:
    """Standard library only, at most 150 lines of code; nothing of esair."""
    import ast

    import esair.watchdog

    path = Path(esair.watchdog.__file__).with_name("_program.py")
    tree = ast.parse(path.read_text("utf-8"))
    lines = {
        node.lineno
        for node in ast.walk(tree)
        if isinstance(node, ast.stmt) and not isinstance(node, ast.Expr)
    }
    names = {
        alias.name
        for n in ast.walk(tree)
        if isinstance(n, ast.Import)
        for alias in n.names
    }
    assert len(lines) <= 150
    assert names <= sys.stdlib_module_names


def test_frames_of_can_are_those_of_the_kernel() -> None:
    """Sixteen bytes: identifier with its flag, length, data."""
    assert can_frame(0x123, b"\1\2") == b"\x23\1\0\0\2\0\0\0\1\2\0\0\0\0\0\0"
    assert can_frame(0x123, b"", extended=True)[:4] == b"\x23\1\0\x80"
    assert len(can_frame(1, b"", fd=True)) == 72


def test_frames_are_kept_as_a_tuple() -> None:
    """A list that is changed afterwards changes nothing."""
    frames = [b"STOP"]
    safe = SafeFrames(frames)
    frames.append(b"GO")
    assert safe.frames == (b"STOP",)


def dogs_of(pid: int) -> list[str]:
    """Return the watchdogs of a process that are still there."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):  # it has just ended
            words = (folder / "cmdline").read_bytes().split(b"\0")
            if str(pid).encode() in words and b"_program.py" in b"".join(words):
                found.append(folder.name)
    return found


@pytest.mark.promise("GRD-3")
def test_two_hundred_orderly_exits(request: pytest.FixtureRequest) -> None:
    """Each says nothing, sends nothing, and leaves no watchdog after a tenth of a second."""
    if not request.config.getoption("--esair-soak"):
        pytest.skip("two hundred processes each: --esair-soak")
    for _ in range(200):
        victim, errors = run("end")
        assert victim.process.returncode == 0
        assert victim.data.count(b"STOP") == 1
        assert errors == ""
        assert dogs_of(victim.process.pid) == []


@pytest.mark.promise("GRD-3")
@pytest.mark.parametrize("way", [*DEAD, "oom", *STUCK])
def test_the_time_it_takes(way: str, request: pytest.FixtureRequest) -> None:
    """Two hundred times: always safe; the times are printed, and bounded loosely."""
    if not request.config.getoption("--esair-soak"):
        pytest.skip("two hundred processes each: --esair-soak")
    times = []
    for _ in range(200):
        with cgroup_of(OOM_BYTES) if way == "oom" else nullcontext() as group:
            victim, said = run(way, "kill", *([] if group is None else [str(group)]))
        assert victim.data.endswith(b"STOP\n"), said
        # Before it kills, the kernel looks for memory elsewhere, and that takes long.
        times.append(victim.took(since_death=way == "oom"))
    times.sort()
    middle, slow = statistics.median(times), times[197]
    sys.stderr.write(f"{way}: p50 {middle:.1f} ms, p99 {slow:.1f} ms\n")
    assert slow < (1000.0 if way in STUCK else 500.0)
