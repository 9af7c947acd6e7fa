"""What is shown in the terminal."""

from __future__ import annotations

import asyncio
import io
import logging
import os
import pty
import re
import select
import subprocess
import sys
import time
from pathlib import Path

import pytest
from rich.console import Console

from esair.demo._plan import FloorMap
from esair.demo._show import Drawing, Ending, Screen, perform
from esair.demo._story import Event


def test_the_map_has_north_at_the_top() -> None:
    """What is occupied at the greatest y is drawn in the first line of its column."""
    floor = FloorMap.empty((2.0, 1.0))
    row, column = floor.cell_of(0.55, 0.95)
    floor.odds[row - 1 : row + 2, column - 1 : column + 2] = 3.0

    text = Drawing(floor, (), (0.05, 0.05))(floor.odds.shape[1] // 2, 1000)

    lines = text.split("\n")
    occupied = [
        index
        for index, line in enumerate(lines)
        for span in line.spans
        if "#3b6ea5" in str(span.style)
    ]
    rover = [
        index
        for index, line in enumerate(lines)
        for span in line.spans
        if "#d62828" in str(span.style)
    ]
    assert occupied
    assert rover
    assert max(occupied) < min(rover)
    assert {len(line.plain) for line in lines} == {floor.odds.shape[1] // 2}


@pytest.mark.parametrize(("width", "height"), [(40, 9), (60, 30), (10, 40), (200, 3)])
def test_the_map_fits_where_it_is_drawn(width: int, height: int) -> None:
    """As fine as there is room for, never larger."""
    drawing = Drawing(FloorMap.empty((6.0, 4.0)), (), (1.0, 1.0))

    lines = drawing(width, height).split("\n")

    assert len(lines) <= height
    assert max(len(line) for line in lines) <= width


def test_the_log_goes_to_the_screen_and_back() -> None:
    """While the screen is there it takes the lines; afterwards all is as before."""
    log = logging.getLogger("esair")
    assert not log.isEnabledFor(logging.INFO)
    before = (log.level, log.propagate, list(log.handlers))

    with Screen(Console(file=io.StringIO()), live=False) as screen:
        log.warning("ranges: lost")
        log.debug("a detail")

        log.info("ranges: back")

    assert screen.lines == ["ranges: lost", "ranges: back"]
    assert (log.level, log.propagate, list(log.handlers)) == before
    assert not log.isEnabledFor(logging.INFO)


def test_events_stay_when_the_drawing_is_gone() -> None:
    """After a live show the terminal keeps a line for each event."""
    text = io.StringIO()
    console = Console(file=text, force_terminal=True, width=120, height=40)

    with Screen(console, live=True) as screen:
        screen.tell(Event(1.0, "unplug", "the range finder is unplugged", (0.0, 0.0)))

    assert "the range finder is unplugged" in text.getvalue().rpartition("\x1b[?25h")[2]


@pytest.mark.long
@pytest.mark.virtual_clock
async def test_on_80_by_24_all_is_seen_and_the_blind_moment_says_why() -> None:
    """The map, the components, the newest events, and why the rover stands still."""
    text = io.StringIO()
    console = Console(file=text, width=80, height=24)
    screen = Screen(console, live=False)
    screen.live = True  # events are drawn, not printed
    console.print(screen.draw())
    assert "wakes up" in text.getvalue()
    showing = asyncio.create_task(perform(Ending(), screen, seed=0, duration=16.0))
    await asyncio.sleep(6.0)
    text.seek(0)
    text.truncate()

    console.print(screen.draw())
    showing.cancel()
    with pytest.raises(asyncio.CancelledError):
        await showing

    lines = text.getvalue().splitlines()
    assert len(lines) <= 24
    assert max(map(len, lines)) <= 80
    shown = "\n".join(lines)
    assert "avoid is blind: ranges lost" in shown
    assert "the range finder is unplugged" in shown
    assert re.search(r"^ranges +lost", shown, re.MULTILINE)
    assert re.search(r"^brake +parked", shown, re.MULTILINE)
    assert "▀" in shown


@pytest.mark.real_clock
@pytest.mark.long
def test_a_terminal_is_drawn_on_while_the_rover_drives(tmp_path: Path) -> None:
    """The thread that draws gets pictures of the robot, and meets no error."""
    pid, terminal = pty.fork()
    if pid == 0:
        os.environ |= {"TERM": "xterm", "COLUMNS": "80", "LINES": "24"}
        os.environ["XDG_RUNTIME_DIR"] = str(tmp_path)
        code = "from esair.demo import demo; demo()"
        os.execv(sys.executable, [sys.executable, "-c", code])
    shown, end = b"", time.monotonic() + 30
    drives = re.compile(rb"explore\S* \(0\)")
    try:
        while time.monotonic() < end and not drives.search(shown):
            if select.select([terminal], [], [], 0.1)[0]:
                shown += os.read(terminal, 65536)
    finally:
        subprocess.run(["kill", "-INT", str(pid)], check=True)
        with open(terminal, "rb", buffering=0) as file:
            try:
                while rest := file.read(65536):
                    shown += rest
            except OSError:  # its process has ended
                pass
        os.waitpid(pid, 0)

    text = shown.decode()
    assert drives.search(shown)
    assert "Error" not in text
    assert "safe Twist(linear=0.0, angular=0.0): answered" in text
