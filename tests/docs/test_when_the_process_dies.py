"""The page's robot does what the page says, as a process with a real line."""

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

CODE = Path(__file__).parents[2] / "docs" / "code"
PORT = "/dev/serial/by-id/usb-winch-board"

SCRIPT = """
import sys
import esair, winch
winch.Hoist.stuck = sys.argv[2] == "stuck"
esair.run(esair.Robot.from_config(sys.argv[1]))
"""


@pytest.mark.long
@pytest.mark.real_clock
@pytest.mark.promise("GRD-1")
@pytest.mark.parametrize("way", ["kill", "stuck", "end"])
def test_the_winch_stops(way: str, tmp_path: Path) -> None:
    """Its last command is the safe one, and the watchdog's line names the culprit."""
    far, near = os.openpty()
    tty.setraw(near)
    file = tmp_path / "winch.toml"
    text = (CODE / "winch.toml").read_text("utf-8")
    file.write_text(text.replace(PORT, os.ttyname(near)), "utf-8")
    robot = subprocess.Popen(
        [sys.executable, "-c", SCRIPT, str(file), way],
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": str(CODE)},
    )
    heard, end, quiet = b"", time.monotonic() + 15.0, time.monotonic()
    try:
        while time.monotonic() < end:
            if select.select([far], [], [], 0.02)[0]:
                heard += os.read(far, 4096)
                quiet = time.monotonic()
                if way == "kill" and b"winch=0.5" in heard:
                    robot.kill()
            elif robot.poll() is not None and time.monotonic() - quiet > 0.3:
                break
    finally:
        with contextlib.suppress(ProcessLookupError):
            robot.kill()
        _, said = robot.communicate(timeout=60)
        os.close(far)
        os.close(near)
    lines = heard.split(b"\n")
    assert b"winch=0.5" in lines, said
    assert lines[-2:] == [b"winch=0", b""]
    if way == "end":
        assert robot.returncode == 0
        assert "esair watchdog" not in said
    elif way == "kill":
        assert robot.returncode == -signal.SIGKILL
        assert "esair watchdog: its process died: winch safe" in said
    else:
        assert 'winch.py", line ' in said
        assert " in run: winch safe, after " in said
