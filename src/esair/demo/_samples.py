"""How things were, moment by moment, and at the end."""

from __future__ import annotations

import asyncio
import collections
from collections.abc import Callable
from typing import Any

import attrs
from rich.console import Console

from esair import journal
from esair.connections import LastCommand
from esair.demo._mapper import Belief, Mapper
from esair.demo._reactions import Bump
from esair.demo._values import Twist
from esair.journal import Kind
from esair.loop import every
from esair.seat.screen import picture
from esair.sim import Arena, Simulation
from esair.standard import Robot

SAMPLE_PERIOD = 0.05  # Between two samples, in seconds
SAMPLE_LIMIT = 20_000  # How many samples are kept; then the newest win

STILL = Twist(0.0, 0.0)


@attrs.frozen
class Event:
    """Something that happened."""

    time: float  # In seconds since the show began
    # ``person``, ``unplug``, ``plug``, ``refuse``, ``swap``, ``bump`` or ``end``
    kind: str
    text: str  # What it was, in one line
    place: tuple[float, float]  # Where the rover was, in metres
    detail: str = ""  # What came of it, in one line


@attrs.frozen
class Sample:
    """How things were at a moment."""

    time: float  # In seconds since the show began
    place: tuple[float, float]  # Where the rover really was, in metres
    holder: str | None  # Who held the wheels; None if nobody did
    asked: float  # The speed that the holder had asked for last, in m/s
    linear: float  # The speed that the wheels were told last, in m/s
    sees: bool  # Whether the range finder was there


class Witness:
    """Sees everything and changes nothing: it is no part of the robot."""

    def __init__(
        self,
        robot: Robot,
        simulation: Simulation,
        mapper: Mapper,
        bump: Bump,
        on_event: Callable[[Event], None],
    ) -> None:
        self.samples: collections.deque[Sample] = collections.deque(maxlen=SAMPLE_LIMIT)
        self.events: list[Event] = []  # What has happened, in the order of its telling
        self.belief = mapper.belief()  # What the mapper believed last
        self.asked = self.told = STILL
        self.lost: dict[str, float] = {}  # When each device was lost last
        self._robot = robot
        self._simulation = simulation
        self._mapper = mapper
        self._bump = bump
        self._on_event = on_event
        self._wanted: dict[str, Any] = {}
        self._time = asyncio.get_running_loop().time
        self._begin = self._time()
        kinds = (Kind.COMMAND, Kind.SENT, Kind.SAFE, Kind.DOWN)
        robot.journal.listen(self._hear, kinds=kinds)

    @property
    def now(self) -> float:
        """Seconds since the show began."""
        return self._time() - self._begin

    @property
    def is_braked(self) -> bool:
        """Whether the wheels were told less than they were asked for."""
        return bool(self.told.linear < self.asked.linear - 0.05)

    def event(self, kind: str, text: str) -> Event:
        """Return what happens now and here; what comes of it is told later."""
        pose = self._simulation.world.pose
        return Event(self.now, kind, text, (pose.x, pose.y))

    def tell(self, event: Event, detail: str) -> None:
        """Tell what came of an event."""
        event = attrs.evolve(event, detail=detail)
        self.events.append(event)
        self._on_event(event)

    def _hear(self, event: journal.Event) -> None:
        if event.kind is Kind.DOWN:
            self.lost[event.component] = event.time - self._begin
        elif event.kind is Kind.COMMAND:
            self._wanted[event.peer] = event.value
        elif event.kind is Kind.SAFE:
            self.asked = self.told = event.value
        else:  # one that a guard has made less has no sender
            self.asked = self._wanted.get(event.peer, self.asked)
            self.told = event.value

    async def look(self) -> None:
        """Take a sample every 0.05 s, and look into the mapper now and then, for ever."""
        bumps = self._bump.bumps
        async for _ in every(SAMPLE_PERIOD):
            pose = self._simulation.world.pose
            self.samples.append(
                Sample(
                    self.now,
                    (pose.x, pose.y),
                    self._robot.resources.why("wheels").holder,
                    self.asked.linear,
                    self.told.linear,
                    self._simulation.front.plugged,
                )
            )
            if len(self.samples) % 4 == 1:
                self.belief = self._mapper.belief()
            if self._bump.bumps > bumps:
                touched = "it touches something low, over which its beams look"
                self.tell(self.event("bump", touched), "the reaction bump backs off")
            bumps = self._bump.bumps


@attrs.frozen
class Run:
    """What is left of a run: the picture shows it, and the numbers."""

    arena: Arena
    belief: Belief  # What the rover believes at the end
    samples: tuple[Sample, ...]  # Where it was, and who drove it, in order
    events: tuple[Event, ...]
    seconds: float  # How long it took
    distance: float  # How far the rover drove, in metres
    known: float  # Which part of the floor it knows at the end, 0 to 1
    error: float  # How far its belief of where it is was off at the end, in metres
    bumps: int  # How often it touched something
    status: dict[str, Any]
    # What each actuator was told last, and whether it answered
    told: tuple[LastCommand, ...]
    unmet: tuple[str, ...]  # What should have happened and did not

    @property
    def headline(self) -> str:
        """The run in one line."""
        bumps = "1 bump" if self.bumps == 1 else f"{self.bumps} bumps"
        known = f"{100 * self.known:.0f} % of the floor known"
        error = f"position off by {100 * self.error:.0f} cm"
        return (
            f"{self.distance:.1f} m in {self.seconds:.0f} s, {known}, {error}, {bumps}"
        )

    def show(self, console: Console) -> None:
        """Print it."""
        console.print()
        console.print(picture(self.status, console, height=10_000, hint=""))
        console.print()
        for told in self.told:
            console.print(f"last command: {told}")
        for what in self.unmet:
            console.print(f"[bold red]did not happen in time:[/bold red] {what}")
        console.print(f"[bold]{self.headline}[/bold]")
