"""The story of docs/how-to/drive-by-hand.md, by what the tracks were told."""

from __future__ import annotations

import json
import os
import pty
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from esair.recording import Recorded, events_of

CODE = Path(__file__).parents[2] / "docs" / "code"
ESAIR = [sys.executable, "-m", "esair"]

pytestmark = [
    pytest.mark.long,
    pytest.mark.real_clock,
    pytest.mark.promise("OPS-4"),
]


def eventually(condition: Callable[[], object]) -> None:
    """Wait until something is so."""
    end = time.monotonic() + 30.0
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)


@pytest.fixture
def tractor(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[subprocess.Popen[bytes]]:
    """The tractor, mowing and recorded."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    for name in ("tractor.py", "tractor.toml"):
        shutil.copy(CODE / name, tmp_path)
    monkeypatch.chdir(tmp_path)
    words = [*ESAIR, "run", "tractor.toml", "--record", "run.mcap"]
    process = subprocess.Popen(words, stderr=subprocess.DEVNULL)
    try:
        eventually(Path("esair/tractor.sock").exists)
        yield process
    finally:
        process.kill()
        process.wait()


def said(*words: str) -> str:
    """Run a verb; return what it has said."""
    done = subprocess.run([*ESAIR, *words], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    return done.stdout


def holder() -> str | None:
    """Return who has the tracks."""
    (actuator,) = (
        each
        for each in json.loads(said("top", "--json"))["resources"]
        if each["name"] == "tracks"
    )
    found: str | None = actuator["holder"]
    return found


def told(by: str) -> list[Recorded]:
    """Return what the tracks were told by somebody, in order."""
    return [e for e in events_of("run.mcap") if e.kind == "sent" and e.peer == by]


def test_keys_drive_while_they_are_held(tractor: subprocess.Popen[bytes]) -> None:
    """Half of the limits; then it mows again; all of it is repeated."""
    eventually(lambda: holder() == "mow")
    keys, terminal = pty.openpty()
    driving = subprocess.Popen(
        [*ESAIR, "drive", "tracks", "--speed", "0.5"],
        stdin=terminal,
        stdout=terminal,
        stderr=terminal,
    )
    os.close(terminal)
    try:

        def drives() -> bool:
            for _ in range(20):
                os.write(keys, b"\x1b[A")
                time.sleep(0.05)
            return bool(told("operator"))  # the recorder writes within half a second

        eventually(drives)
        os.write(keys, b"q")
        assert driving.wait(60) == 0
    finally:
        driving.kill()
        driving.wait()
        os.close(keys)
    eventually(lambda: holder() == "mow")
    assert said("why", "tracks").startswith("tracks is ready, held by mow (priority 0")
    tractor.send_signal(signal.SIGINT)
    tractor.wait(60)

    assert {str(e.value) for e in told("operator")} == {"{'speed': 0.5, 'turn': 0.0}"}
    assert "operator > tracks" in said("log", "run.mcap", "-k", "operator")
    assert said("replay", "run.mcap", "--with", "tractor.toml").startswith("equal")


def test_what_is_not_allowed_is_refused(tractor: subprocess.Popen[bytes]) -> None:
    """The file lets people drive, stop and resume; no more."""
    assert tractor.poll() is None
    words = [*ESAIR, "remove", "mow"]
    done = subprocess.run(words, capture_output=True, text=True, timeout=60)

    assert done.returncode == 1
    assert "[operator] allows lease, drive, release, resume" in done.stderr
    assert "halted" in said("stop", "by hand")
    said("resume")
