"""A robot whose standard error is a full pipe that nobody reads: words come last."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
import time
import tty
from collections.abc import Iterator
from pathlib import Path

import pytest

pytestmark = [pytest.mark.real_clock, pytest.mark.fault("O15")]

ENDS = {"stop": 0, "crash": 1}
"""The exit codes of the ways that end the robot."""

ROOT = Path(__file__).parents[2]


@pytest.fixture
def unread() -> Iterator[int]:
    """The end to write to of a pipe that takes not one byte more."""
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    for size in (4096, 1):
        try:
            while True:
                os.write(writer, b"." * size)
        except BlockingIOError:
            pass
    os.set_blocking(writer, True)
    yield writer
    os.close(reader)
    os.close(writer)


@pytest.mark.long
@pytest.mark.parametrize("log", ["warnings", "all"])
@pytest.mark.parametrize(
    "way",
    [
        *("dog", "lost", "term"),
        *(
            pytest.param(w, marks=pytest.mark.long)
            for w in ("guard", "halt", "stop", "crash")
        ),
    ],
)
def test_it_is_safe_though_nobody_reads_its_log(
    way: str, log: str, unread: int, request: pytest.FixtureRequest
) -> None:
    """Whatever makes it safe: the line that says so is never waited for, nor its end."""
    if log == "all" and way != "dog" and not request.config.getoption("--esair-long"):
        pytest.skip("the others are for --esair-long")
    far, near = os.openpty()
    tty.setraw(near)
    robot = subprocess.Popen(
        [sys.executable, "-m", "tests.watchdog.unread", os.ttyname(near), way, log],
        cwd=ROOT,
        stderr=unread,
    )
    try:
        heard = listen(far, b"GO", 60.0)
        if way == "term":
            time.sleep(0.3)
            robot.terminate()
        heard += listen(far, b"STOP", 10.0)
        heard += listen(far, b"GO", 0.5)
        assert heard.endswith(b"STOP\n")
        if way not in ENDS:
            robot.terminate()
        assert robot.wait(10) == ENDS.get(way, 128 + signal.SIGTERM)
    finally:
        robot.kill()
        robot.wait()
        os.close(far)
        os.close(near)


def listen(far: int, word: bytes, seconds: float) -> bytes:
    """What comes over the line until a word, or for so long."""
    heard, end = b"", time.monotonic() + seconds
    while word not in heard and time.monotonic() < end:
        if select.select([far], [], [], 0.02)[0]:
            heard += os.read(far, 4096)
    return heard
