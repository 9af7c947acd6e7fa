"""The show: the rover in its world, from the first line to the picture.

In a terminal it is the screen of ``esair top``, with the map and the story.
"""

from __future__ import annotations

import asyncio
import collections
import importlib.resources
import itertools
import logging
import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np
from rich.console import Console, RenderableType
from rich.live import Live
from rich.text import Text

from esair.actions import MinimalReaction
from esair.buses import Frame
from esair.config import Description, build, load
from esair.demo._journeys import Explore
from esair.demo._kill import kill as show_deaths
from esair.demo._mapper import Mapper
from esair.demo._plan import FloorMap
from esair.demo._reactions import Bump
from esair.demo._story import Event, Run, Story, Witness
from esair.exceptions import EsairError, RecordingBrokenError, describe
from esair.loop import TurnLoop, every
from esair.messages import Recording
from esair.seat import Status, robots
from esair.seat.screen import picture
from esair.sim import Simulation
from esair.standard import Robot, recorded_as

if TYPE_CHECKING:
    from esair.replay import Outcome, Replay


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


INTERRUPTED = 130  # The exit code after Ctrl-C: 128 and the number of SIGINT
UNUSABLE = 2  # The exit code if a file that was asked for cannot be written
BROKEN = 1  # The exit code if something that should have happened did not

OnFrame = Callable[[float, Frame], None]


@attrs.define
class Ending:
    """What is left of a run."""

    robot: Robot | None = None  # The robot, which has stopped
    run: Run | None = None  # What the picture shows; None if the run was cut short
    frames: list[tuple[float, Frame]] = attrs.field(factory=list)


def demo(
    *,
    fast: bool = False,
    seed: int = 0,
    out: Path | None = None,
    duration: float = 36.0,
    record: Path | None = None,
    kill: bool = False,
    on_frame: OnFrame | None = None,
) -> int:
    """Let the rover explore an arena while things go wrong on purpose.

    Args:
        fast: Run on a virtual clock, with the wires in memory.
        seed: The same number gives the same run (with ``fast``, to the last command).
        out: Where the picture of the run goes (PNG); ``demo.png`` if None.
        duration: When the rover is called home at last, in seconds.
        record: Where the recording goes (MCAP); needs ``esair[record]``.
        kill: Instead of all that, kill a robot's process while it drives, and show when
            its wheels had their safe frame.
        on_frame: Called with the time and each frame on the CAN bus.

    Returns:
        The exit code: 0, 1 if something did not happen as it should, or 130 after
        Ctrl-C.
    """
    console = Console(highlight=False)
    if kill:
        return show_deaths(console)
    out = out or Path("demo.png")
    for path in (out, record):
        if path is not None and (path.is_dir() or not path.absolute().parent.is_dir()):
            return _unusable(path, "expected a file in a folder that is there")
    if record is not None and record.suffix != ".mcap":
        return _unusable(record, "expected a file named .mcap")
    ending = Ending()
    try:
        with Screen(console, live=not fast) as screen, _runner(fast, seed) as runner:
            runner.run(
                perform(
                    ending,
                    screen,
                    seed=seed,
                    duration=duration,
                    record=record,
                    on_frame=on_frame,
                )
            )
    except KeyboardInterrupt:
        console.print("stopped by Ctrl-C")
        for told in ending.robot.stopped if ending.robot is not None else ():
            console.print(f"  {told}")
        return INTERRUPTED
    except EsairError as error:
        print(f"esair: {describe(error)}", file=sys.stderr)  # noqa: T201 - as below
        return BROKEN
    assert ending.run is not None
    ending.run.show(console)
    from esair.demo._picture import draw  # it takes its time, and the wheels stand now

    try:
        draw(ending.run, out)
    except OSError as error:
        return _unusable(out, describe(error))
    console.print("\nthe picture is in", Text(str(out), "bold"))
    if record is not None:
        console.print("look into the recording: esair log", Text(str(record), "bold"))
    return BROKEN if ending.run.unmet else 0


def _unusable(path: Path, why: str) -> int:
    message = f"esair: {path} cannot be written: {why}"
    print(message, file=sys.stderr)  # noqa: T201 - this is the command line
    return UNUSABLE


async def perform(
    ending: Ending,
    screen: Screen,
    *,
    seed: int,
    duration: float,
    record: Path | None = None,
    on_frame: OnFrame | None = None,
) -> None:
    """Let the rover run through all events, in the running event loop."""
    described = load(_robot_file(), simulated=True)
    async with Simulation(seed=seed) as simulation:
        simulation.on_frame = on_frame
        # ``esair top`` and ``esair stop`` reach it too, where nobody has its name.
        has_socket = not simulation.in_memory and described.name not in robots()
        recording = None if record is None else Recording(record)

        def make(**given: object) -> Robot:
            more = {"seed": seed, "socket": has_socket, "record": recording}
            return Robot(**{**given, **more})  # type: ignore[arg-type]

        robot = build(described, make)
        recorded_as(robot, "demo", seed=seed, duration=duration)
        await _play(ending, screen, robot, described, simulation, duration)


def repeat(recorded: Replay) -> Outcome:
    """Repeat a show that was recorded, for ``esair replay``; a fast one with its world.

    Args:
        recorded: The recording.

    Raises:
        RecordingBrokenError: It is none of a show.
    """
    options = recorded.options
    if recorded.script != "demo" or options.keys() != {"seed", "duration"}:
        raise RecordingBrokenError(str(recorded.path), "it is none of 'esair demo'")
    seed, duration = int(options["seed"]), options["duration"]
    described = load(_robot_file(), simulated=True)

    async def play(robot: Robot) -> None:
        screen = Screen(Console(quiet=True), live=False)
        async with Simulation(seed=seed) as simulation:
            await _play(Ending(), screen, robot, described, simulation, duration)

    return recorded.run(
        build(described), play, _virtual(seed) if recorded.is_virtual else None
    )


async def _play(
    ending: Ending,
    screen: Screen,
    robot: Robot,
    described: Description,
    simulation: Simulation,
    duration: float,
) -> None:
    ending.robot = robot
    explore, reflex = described.behaviors["explore"], described.behaviors["bump"]
    mapper = described.behaviors["mapper"]
    assert isinstance(mapper, Mapper)
    assert isinstance(explore, Explore)
    assert isinstance(reflex, MinimalReaction)
    bump = reflex.reaction
    assert isinstance(bump, Bump)
    loop = asyncio.get_running_loop()
    async with robot:
        witness = Witness(robot, simulation, mapper, bump, screen.tell)
        status = Status(robot, loop)
        story = Story(robot, simulation, witness, explore=explore, duration=duration)
        watchers = [
            loop.create_task(witness.look()),
            loop.create_task(_show(screen, status, witness)),
        ]
        try:
            await story.play()
        finally:
            for watcher in watchers:
                watcher.cancel()
            await asyncio.wait(watchers)
        at_the_end = status.picture()
    ending.frames = list(simulation.frames)
    pose, belief = simulation.world.pose, mapper.belief()
    ending.run = Run(
        arena=simulation.world.arena,
        belief=belief,
        samples=tuple(witness.samples),
        events=tuple(sorted(witness.events, key=lambda event: event.time)),
        seconds=witness.now,
        distance=simulation.world.distance,
        known=belief.floor.known(simulation.world.arena.size),
        error=belief.position.distance_to(pose.x, pose.y),
        bumps=bump.bumps,
        status=at_the_end,
        told=robot.stopped,
        unmet=tuple(story.unmet),
    )


async def _show(screen: Screen, status: Status, witness: Witness) -> None:
    """Hand the screen how things are: it is drawn in another thread."""
    async for _ in every(0.25):
        belief, drawing = witness.belief, None
        if screen.live:
            track = tuple(sample.place for sample in witness.samples)[::4]
            place = (belief.position.x, belief.position.y)
            drawing = Drawing(belief.floor, track, place)
        screen.show(status.picture(), drawing)


def _robot_file() -> Path:
    file = importlib.resources.files("esair.demo").joinpath("robot.toml")
    with importlib.resources.as_file(file) as path:
        return path


def _runner(fast: bool, seed: int) -> asyncio.Runner:
    return asyncio.Runner(loop_factory=lambda: _virtual(seed) if fast else TurnLoop())


def _virtual(seed: int) -> asyncio.AbstractEventLoop:
    from esair.testing import VirtualLoop

    return VirtualLoop(seed=seed)
