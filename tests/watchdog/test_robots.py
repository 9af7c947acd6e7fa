"""A robot with its watchdog, as processes; looked at from the far end of the line."""

from __future__ import annotations

import contextlib
import os
import select
import signal
import subprocess
import sys
import time
import tty
from pathlib import Path

import pytest
from tests.patience import TRIES

import esair
from esair.exceptions import ConfigError

pytestmark = pytest.mark.real_clock

ROBOT = Path(__file__).with_name("robot.py")


def run(way: str, seconds: float = 30.0) -> tuple[bytes, str, int | None]:
    """Return what came over the line, what was said, and the exit code."""
    far, near = os.openpty()
    tty.setraw(near)
    process = subprocess.Popen(
        [sys.executable, str(ROBOT), os.ttyname(near), way],
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    data, end, quiet = b"", time.monotonic() + seconds, time.monotonic()
    try:
        while time.monotonic() < end:
            dead = process.poll() is not None  # before the look: safe came first
            if select.select([far], [], [], 0.02)[0]:
                data += os.read(far, 4096)
                quiet = time.monotonic()
            elif dead and time.monotonic() - quiet > 0.4:
                break
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.kill(process.pid, signal.SIGKILL)
        _, said = process.communicate(timeout=60)
        os.close(far)
        os.close(near)
    return data, said, process.returncode


@pytest.mark.promise("GRD-1")
@pytest.mark.parametrize("way", ["kill", "sleep", "spin"])
def test_a_robot_that_dies_or_hangs_is_made_safe(way: str) -> None:
    """The last thing at the far end is the safe command, and the process has ended."""
    for _ in range(TRIES):
        data, said, code = run(way)
        assert data.count(b"GO\n") > 30
        assert data.endswith(b"STOP\n")
        assert "esair watchdog: " in said
        assert code == -signal.SIGKILL
        if way == "kill" or " in die: wheels safe" in said:
            break  # a busy computer may not tell in time who holds the process
    assert way == "kill" or " in die: wheels safe" in said  # the culprit


@pytest.mark.long
@pytest.mark.promise("GRD-1")
@pytest.mark.fault("B06")
def test_a_loop_that_is_stopped_is_made_safe() -> None:
    """By whoever comes first: the end of the run, or the watchdog."""
    data, _, code = run("loop.stop")
    assert data.endswith(b"STOP\n")
    assert code != 0


@pytest.mark.long
@pytest.mark.promise("GRD-3")
def test_an_orderly_end_leaves_no_watchdog() -> None:
    """It says nothing, and no process is left."""
    data, said, code = run("end")
    assert code == 0
    assert data.endswith(b"STOP\n")
    assert "esair watchdog" not in said


@pytest.mark.long
@pytest.mark.promise("GRD-2")
@pytest.mark.fault("O07")
def test_what_the_watchdog_cannot_stop_is_said() -> None:
    """UNWATCHED, with the reason; what it can stop is not named."""
    _, said, _ = run("end")
    lines = [line for line in said.splitlines() if "UNWATCHED" in line]
    assert lines == ["dumb: UNWATCHED: its driver cannot say its safe command as bytes"]


@pytest.mark.long
@pytest.mark.promise("GRD-3")
@pytest.mark.fault("O06")
def test_a_watchdog_that_dies_halts_the_robot() -> None:
    """Nothing moves any more, and it is started anew."""
    data, said, _ = run("dog")
    assert "the watchdog process died" in said
    assert data.endswith(b"STOP\n")
    assert 35 < data.count(b"GO\n") < 60


def test_what_it_cannot_be_is_told_at_once() -> None:
    """The field, and what was expected."""
    with pytest.raises(
        ConfigError, match="watchdog_policy: expected 'kill' or 'freeze'"
    ):
        esair.Robot(watchdog=True, watchdog_policy="maim")  # type: ignore[arg-type]
