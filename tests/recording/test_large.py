"""Recordings of any size are read in bounded memory."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from esair.recording import is_whole

pytest.importorskip("foxglove", reason="needs esair[record]")

pytestmark = [pytest.mark.real_clock, pytest.mark.long, pytest.mark.promise("REC-4")]

ROBOT = """
import os
import esair


class Camera(esair.Sensor[bytes]):
    rate = 10.0

    async def read(self) -> bytes:
        return os.urandom(600_000)


class Wheel(esair.Actuator[float]):
    safe = 0.0
    command_timeout = 0.5

    async def write(self, command: float) -> None:
        pass


class Follow(esair.Reaction):
    camera = esair.reads(bytes)
    wheel = esair.writes(float)

    def react(self, camera: bytes) -> float:
        return camera[0] / 255
"""

FILE = """
[robot]
name = "looker"
[sensor.camera]
driver = "looker:Camera"
[actuator.wheel]
driver = "looker:Wheel"
[behavior.follow]
driver = "looker:Follow"
[record]
path = "run.mcap"
max_bytes = 4_000_000_000
segment = 4_000_000_000
min_free = 0
"""

WATCHED = """
import sys
from esair.cli import main
code = 0
try:
    main(sys.argv[1:])
except SystemExit as ended:
    code = ended.code
peak = [line for line in open("/proc/self/status") if line.startswith("VmHWM")]
sys.stderr.write(f"peak {int(peak[0].split()[1]) >> 10}")
sys.exit(code)
"""

MOST = 300
"""How many MiB reading may take, whatever the size."""


def peak_of(folder: Path, *words: str) -> int:
    """Run a verb in a process; return how many MiB it has had at most."""
    done = subprocess.run(
        [sys.executable, "-c", WATCHED, *words],
        cwd=folder,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        timeout=1800,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return int(done.stderr.rpartition("peak ")[2])


def test_a_large_recording_is_read_in_bounded_memory(
    tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    """100 MB, and 1 GB with --esair-soak: log, plot, recover and an exact replay."""
    is_soak = request.config.getoption("--esair-soak")
    seconds, least = (160, 1_000_000_000) if is_soak else (15, 80_000_000)
    (tmp_path / "looker.py").write_text(ROBOT)
    (tmp_path / "robot.toml").write_text(FILE)
    words = [sys.executable, "-m", "esair", "run", "robot.toml", "--for", str(seconds)]
    subprocess.run(words, cwd=tmp_path, check=True, timeout=seconds + 120)
    path = tmp_path / "run.mcap"
    assert path.stat().st_size > least
    assert is_whole(path)

    peaks = {
        verb: peak_of(tmp_path, verb, "run.mcap")
        for verb in ("log", "plot", "recover", "replay")
    }
    print(path.stat().st_size, peaks)  # noqa: T201 - what it costs
    assert max(peaks.values()) <= MOST
