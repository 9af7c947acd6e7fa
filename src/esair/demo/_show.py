"""The show: the rover in its world, from the first line to the picture."""

from __future__ import annotations

import asyncio
import collections
import contextlib
import importlib.resources
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TextIO

import attrs
from rich.console import Console
from rich.text import Text

from esair.actions import MinimalReaction
from esair.buses import Frame
from esair.config import build, load
from esair.demo._journeys import Explore
from esair.demo._mapper import Belief
from esair.demo._picture import Run, draw
from esair.demo._reactions import Bump
from esair.demo._screen import Screen
from esair.demo._story import Event, Story
from esair.demo._summary import Row, Summary
from esair.demo._witness import SAMPLE_LIMIT, Sample, Witness, take_samples
from esair.drivers.wheel_motor import LEFT, command_id
from esair.exceptions import EsairError, describe
from esair.loop import every
from esair.sim import Simulation
from esair.standard import Robot

INTERRUPTED = 130
"""The exit code after Ctrl-C: 128 and the number of SIGINT."""

UNUSABLE = 2
"""The exit code if a file that was asked for cannot be written."""

BROKEN = 1
"""The exit code if something that should have happened did not."""


@attrs.define
class Ending:
    """What is left of a run: what the table and the picture show.

    Attributes:
        robot: The robot, which has stopped.
        run: What the picture shows; None if the run was cut short.
        summary: What the table shows; None if the run was cut short.
        frames: All frames that were on the CAN bus, with their times.
    """

    robot: Robot | None = None
    run: Run | None = None
    summary: Summary | None = None
    frames: list[tuple[float, Frame]] = attrs.field(factory=list)


def show(
    *, fast: bool, seed: int, out: Path, duration: float, record: Path | None
) -> int:
    """Run the show; see `esair.demo.demo`."""
    console = Console(highlight=False)
    for path in (out, record):
        if path is not None and (path.is_dir() or not path.absolute().parent.is_dir()):
            return _unusable(path, "expected a file in a folder that is there")
    ending = Ending()
    try:
        with contextlib.ExitStack() as stack:
            try:
                recorder = stack.enter_context(_recorder(record))
            except OSError as error:
                return _unusable(record, describe(error))
            screen = stack.enter_context(Screen(console, live=not fast))
            runner = stack.enter_context(_runner(fast=fast, seed=seed))
            runner.run(
                perform(ending, screen, seed=seed, duration=duration, recorder=recorder)
            )
    except KeyboardInterrupt:
        console.print("stopped by Ctrl-C")
        for told in ending.robot.stopped if ending.robot is not None else ():
            console.print(f"  {told}")
        return INTERRUPTED
    assert ending.summary is not None
    assert ending.run is not None
    ending.summary.show(console)
    try:
        draw(ending.run, out)
    except OSError as error:
        return _unusable(out, describe(error))
    console.print("\nthe picture is in", Text(str(out), "bold"))
    return BROKEN if ending.summary.unmet else 0


def _unusable(path: Path | None, why: str) -> int:
    message = f"esair: {path} cannot be written: {why}"
    print(message, file=sys.stderr)  # noqa: T201 - this is the command line
    return UNUSABLE


async def perform(
    ending: Ending,
    screen: Screen,
    *,
    seed: int,
    duration: float,
    recorder: TextIO | None = None,
) -> None:
    """Let the rover run through all events, in the running event loop.

    Args:
        ending: Gets what is left at the end.
        screen: Shows it.
        seed: Decides all noise.
        duration: How long it may take, in seconds.
        recorder: Gets a line for every CAN frame.
    """
    async with Simulation(seed=seed) as simulation:
        described = load(_robot_file(), simulated=True)
        robot = ending.robot = build(described)
        explore, reflex = described.behaviors["explore"], described.behaviors["bump"]
        assert isinstance(explore, Explore)
        assert isinstance(reflex, MinimalReaction)
        bump = reflex.reaction
        assert isinstance(bump, Bump)
        if recorder is not None:
            simulation.on_frame = lambda time, frame: _record(recorder, time, frame)
        loop = asyncio.get_running_loop()
        began = loop.time()
        events: list[Event] = []
        samples: collections.deque[Sample] = collections.deque(maxlen=SAMPLE_LIMIT)
        witness = Witness()

        def tell(event: Event) -> None:
            events.append(event)
            screen.tell(event)

        async with robot:
            await robot.behaviors.add(witness)
            screen.robot, screen.witness = robot, witness
            screen.samples, screen.duration = samples, duration
            story = Story(robot, simulation, tell, explore=explore, duration=duration)
            watchers = [
                loop.create_task(take_samples(robot, simulation, samples)),
                loop.create_task(_watch_bumps(bump, simulation, events)),
            ]
            try:
                await story.play()
                belief = await _last_belief(robot, witness)
                rows = _rows(robot, witness, story, simulation)
            finally:
                for watcher in watchers:
                    watcher.cancel()
                await asyncio.wait(watchers)
                screen.robot = None
        seconds = loop.time() - began
        ending.frames = list(simulation.frames)
        pose = simulation.world.pose
        ending.summary = Summary(
            seconds=seconds,
            distance=simulation.world.distance,
            known=belief.floor.known(simulation.world.arena.size),
            error=belief.position.distance_to(pose.x, pose.y),
            bumps=bump.bumps,
            rows=rows,
            faults=tuple(story.faults),
            told=robot.stopped,
            unmet=tuple(story.unmet),
        )
        events.sort(key=lambda event: event.time)
        ending.run = Run(
            simulation.world.arena,
            belief.floor,
            tuple(samples),
            tuple(events),
            ending.summary.headline,
        )


async def _last_belief(robot: Robot, witness: Witness) -> Belief:
    try:
        belief: Belief = await robot.behaviors.get(sender="mapper", receiver="witness")
    except EsairError:
        assert witness.belief is not None
        return witness.belief
    return belief


async def _watch_bumps(bump: Bump, simulation: Simulation, events: list[Event]) -> None:
    loop = asyncio.get_running_loop()
    begin = loop.time()
    count = bump.bumps
    async for _ in every(0.05):
        if bump.bumps > count:
            pose = simulation.world.pose
            place = (pose.x, pose.y)
            events.append(
                Event(loop.time() - begin, "bump", "it touched something", "", place)
            )
        count = bump.bumps


def _rows(
    robot: Robot, witness: Witness, story: Story, simulation: Simulation
) -> tuple[Row, ...]:
    rows: list[Row] = []
    for name, pace in witness.paces.items():
        status = robot.resources.query(name)
        trouble = _words(("lost", status.losses), ("faults", status.faults))
        rows.append(Row.of_pace(name, status.state.value, pace, trouble))
    told = sum(frame.id == command_id(LEFT) for _, frame in simulation.frames)
    wheels = robot.resources.query("wheels")
    rows.append(
        Row(
            "wheels",
            wheels.state.value,
            told,
            told / max(simulation.time, 1e-9),
            None,
            _words(("lost", wheels.losses), ("faults", wheels.faults)),
        )
    )
    explored = story.explore
    trouble = _words(
        ("blind", explored.blind),
        ("refused", explored.refused),
        ("late", explored.pace.skipped),
    )
    rows.append(Row.of_pace("explore", "replaced", explored.pace, trouble))
    home = story.home
    if home is not None:
        restarts = robot.behaviors.query("explore").restarts
        trouble = _words(
            ("refused", home.refused),
            ("late", home.pace.skipped),
            ("restarts", restarts),
        )
        state = "arrived" if home.arrived else "on its way"
        rows.append(Row.of_pace("home", state, home.pace, trouble))
    for name in ("mapper", "avoid", "bump"):
        behavior = robot.behaviors.query(name)
        count = behavior.steps
        if name == "mapper" and witness.belief is not None:
            count = witness.belief.sweeps
        trouble = _words(("late", behavior.late), ("restarts", behavior.restarts))
        rate = count / max(simulation.time, 1e-9)
        rows.append(Row(name, behavior.state.value, count, rate, None, trouble))
    return tuple(rows)


def _words(*counts: tuple[str, int]) -> str:
    return ", ".join(f"{count} {word}" for word, count in counts if count)


def _robot_file() -> Path:
    file = importlib.resources.files("esair.demo").joinpath("robot.toml")
    with importlib.resources.as_file(file) as path:
        return path


@contextlib.contextmanager
def _runner(*, fast: bool, seed: int) -> Iterator[asyncio.Runner]:
    if not fast:
        with asyncio.Runner() as runner:
            yield runner
        return
    from esair.testing import VirtualLoop

    with asyncio.Runner(loop_factory=lambda: VirtualLoop(seed=seed)) as runner:
        yield runner


@contextlib.contextmanager
def _recorder(path: Path | None) -> Iterator[TextIO | None]:
    if path is None:
        yield None
        return
    # A line at a time, so that it can be followed while the rover drives.
    with path.open("w", buffering=1, encoding="ascii") as file:
        yield file


def _record(file: TextIO, time: float, frame: Frame) -> None:
    """Write a frame as candump does: (seconds) interface id#data."""
    file.write(f"({time:.6f}) sim {frame.id:03X}#{frame.data.hex().upper()}\n")
