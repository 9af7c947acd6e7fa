"""A robot is killed while its lines come and go: what the other ends were told."""

from __future__ import annotations

import contextlib
import os
import re
import select
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

pytestmark = [pytest.mark.real_clock, pytest.mark.promise("GRD-1")]

LINES = Path(__file__).with_name("lines.py")
PATIENCE = 60.0
DIED = r"its (process died|robot is gone, its process is not): "
"""What a watchdog says of a death: the second if it takes the kernel long to bury it."""


class Wire:
    """A line, as far as a watchdog can tell: it can be full, and be pulled."""

    def __init__(self) -> None:
        self.far, self.near = os.pipe()
        os.set_blocking(self.near, False)
        os.set_blocking(self.far, False)

    def fill(self) -> None:
        for size in (3000, 1):  # what is written at once must fit at once
            with contextlib.suppress(BlockingIOError):
                while True:
                    os.write(self.near, b"\n" * size)

    def pull(self) -> None:
        os.close(self.far)
        self.far = -1

    def heard(self) -> bytes:
        """Wait until something comes, and return it."""
        assert select.select([self.far], [], [], PATIENCE)[0]
        return os.read(self.far, 4096)

    def close(self) -> None:
        for end in (self.far, self.near):
            if end >= 0:
                os.close(end)


class Robot:
    """A process that holds some lines."""

    def __init__(
        self, *wires: Wire, shell: str = "", says: int = subprocess.PIPE, **more: str
    ) -> None:
        lines = [wire.near for wire in wires]
        words = [sys.executable, str(LINES), *map(str, lines)]
        self.process = subprocess.Popen(
            ["/bin/sh", "-c", f'exec "$0" "$@" {shell}', *words],
            stdout=subprocess.PIPE,
            stderr=says,
            text=True,
            pass_fds=lines,
            env=os.environ | more,
        )
        assert self.process.stdout is not None
        assert self.process.stdout.readline() == "armed\n"

    def kill(self) -> str:
        """End it, and return what its watchdog says when it has ended, too."""
        self.process.kill()
        return self.process.communicate(timeout=PATIENCE)[1]

    def see_it_pulled(self, wire: Wire) -> None:
        """Pull a wire, and wait until the watchdog has let go of it."""
        held = Path(f"/proc/{self.dog}/fd")
        before = len(list(held.iterdir()))
        wire.pull()
        end = time.monotonic() + PATIENCE
        while len(list(held.iterdir())) == before:
            assert time.monotonic() < end
            time.sleep(0.01)

    @property
    def dog(self) -> int:
        tasks = Path(f"/proc/{self.process.pid}/task").glob("*/children")
        (dog,) = "".join(each.read_text("ascii") for each in tasks).split()
        return int(dog)


def until_it_has_ended(process: int) -> None:
    end = time.monotonic() + PATIENCE
    while Path(f"/proc/{process}").exists() and time.monotonic() < end:
        time.sleep(0.01)
    assert not Path(f"/proc/{process}").exists()


@pytest.fixture
def wires() -> Iterator[list[Wire]]:
    both = [Wire(), Wire()]
    yield both
    for each in both:
        each.close()


@pytest.mark.fault("O04", "D01")
def test_a_device_is_pulled_and_then_the_robot_is_killed(wires: list[Wire]) -> None:
    """The other one is made safe, and of the pulled one nothing is said any more."""
    pulled, other = wires
    robot = Robot(pulled, other)
    robot.see_it_pulled(pulled)
    said = robot.kill()
    assert other.heard() == b"STOP\n"
    assert re.fullmatch(f"esair watchdog: {DIED}line 1 safe, after .*\n", said)


@pytest.mark.long
@pytest.mark.fault("O04")
def test_a_death_is_told_as_one(wires: list[Wire]) -> None:
    """On a computer that buries a process soon."""
    assert "its process died: line 0 safe, line 1 safe" in Robot(*wires).kill()


@pytest.mark.fault("O04", "D01")
def test_a_robot_is_killed_that_has_not_heard_what_its_watchdog_said(
    wires: list[Wire],
) -> None:
    """Its end of the channel is reset then, and the watchdog does its work."""
    pulled, other = wires
    robot = Robot(pulled, other)
    robot.process.send_signal(signal.SIGSTOP)
    robot.see_it_pulled(pulled)
    said = robot.kill()
    assert other.heard() == b"STOP\n"
    assert re.search(f"{DIED}line 1 safe", said)


@pytest.mark.fault("O04", "O15")
def test_a_robot_without_standard_descriptors(wires: list[Wire]) -> None:
    """What the watchdog says in the end is written nowhere then, and not to a device."""
    robot = Robot(*wires, shell="9>&1 <&- >&- 2>&-", TELLS="9")
    dog = robot.dog
    assert robot.kill() == ""
    until_it_has_ended(dog)
    assert [wire.heard() for wire in wires] == [b"STOP\n"] * 2


@pytest.mark.long
@pytest.mark.fault("O04", "O15")
def test_nobody_reads_what_the_watchdog_says(wires: list[Wire]) -> None:
    """It ends all the same: a port that it held would be nobody else's."""
    full, other = wires
    full.fill()
    os.set_blocking(full.near, True)
    robot = Robot(other, says=full.near)
    dog = robot.dog
    robot.kill()
    assert other.heard() == b"STOP\n"
    until_it_has_ended(dog)


@pytest.mark.fault("O04")
def test_a_robot_becomes_another_program(wires: list[Wire]) -> None:
    """Its process lives, and is no robot any more: it is ended like one that hangs."""
    robot = Robot(*wires)
    robot.process.send_signal(signal.SIGUSR1)
    assert [wire.heard() for wire in wires] == [b"STOP\n"] * 2
    assert robot.process.wait(PATIENCE) == -signal.SIGKILL
    assert "its robot is gone, its process is not: line 0 safe" in robot.kill()


IN_WATCH = ["act", "is_still", "begin", "is_left", "write", "last_look"]


@pytest.mark.fault("O04", "O12")
@pytest.mark.parametrize("function", IN_WATCH)
def test_what_fails_in_the_watchdog_is_done_once_more(
    wires: list[Wire], function: str, request: pytest.FixtureRequest
) -> None:
    """Whichever line of it, as if there were no memory: safe is the last, everywhere."""
    soak = request.config.getoption("--esair-soak")
    if not soak and function != "act":
        pytest.skip("a process for each line: --esair-soak")
    for line in range(1, 30) if soak else [7]:
        robot = Robot(*wires, FAILS=f"{function}:{line}")
        said = robot.kill()
        assert re.search(f"{DIED}line 0 safe, line 1 safe", said), line
        assert all(wire.heard().endswith(b"STOP\n") for wire in wires), line


@pytest.mark.fault("O04", "D02")
def test_a_line_hangs_up_while_the_watchdog_writes(wires: list[Wire]) -> None:
    """It is full, so it is tried again: the other one first; then it is not there."""
    full, other = wires
    full.fill()
    robot = Robot(full, other)
    robot.process.kill()
    assert other.heard() == b"STOP\n"
    full.pull()
    said = robot.kill()
    assert "line 0 NOT SAFE (" in said
    assert "line 1 safe" in said


@pytest.mark.fault("O04")
def test_a_line_that_is_full_is_tried_again(wires: list[Wire]) -> None:
    """What waits in it goes first; safe comes last."""
    full, other = wires
    full.fill()
    robot = Robot(full, other)
    robot.process.kill()
    assert other.heard() == b"STOP\n"
    heard = b""
    while not heard.endswith(b"STOP\n"):
        heard += full.heard()
    assert "line 0 safe, line 1 safe" in robot.kill()


@pytest.mark.fault("O04")
def test_all_frames_are_sent_however_long_their_silence_is(wires: list[Wire]) -> None:
    """Half a second is for what is not taken, not for what has to wait."""
    robot = Robot(wires[0], FRAMES='{"repeat": 8, "gap": 0.08}')
    assert "line 0 safe" in robot.kill()
    assert wires[0].heard() == b"STOP\n" * 8


@pytest.mark.fault("O04")
def test_a_robot_without_actuators() -> None:
    """Its watchdog has nothing to do, says so, and ends with it."""
    robot = Robot()
    dog = robot.dog
    said = robot.kill()
    assert re.search(f"esair watchdog: {DIED}nothing is watched", said)
    until_it_has_ended(dog)
