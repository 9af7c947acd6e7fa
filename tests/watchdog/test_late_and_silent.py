"""A watchdog that starts late, or falls silent: robots and watchdogs as processes.

What counts is what is on the line, looked at from the far end, and who has it open.
"""

from __future__ import annotations

import contextlib
import os
import random
import select
import signal
import subprocess
import sys
import time
import tty
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Literal

import pytest
from tests.watchdog.test_watchdog import dogs_of

from esair.watchdog import LIMIT

pytestmark = [pytest.mark.real_clock, pytest.mark.promise("GRD-4")]

ROBOT = Path(__file__).with_name("robot.py")
SLOW = """#!{python}
import os, sys, time
time.sleep({late})
os.execv({python!r}, [{python!r}, *sys.argv[1:]])
"""


class Driven:
    """A robot that drives for ever, and what came over its line."""

    def __init__(self, policy: str, **environment: str) -> None:
        self.far, self.near = os.openpty()
        tty.setraw(self.near)
        self.line = os.ttyname(self.near)
        self.process = subprocess.Popen(
            [sys.executable, str(ROBOT), self.line, "drive", policy],
            stderr=subprocess.PIPE,
            text=True,
            env=os.environ | environment,
        )
        self.heard: list[tuple[float, bytes]] = []

    def listen(self, until: float, quiet: float = 9.0) -> None:
        """Listen until then, or until the line is quiet."""
        last = time.monotonic()
        while (now := time.monotonic()) < until and now - last < quiet:
            if select.select([self.far], [], [], 0.02)[0]:
                last = time.monotonic()
                self.heard.append((last, os.read(self.far, 4096)))

    def moves(self) -> bool:
        return any(b"GO" in data for _, data in self.heard)

    def until_it_moves(self) -> None:
        end = time.monotonic() + 60.0
        while not self.moves() and time.monotonic() < end:
            self.listen(time.monotonic() + 0.02)
        assert self.moves()

    def dogs(self) -> list[int]:
        return [int(each) for each in dogs_of(self.process.pid)]

    def is_watched(self) -> bool:
        """Whether a watchdog has its line open."""
        for dog in self.dogs():
            with contextlib.suppress(OSError):
                folder = Path(f"/proc/{dog}/fd")
                if self.line in [os.readlink(each) for each in folder.iterdir()]:
                    return True
        return False

    def kill(self) -> float:
        self.process.kill()
        self.process.wait()  # it takes the kernel a moment, too
        return time.monotonic()

    @property
    def data(self) -> bytes:
        return b"".join(data for _, data in self.heard)

    def safe_since(self) -> float:
        """When the first safe command came after the last motion."""
        last = max(n for n, (_, data) in enumerate(self.heard) if b"GO" in data)
        if b"STOP" in self.heard[last][1].rpartition(b"GO")[2]:
            return self.heard[last][0]
        return min(when for when, data in self.heard[last + 1 :] if b"STOP" in data)

    def none_is_left(self) -> None:
        end = time.monotonic() + 5.0
        while self.dogs() and time.monotonic() < end:
            time.sleep(0.02)
        assert self.dogs() == []

    def close(self) -> str:
        with contextlib.suppress(ProcessLookupError):
            self.process.kill()
        _, said = self.process.communicate(timeout=10.0)
        for dog in self.dogs():
            with contextlib.suppress(ProcessLookupError):
                os.kill(dog, signal.SIGKILL)
        os.close(self.far)
        os.close(self.near)
        return said


def many(
    request: pytest.FixtureRequest,
    each: Callable[[float], object],
    few: list[float],
    soak: int,
    longest: float,
) -> None:
    """Do it with a few values; with many of them, at random, in a soak."""
    if not request.config.getoption("--esair-soak"):
        for value in few:
            each(value)
        return
    values = random.Random(4)
    with ThreadPoolExecutor(3) as pool:
        done = list(pool.map(each, [values.uniform(0, longest) for _ in range(soak)]))
    sys.stderr.write(f"{len(done)} of {soak}")
    times = sorted(one for one in done if isinstance(one, float))
    if times:
        middle, longest = times[len(times) // 2] * 1000, times[-1] * 1000
        sys.stderr.write(f", safe after {middle:.0f} ms, at most {longest:.0f} ms")
    sys.stderr.write("\n")


@pytest.mark.parametrize("policy", ["stop", "alarm"])
def test_nothing_moves_before_a_late_watchdog_has_armed_it(
    policy: Literal["stop", "alarm"], tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    """It is watched when it moves, and it moves when the watchdog has come."""

    def late_by(late: float) -> None:
        slow = tmp_path / f"slow-{late}"
        slow.write_text(SLOW.format(python=sys.executable, late=late), "utf-8")
        slow.chmod(0o700)
        began = time.monotonic()
        robot = Driven(policy, DOG=str(slow))
        try:
            robot.until_it_moves()
            assert robot.is_watched()
            assert time.monotonic() - began > late
            robot.kill()
            robot.listen(time.monotonic() + 5.0, quiet=0.4)
            assert robot.data.endswith(b"STOP\n")
            robot.none_is_left()
        finally:
            said = robot.close()
        assert "wheels: UNWATCHED" not in said
        assert "halted" not in said

    many(request, late_by, [1.5 if policy == "stop" else 0.4], 100, 5.0)


@pytest.mark.long
@pytest.mark.parametrize("policy", ["stop", "alarm"])
def test_a_silent_watchdog_is_noticed_and_replaced(
    policy: Literal["stop", "alarm"], request: pytest.FixtureRequest
) -> None:
    """Within two limits; "stop" is safe by then, "alarm" drives on, watched anew."""

    def silent_after(seconds: float) -> float | None:
        robot = Driven(policy)
        try:
            robot.until_it_moves()
            robot.listen(time.monotonic() + seconds)
            (dog,) = robot.dogs()
            stopped = time.monotonic()
            os.kill(dog, signal.SIGSTOP)
            robot.listen(stopped + 2 * LIMIT + 0.05)
            end = time.monotonic() + 20.0
            while (not robot.is_watched() or dog in robot.dogs()) and (
                time.monotonic() < end
            ):
                robot.listen(time.monotonic() + 0.05)
            assert robot.is_watched()
            assert dog not in robot.dogs()
            robot.process.terminate()
            robot.listen(time.monotonic() + 5.0, quiet=0.5)
            assert robot.process.wait(5.0) == 128 + signal.SIGTERM
            robot.none_is_left()
            if policy == "alarm":
                return None
            took = robot.safe_since() - stopped
            assert took <= 2 * LIMIT + 0.05
            return took
        finally:
            robot.close()

    many(request, silent_after, [0.1], 50, 0.5)


@pytest.mark.parametrize("policy", ["stop", "alarm"])
def test_killed_while_its_watchdog_is_silent(
    policy: Literal["stop", "alarm"], request: pytest.FixtureRequest
) -> None:
    """A watchdog that was stopped goes on when its robot dies; none is left behind."""

    def killed_after(seconds: float) -> float:
        robot = Driven(policy)
        try:
            robot.until_it_moves()
            (dog,) = robot.dogs()
            stopped = time.monotonic()
            os.kill(dog, signal.SIGSTOP)
            robot.listen(stopped + seconds)
            died = robot.kill()
            robot.listen(time.monotonic() + 5.0, quiet=0.4)
            assert robot.data.endswith(b"STOP\n")
            robot.none_is_left()
            safe = robot.safe_since()
            assert safe <= max(stopped + 2 * LIMIT, died) + 0.05
            return max(0.0, safe - stopped)
        finally:
            robot.close()

    many(request, killed_after, [0.1, 0.42], 100, 2 * LIMIT + 0.1)
