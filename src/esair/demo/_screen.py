"""The show in the terminal: the map, the components, and what has happened."""

from __future__ import annotations

import collections
import itertools
import logging
from types import TracebackType

import numpy as np
from rich.console import Console, ConsoleOptions, Group, RenderableType, RenderResult
from rich.layout import Layout
from rich.live import Live
from rich.panel import Panel
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from esair.demo._map import FloorMap
from esair.demo._story import Event
from esair.demo._witness import Sample, Witness
from esair.exceptions import EsairError
from esair.messages import BehaviorState, ResourceState
from esair.standard import Robot

FRAMES_PER_SECOND = 4
EVENTS_SHOWN = 6
LOG_SHOWN = 5

WIDE, TALL = 100, 44
"""From how many columns and lines on the whole picture is drawn."""

SIGNS = {
    "unplug": ("✕", "red"),
    "plug": ("✓", "green"),
    "refuse": ("⊘", "yellow"),
    "swap": ("⇄", "cyan"),
    "bump": ("!", "magenta"),
    "end": ("■", "white"),
}
"""A sign and a color for each kind of event."""

_STATES = {
    ResourceState.READY: "green",
    ResourceState.LOST: "red",
    BehaviorState.RUNNING: "green",
    BehaviorState.PARKED: "yellow",
    BehaviorState.FINISHED: "cyan",
    BehaviorState.FAILED: "red",
}


class Screen(logging.Handler):
    """Shows a robot while it runs, if anybody looks at the terminal.

    Where no terminal is, each event is one line of text.

    Args:
        console: Where to show it.
        live: Whether to draw; else lines of text only.
    """

    def __init__(self, console: Console, *, live: bool) -> None:
        super().__init__(logging.INFO)
        self.console = console
        self.live = live and console.is_terminal
        self.lines: list[str] = []
        """What the robot has logged."""
        self.robot: Robot | None = None
        self.witness: Witness | None = None
        self.samples: collections.deque[Sample] = collections.deque()
        self.duration = 1.0
        self._events: collections.deque[Event] = collections.deque(maxlen=EVENTS_SHOWN)
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
                get_renderable=self._draw,
                refresh_per_second=FRAMES_PER_SECOND,
                transient=True,
            )
            self._drawing.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if self._drawing is not None:
            self._drawing.stop()
            self._drawing = None
            for event in self._events:  # the drawing is gone; what happened stays
                self.console.print(_line(event))
        log = logging.getLogger("esair")
        log.removeHandler(self)
        log.level, log.propagate = self._before

    def emit(self, record: logging.LogRecord) -> None:
        """Keep a line of the log, without its traceback."""
        self.lines.append(record.getMessage())
        del self.lines[:-1000]

    def tell(self, event: Event) -> None:
        """Show an event."""
        self._events.append(event)
        if not self.live:
            self.console.print(_line(event))

    # Drawing.

    def _draw(self) -> RenderableType:
        if self.console.width < WIDE or self.console.height < TALL:
            return self._draw_small()
        layout = Layout()
        layout.split_column(
            Layout(self._head(), size=3),
            Layout(name="middle", minimum_size=24, ratio=1),
            Layout(self._foot(), size=EVENTS_SHOWN + LOG_SHOWN + 4),
        )
        layout["middle"].split_row(
            Layout(Panel(self._map(), title="what it believes"), size=70),
            Layout(Panel(self._components(), title="components")),
        )
        height = 3 + 26 + EVENTS_SHOWN + LOG_SHOWN + 4
        return _Fixed(layout, min(height, max(20, self.console.height - 1)))

    def _draw_small(self) -> RenderableType:
        """Draw what fits on 80 x 24: each line of the map is a coarser one."""
        layout = Layout()
        layout.split_column(
            Layout(self._bar(), size=1),
            Layout(self._wheels(), size=1),
            Layout(name="middle", size=11),
            Layout(self._events_alone(), ratio=1),
        )
        layout["middle"].split_row(
            Layout(self._map(factor=4), size=34),
            Layout(self._components()),
        )
        return _Fixed(layout, max(16, self.console.height - 1))

    def _wheels(self) -> RenderableType:
        """Say in one line who moves the wheels, or why they stand."""
        if self.robot is None:
            return Text("starting", "dim")
        why = self.robot.resources.why("wheels")
        if why.holder is None:
            return Text(f"wheels: free, told {why.last}", "bold", no_wrap=True)
        if " is blind" in why.rule:
            return Text(f"the rover stands still: {why.rule}", "bold red", no_wrap=True)
        return Text(f"wheels: held by {why.holder}, {why.rule}", "bold", no_wrap=True)

    def _events_alone(self) -> RenderableType:
        rows = max(1, self.console.height - 14)
        lines: list[Text] = []
        for event in reversed(self._events):
            wrapped = _line(event).wrap(self.console, self.console.width)
            if len(lines) + len(wrapped) > rows:
                break
            lines = [*wrapped, *lines]
        return Group(*lines)

    def _head(self) -> RenderableType:
        return Panel(self._bar())

    def _bar(self) -> RenderableType:
        time = self.samples[-1].time if self.samples else 0.0
        bar = ProgressBar(total=self.duration, completed=min(time, self.duration))
        table = Table.grid(expand=True, padding=(0, 2))
        table.add_column()
        table.add_column(ratio=1)
        table.add_column(justify="right")
        table.add_row(
            Text("esair demo", "bold"),
            bar,
            Text(f"{time:5.1f} s   Ctrl-C stops the wheels", "dim"),
        )
        return table

    def _map(self, factor: int = 2) -> RenderableType:
        belief = self.witness.belief if self.witness is not None else None
        if belief is None:
            return Text("nothing yet", "dim")
        pose = belief.position
        track = [sample.place for sample in tuple(self.samples)[::4]]
        return draw_map(belief.floor, track, (pose.x, pose.y, pose.heading), factor)

    def _components(self) -> RenderableType:
        table = Table(box=None, expand=True, padding=(0, 1))
        table.add_column("name")
        table.add_column("state")
        table.add_column("Hz", justify="right")
        robot = self.robot
        if robot is None:
            return Text("starting", "dim")
        for name in robot.resources.names():
            state = robot.resources.query(name).state
            pace = self.witness.paces.get(name) if self.witness is not None else None
            rate = f"{pace.rate:.0f}" if pace is not None and pace.count > 1 else ""
            table.add_row(name, Text(state.value, _STATES.get(state, "yellow")), rate)
        table.add_row("", "", "")
        for name in robot.behaviors.names():
            try:
                behavior = robot.behaviors.query(name).state
            except EsairError:  # it was removed while this was drawn
                continue
            table.add_row(
                name, Text(behavior.value, _STATES.get(behavior, "yellow")), ""
            )
        table.add_row("", "", "")
        why = robot.resources.why("wheels")
        table.add_row("wheels", Text(f"held by {why.holder or 'nobody'}", "bold"), "")
        return table

    def _foot(self) -> RenderableType:
        events = [_line(event) for event in self._events]
        log = [
            Text(f"  log: {line}", "dim", no_wrap=True)
            for line in self.lines[-LOG_SHOWN:]
        ]
        return Panel(Group(*events, *log), title="what has happened")


class _Fixed:
    """A layout of a fixed height."""

    def __init__(self, layout: Layout, height: int) -> None:
        self._layout = layout
        self._height = height

    def __rich_console__(
        self, console: Console, options: ConsoleOptions
    ) -> RenderResult:
        yield from console.render(self._layout, options.update_height(self._height))


def draw_map(
    floor: FloorMap,
    track: list[tuple[float, float]],
    pose: tuple[float, float, float],
    factor: int = 2,
) -> Text:
    """Draw a map with half blocks: two rows of it in each line of text.

    Args:
        floor: The map.
        track: Where the rover has been, in metres.
        pose: Where it is: x, y in metres, heading in rad.
        factor: How many cells of the map, across and along, are one point.
    """
    height, width = (length // factor * factor for length in floor.odds.shape)
    cut = floor.odds[:height, :width]
    blocks = cut.reshape(height // factor, factor, width // factor, factor)
    most = blocks.max(axis=(1, 3))
    mean = blocks.mean(axis=(1, 3))
    colors = np.full(most.shape, 0)
    colors[mean < -0.2] = 1
    colors[most > 0.6] = 2
    rows, columns = colors.shape
    for color, places in ((3, track), (4, [pose[:2]])):
        for x, y in places:
            row, column = floor.cell_of(x, y)
            colors[min(row // factor, rows - 1), min(column // factor, columns - 1)] = (
                color
            )
    if len(colors) % 2:
        colors = np.vstack([colors, np.zeros((1, colors.shape[1]), colors.dtype)])
    names = ("#1c1f26", "#c9cdd4", "#3b6ea5", "#e08a3c", "#d62828")
    text = Text(no_wrap=True)
    for upper, lower in zip(colors[-1::-2], colors[-2::-2], strict=True):
        # Runs of the same colors are one piece: there are ten times fewer of them.
        for (above, below), run in itertools.groupby(zip(upper, lower, strict=True)):
            text.append("▀" * len(list(run)), f"{names[above]} on {names[below]}")
        text.append("\n")
    return text


def _line(event: Event) -> Text:
    sign, color = SIGNS[event.kind]
    text = Text(f"{event.time:6.2f} s ", "dim")
    text.append(f"{sign} {event.text}", f"bold {color}")
    text.append(f": {event.detail}", "not bold")
    return text
