"""The show in the terminal: the screen of ``esair top``, with the map and the story."""

from __future__ import annotations

import collections
import itertools
import logging
import math
from typing import Any

import attrs
import numpy as np
from rich.console import Console, RenderableType
from rich.live import Live
from rich.text import Text

from esair.demo._map import FloorMap
from esair.demo._samples import Event
from esair.seat.screen import picture

COLORS = ("#1c1f26", "#c9cdd4", "#3b6ea5", "#e08a3c", "#d62828")
"""Unknown, free, occupied, track, rover."""


@attrs.frozen(eq=False)
class Drawing:
    """A map with what was driven on it."""

    floor: FloorMap
    track: tuple[tuple[float, float], ...]  # Where the rover has been, in metres
    place: tuple[float, float]  # Where it is, in metres

    def __call__(self, width: int, height: int) -> Text:
        """Draw it on so many columns and lines: as fine as there is room."""
        rows, columns = self.floor.odds.shape
        factor = max(2, math.ceil(columns / width), math.ceil(rows / (2 * height)))
        # How many cells of the map, across and along, are one point.
        tall, wide = (length // factor for length in self.floor.odds.shape)
        cut = self.floor.odds[: tall * factor, : wide * factor]
        blocks = cut.reshape(tall, factor, wide, factor)
        colors = np.zeros((tall, wide), int)
        colors[blocks.mean(axis=(1, 3)) < -0.2] = 1
        colors[blocks.max(axis=(1, 3)) > 0.6] = 2
        for color, places in ((3, self.track), (4, (self.place,))):
            for x, y in places:
                row, column = self.floor.cell_of(x, y)
                colors[
                    min(row // factor, tall - 1), min(column // factor, wide - 1)
                ] = color
        if tall % 2:
            colors = np.vstack([colors, np.zeros((1, wide), int)])
        lines: list[Text] = []
        for upper, lower in zip(colors[-1::-2], colors[-2::-2], strict=True):
            line = Text(no_wrap=True)
            # Runs of the same colors are one piece: there are ten times fewer of them.
            for (above, below), run in itertools.groupby(
                zip(upper, lower, strict=True)
            ):
                line.append("▀" * len(list(run)), f"{COLORS[above]} on {COLORS[below]}")
            lines.append(line)
        return Text("\n", no_wrap=True).join(lines)


FRAMES_PER_SECOND = 4
EVENTS_KEPT = 20

HINT = "esair demo: Ctrl-C stops the wheels"

SIGNS = {
    "person": ("☻", "blue"),
    "unplug": ("✕", "red"),
    "plug": ("✓", "green"),
    "refuse": ("⊘", "yellow"),
    "swap": ("⇄", "cyan"),
    "bump": ("!", "magenta"),
    "end": ("■", "white"),
}
"""A sign and a color for each kind of event."""


class Screen(logging.Handler):
    """Shows a robot while it runs, if anybody looks at the terminal.

    Where no terminal is, each event is one line of text.
    """

    def __init__(self, console: Console, *, live: bool) -> None:
        super().__init__(logging.INFO)
        self.console = console
        self.live = live and console.is_terminal
        self.lines: list[str] = []  # What the robot has logged
        self._shown: tuple[dict[str, Any], Drawing | None] | None = None
        self._events: collections.deque[Event] = collections.deque(maxlen=EVENTS_KEPT)
        self._drawing: Live | None = None

    def __enter__(self) -> Screen:
        log = logging.getLogger("esair")
        self._before = (log.level, log.propagate)
        log.setLevel(logging.INFO)
        log.propagate = False
        log.addHandler(self)
        if self.live:
            # The drawing is done in rich's own thread, not in the event loop.
            self._drawing = Live(
                console=self.console,
                get_renderable=self.draw,
                refresh_per_second=FRAMES_PER_SECOND,
                transient=True,
            )
            self._drawing.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._drawing is not None:
            self._drawing.stop()
            self._drawing = None
            for event in self._events:  # the drawing is gone; what happened stays
                self.console.print(_line(event))
        log = logging.getLogger("esair")
        log.removeHandler(self)
        level, log.propagate = self._before
        log.setLevel(level)  # what was cached of the other level goes with it

    def emit(self, record: logging.LogRecord) -> None:
        """Keep a line of the log, without its traceback."""
        self.lines.append(record.getMessage())
        del self.lines[:-1000]

    def tell(self, event: Event) -> None:
        """Show an event."""
        self._events.append(event)
        if not self.live:
            self.console.print(_line(event))

    def show(self, status: dict[str, Any], drawing: Drawing | None) -> None:
        """Show how things are from now on; nobody changes them any more."""
        self._shown = status, drawing

    def draw(self) -> RenderableType:
        """Return the screen as it is now; in any thread."""
        if self._shown is None:
            return Text("the rover wakes up; Ctrl-C stops it", "dim")
        status, drawing = self._shown
        happened = [_line(event) for event in self._events.copy()]
        return picture(
            status,
            self.console,
            happened=happened,
            drawing=drawing,
            height=self.console.height - 1,
            hint=HINT,
        )


def _line(event: Event) -> Text:
    sign, color = SIGNS[event.kind]
    text = Text(f"{event.time:5.1f} s ", "dim")
    text.append(f"{sign} {event.text}", f"bold not dim {color}")
    text.append(f": {event.detail}" if event.detail else "", "not bold not dim")
    return text
