"""A watchdog that starts late, or falls silent: robots and watchdogs as processes.

What counts is what is on the line, looked at from the far end, and who has it open.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import random
import select
import signal
import subprocess
import sys
import time
import tty
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Literal

import pytest
from tests.patience import TRIES
from tests.watchdog.test_watchdog import dogs_of

pytestmark = [pytest.mark.real_clock, pytest.mark.promise("GRD-4")]

ROBOT = Path(__file__).with_name("robot.py")
SLOW = """#!{python}
import os, sys, time
time.sleep({late})
os.execv({python!r}, [{python!r}, *sys.argv[1:]])
"""


class Driven:
    """A robot that drives for ever, and what came over its line."""

    stops_its_dog = False

    def __init__(self, policy: str, way: str, **environment: str) -> None:
        self.far, self.near = os.openpty()
        tty.setraw(self.near)
        self.line = os.ttyname(self.near)
        self.process = subprocess.Popen(
            [sys.executable, str(ROBOT), self.line, way, policy],
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
        _, said = self.process.communicate(timeout=60)
        for dog in self.dogs():
            with contextlib.suppress(ProcessLookupError):
                os.kill(dog, signal.SIGKILL)
        os.close(self.far)
        os.close(self.near)
        return said


class StarvedError(Exception):
    """The computer had no time for a process, and the other one said so."""


@contextlib.contextmanager
def driven(
    policy: str, limit: float, way: str = "drive", **environment: str
) -> Iterator[Driven]:
    robot = Driven(policy, way, LIMIT=str(limit), **environment)
    try:
        yield robot
    except Exception as error:
        said = robot.close()
        own = robot.stops_its_dog
        if "no turn for" in said or ("has not looked" in said and not own):
            raise StarvedError(said) from error
        raise AssertionError(said) from error
    else:
        said = robot.close()
        assert "wheels: UNWATCHED" not in said


def many(
    request: pytest.FixtureRequest,
    each: Callable[[float], object],
    few: list[float],
    soak: int,
    longest: float,
) -> None:
    """Do it with a few values; with many of them, at random, in a soak."""
    starved = itertools.count()

    def patiently(value: float) -> object:
        for _ in range(TRIES):
            with contextlib.suppress(StarvedError):
                return each(value)
            next(starved)
        raise StarvedError

    if not is_soak(request):
        for value in few:
            patiently(value)
        return
    values = random.Random(4)
    with ThreadPoolExecutor(3) as pool:
        given = [values.uniform(0, longest) for _ in range(soak)]
        done = list(pool.map(patiently, given))
    sys.stderr.write(f"{len(done)} of {soak}, {next(starved)} done again")
    times = sorted(one for one in done if isinstance(one, float))
    if times:
        middle, longest = times[len(times) // 2] * 1000, times[-1] * 1000
        sys.stderr.write(f", safe after {middle:.0f} ms, at most {longest:.0f} ms")
    sys.stderr.write("\n")


def is_soak(request: pytest.FixtureRequest) -> bool:
    return bool(request.config.getoption("--esair-soak"))


def limit_of(request: pytest.FixtureRequest) -> float:
    """The default one in a soak, which judges times; in every run a patient one."""
    return 0.25 if is_soak(request) else 0.5


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
        with driven(policy, limit_of(request), DOG=str(slow)) as robot:
            robot.until_it_moves()
            assert robot.is_watched()
            assert time.monotonic() - began > late
            robot.kill()
            robot.listen(time.monotonic() + 5.0, quiet=0.4)
            assert robot.data.endswith(b"STOP\n")
            robot.none_is_left()

    many(request, late_by, [1.5 if policy == "stop" else 0.4], 100, 5.0)


@pytest.mark.long
@pytest.mark.parametrize("policy", ["stop", "alarm"])
def test_a_silent_watchdog_is_noticed_and_replaced(
    policy: Literal["stop", "alarm"], request: pytest.FixtureRequest
) -> None:
    """Within two limits; "stop" is safe by then, "alarm" drives on, watched anew."""

    limit = limit_of(request)

    def silent_after(seconds: float) -> float | None:
        with driven(policy, limit) as robot:
            robot.until_it_moves()
            robot.listen(time.monotonic() + seconds)
            (dog,) = robot.dogs()
            robot.stops_its_dog, stopped = True, time.monotonic()
            os.kill(dog, signal.SIGSTOP)
            robot.listen(stopped + 2 * limit + 0.05)
            end = time.monotonic() + 20.0
            while (not robot.is_watched() or dog in robot.dogs()) and (
                time.monotonic() < end
            ):
                robot.listen(time.monotonic() + 0.05)
            assert robot.is_watched()
            assert dog not in robot.dogs()
            robot.process.terminate()
            robot.listen(time.monotonic() + 5.0, quiet=0.5)
            assert robot.process.wait(60) == 128 + signal.SIGTERM
            robot.none_is_left()
            if policy == "alarm":
                return None
            took = robot.safe_since() - stopped
            assert took <= 2 * limit + 0.05 or not is_soak(request)
            return took

    many(request, silent_after, [0.1], 50, 0.5)


@pytest.mark.long
@pytest.mark.promise("GRD-1")
@pytest.mark.parametrize("goes_on", [True, False])
def test_both_are_stopped_and_the_watchdog_goes_on_first(
    goes_on: bool, request: pytest.FixtureRequest
) -> None:
    """Its robot may go on a moment later; one that does not is made safe all the same."""
    limit = limit_of(request)

    def stopped_for(seconds: float) -> None:
        with driven("stop", limit) as robot:
            robot.until_it_moves()
            (dog,) = robot.dogs()
            robot.listen(time.monotonic() + 0.1)
            for pid in (robot.process.pid, dog):
                os.kill(pid, signal.SIGSTOP)
            time.sleep(seconds)
            robot.listen(time.monotonic() + 0.05)  # what was on its way
            robot.heard.clear()
            os.kill(dog, signal.SIGCONT)
            if goes_on:
                time.sleep(limit / 25)
                robot.process.send_signal(signal.SIGCONT)
            robot.listen(time.monotonic() + 4 * limit, quiet=3 * limit)
            assert robot.data.endswith(b"GO\n" if goes_on else b"STOP\n")

    many(request, stopped_for, [3 * limit] * 2, 50, 3 * limit)


@pytest.mark.long
@pytest.mark.parametrize("policy", ["stop", "alarm"])
def test_killed_while_its_watchdog_is_silent(
    policy: Literal["stop", "alarm"], request: pytest.FixtureRequest
) -> None:
    """A watchdog that was stopped goes on when its robot dies; none is left behind."""

    limit = limit_of(request)

    def killed_after(seconds: float) -> float:
        with driven(policy, limit) as robot:
            robot.until_it_moves()
            (dog,) = robot.dogs()
            robot.stops_its_dog, stopped = True, time.monotonic()
            os.kill(dog, signal.SIGSTOP)
            robot.listen(stopped + seconds * limit)
            died = robot.kill()
            robot.listen(time.monotonic() + 5.0, quiet=0.4)
            assert robot.data.endswith(b"STOP\n")
            robot.none_is_left()
            safe = robot.safe_since()
            until = max(stopped + 2 * limit, died) + 0.05
            assert safe <= until or not is_soak(request)
            return max(0.0, safe - stopped)

    many(request, killed_after, [0.3, 1.65], 100, 2.4)


@pytest.mark.parametrize("policy", ["stop", "alarm"])
def test_killed_while_it_is_configured(
    policy: Literal["stop", "alarm"], request: pytest.FixtureRequest
) -> None:
    """Settings without safe frames, and with an error for them, keep it watched."""

    limit = limit_of(request)

    def killed_after(seconds: float) -> float:
        with driven(policy, limit, "tune") as robot:
            robot.until_it_moves()
            robot.listen(time.monotonic() + seconds)
            assert robot.is_watched()
            robot.heard.clear()
            robot.listen(time.monotonic() + 0.3)
            assert robot.moves()  # nothing has stopped it
            died = robot.kill()
            robot.listen(time.monotonic() + 5.0, quiet=0.4)
            assert robot.data.endswith(b"STOP\n")
            robot.none_is_left()
            return max(0.0, robot.safe_since() - died)

    many(request, killed_after, [0.7], 50, 2.0)
