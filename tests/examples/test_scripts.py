"""The examples as scripts, as a user starts them: in real time, without hardware."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[2] / "examples"


def start(script: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, EXAMPLES / script],
        env={**os.environ, "PYTHONDONTWRITEBYTECODE": "1", "PYTHONWARNINGS": "error"},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


@pytest.mark.real_clock
def test_every_example_is_run_here() -> None:
    """Nobody adds an example without a test."""
    tested = {
        path.name.removeprefix("test_") for path in Path(__file__).parent.iterdir()
    }

    assert {path.name for path in EXAMPLES.glob("*.py")} <= tested


@pytest.mark.real_clock
@pytest.mark.promise("ROB-1", "ROB-2")
def test_ctrl_c_stops_the_rover() -> None:
    """The wheels get their safe command last, and the exit code tells the signal."""
    with start("wander_and_avoid.py") as script:
        assert script.stdout is not None
        driving = next(line for line in script.stdout if "linear=0.3" in line)
        script.send_signal(signal.SIGINT)
        out, err = script.communicate(timeout=60)

    assert driving
    assert script.returncode == 128 + signal.SIGINT
    assert out.splitlines()[-1] == "Twist(linear=0.0, angular=0.0)"
    assert err == ""


@pytest.mark.real_clock
def test_docking_finds_its_battery_low() -> None:
    """It starts, drives, and Ctrl-C ends it."""
    with start("docking.py") as script:
        assert script.stdout is not None
        assert script.stdout.readline() == "battery low: dock\n"
        script.send_signal(signal.SIGINT)
        _, err = script.communicate(timeout=60)

    assert script.returncode == 128 + signal.SIGINT
    assert err == ""


@pytest.mark.real_clock
@pytest.mark.long
def test_slow_arm_ends_by_itself() -> None:
    """All its behaviors end, so the robot ends, without an error."""
    with start("slow_arm.py") as script:
        out, err = script.communicate(timeout=60)

    assert script.returncode == 0
    assert "held by guard" in out
    assert err == ""
