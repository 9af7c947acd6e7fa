"""What is shown in the terminal."""

from __future__ import annotations

import asyncio
import io
import logging

import pytest
from rich.console import Console

from esair.demo._map import FloorMap
from esair.demo._screen import Screen, draw_map
from esair.demo._show import Ending, perform
from esair.demo._story import Event


def test_the_map_has_north_at_the_top() -> None:
    """What is occupied at the greatest y is drawn in the first line of its column."""
    floor = FloorMap.empty((2.0, 1.0))
    row, column = floor.cell_of(0.55, 0.95)
    floor.odds[row - 1 : row + 2, column - 1 : column + 2] = 3.0

    text = draw_map(floor, [], (0.05, 0.05, 0.0))

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
    assert {len(line.plain) for line in lines if line.plain} == {
        floor.odds.shape[1] // 2
    }


def test_the_log_goes_to_the_screen_and_back() -> None:
    """While the screen is there it takes the lines; afterwards all is as before."""
    log = logging.getLogger("esair")
    before = (log.level, log.propagate, list(log.handlers))

    with Screen(Console(file=io.StringIO()), live=False) as screen:
        log.warning("ranges: lost")
        log.debug("a detail")

    assert screen.lines == ["ranges: lost"]
    assert (log.level, log.propagate, list(log.handlers)) == before


def test_events_stay_when_the_drawing_is_gone() -> None:
    """After a live show the terminal keeps a line for each event."""
    text = io.StringIO()
    console = Console(file=text, force_terminal=True, width=120, height=40)

    with Screen(console, live=True) as screen:
        screen.tell(
            Event(1.0, "unplug", "the range finder is unplugged", "", (0.0, 0.0))
        )

    assert "the range finder is unplugged" in text.getvalue().rpartition("\x1b[?25h")[2]


@pytest.mark.virtual_clock
async def test_everything_can_be_drawn_at_any_moment() -> None:
    """Before the start, while it runs, and after the end."""
    console = Console(file=io.StringIO(), force_terminal=True, width=120, height=44)
    screen = Screen(console, live=False)

    console.print(screen._draw())
    showing = asyncio.create_task(perform(Ending(), screen, seed=0, duration=9.0))
    for _ in range(10):
        await asyncio.sleep(0.5)
        console.print(screen._draw())
    showing.cancel()
    with pytest.raises(asyncio.CancelledError):
        await showing
    console.print(screen._draw())

    assert "held by" in console.file.getvalue()  # type: ignore[attr-defined]


@pytest.mark.virtual_clock
async def test_on_80_by_24_all_is_seen_and_the_blind_moment_says_why() -> None:
    """The map, the components, the newest events, and why the rover stands still."""
    text = io.StringIO()
    console = Console(file=text, width=80, height=24)
    screen = Screen(console, live=False)
    screen.live = True  # events are drawn, not printed
    showing = asyncio.create_task(perform(Ending(), screen, seed=0, duration=16.0))
    await asyncio.sleep(6.0)

    console.print(screen._draw())
    showing.cancel()
    with pytest.raises(asyncio.CancelledError):
        await showing

    lines = text.getvalue().splitlines()
    assert len(lines) <= 24
    assert max(map(len, lines)) <= 80
    shown = "\n".join(lines)
    assert "the rover stands still: avoid is blind: ranges lost" in shown
    assert "the range finder is unplugged" in shown
    assert "ranges" in shown
    assert "lost" in shown
    assert "▀" in shown
