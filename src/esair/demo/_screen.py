"""The show in the terminal: the screen of ``esair top``, with the map and the story."""

from __future__ import annotations

import collections
import logging
from typing import Any

from rich.console import Console, RenderableType
from rich.live import Live
from rich.text import Text

from esair.demo._drawing import Drawing
from esair.demo._samples import Event
from esair.seat.screen import picture

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
