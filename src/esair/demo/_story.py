"""What happens to the rover, and when; how things were, moment by moment, and at the end."""

from __future__ import annotations

import asyncio
import collections
import math
from collections.abc import Callable
from typing import Any

import attrs
from rich.console import Console

from esair import journal
from esair.actions import Behavior, writes
from esair.connections import LastCommand
from esair.demo._journeys import Explore, Home
from esair.demo._mapper import Belief, Mapper
from esair.demo._reactions import Bump
from esair.demo._values import Twist
from esair.drivers.wheel_motor import LEFT, RIGHT, command_id, decode_command
from esair.journal import Kind
from esair.loop import ask_outside, every
from esair.messages import BehaviorState, Refused, ResourceState
from esair.seat.screen import picture
from esair.sim import Arena, Pillar, Simulation
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


LOOK_PERIOD = 0.005  # How often it is looked whether something has happened, in seconds
OUTAGE = 2.5  # For how long the range finder is unplugged, in seconds
PATIENCE = 6.0  # How long to wait for what must happen, in seconds


class Passenger(Behavior):
    """Wants to drive too, but comes last."""

    wheels = writes(Twist, priority=-10)

    def __init__(self, *, name: str | None = None) -> None:
        super().__init__(name=name)
        self.answer: Refused | None = None

    async def run(self) -> None:
        """Ask for the wheels while somebody has them."""
        while self.answer is None:
            if self.wheels.why().holder is not None:
                outcome = await self.wheels.write(Twist(0.6, 0.0))
                if isinstance(outcome, Refused):
                    self.answer = outcome
                    return
            await asyncio.sleep(0.05)


class Story:
    """Lets the events happen, and tells what came of them.

    Attributes:
        unmet: What should have happened and did not, in words.
    """

    def __init__(
        self,
        robot: Robot,
        simulation: Simulation,
        witness: Witness,
        *,
        explore: Explore,
        duration: float,
    ) -> None:
        self.unmet: list[str] = []
        self._explore = explore
        self._robot = robot
        self._simulation = simulation
        self._witness = witness
        self._duration = duration

    async def play(self) -> None:
        """Let everything happen, in its order."""
        for part, happens in (
            (0.14, self._step_in_the_way),
            (0.28, self._lose_range_finder),
            (0.48, self._refuse_passenger),
            (0.58, self._send_home),
        ):
            await self._until(part * self._duration)
            await happens()

    # The events.

    async def _step_in_the_way(self) -> None:
        world, witness = self._simulation.world, self._witness
        await self._happens(
            "the rover drives on freely",
            lambda: (
                witness.told.linear > 0.4
                and not witness.is_braked
                and world.distance_ahead(0.0, 1.2) is None
            ),
        )
        event = witness.event("person", "somebody steps in the way")
        goes = world.put(self._person(0.42))
        slowed = await self._happens("the brake slows", lambda: witness.is_braked)
        asked, told = witness.asked.linear, witness.told.linear
        goes()
        goes = world.put(self._person(0.34))
        await self._happens(
            "avoid takes the wheels",
            lambda: self._robot.resources.why("wheels").holder == "avoid",
        )
        self._witness.tell(
            event,
            f"the guard brake lets {told:.2f} of {asked:.2f} m/s pass after "
            f"{_ms(slowed)}; nearer still, avoid takes the wheels and turns away",
        )
        await asyncio.sleep(0.6)
        goes()

    def _person(self, ahead: float) -> Pillar:
        pose = self._simulation.world.pose
        x = pose.x + ahead * math.cos(pose.heading)
        return Pillar((x, pose.y + ahead * math.sin(pose.heading)), 0.12)

    async def _lose_range_finder(self) -> None:
        robot, simulation = self._robot, self._simulation
        blind_before = self._explore.blind
        event = self._witness.event("unplug", "the range finder is unplugged")
        unplugged = simulation.time
        simulation.front.unplug()
        await self._happens(
            "the loss is noticed",
            lambda: robot.resources.query("ranges").state is not ResourceState.READY,
        )
        await self._happens("the wheels stop", lambda: self._stopped(unplugged) > 0.0)
        await self._happens(
            "avoid is parked", lambda: self._is("avoid", BehaviorState.PARKED)
        )
        reason, _, _ = robot.resources.why("wheels").rule.partition(":")
        lost = self._witness.lost.get("ranges", event.time) - event.time
        stopped = self._stopped(unplugged)
        self._witness.tell(
            event,
            f"noticed after {_ms(lost)}, both wheels stopped after "
            f"{_ms(stopped - unplugged)}; the rover stands still because {reason}",
        )
        await self._until(event.time + OUTAGE)
        if any(speed > 0.0 for _, _, speed in self._commands(stopped)):
            self.unmet.append("nothing goes ahead while the range finder is away")
        event = self._witness.event("plug", "the range finder is plugged in again")
        plugged = simulation.time
        simulation.front.plug()
        back = await self._happens(
            "the range finder is back", lambda: self._is("avoid", BehaviorState.RUNNING)
        )
        await self._happens(
            "a fresh command moves the wheels", lambda: self._moved(plugged) > 0.0
        )
        moved = self._moved(plugged) - plugged
        # Who moves has seen already, whenever it was looked.
        self._witness.tell(
            event,
            f"back after {_ms(min(back, moved))}, all resume; nothing moved before a "
            f"fresh command of {robot.resources.why('wheels').holder} after "
            f"{_ms(moved)}; {self._explore.blind - blind_before} commands of explore "
            "were not made meanwhile",
        )

    async def _refuse_passenger(self) -> None:
        passenger = Passenger()
        event = self._witness.event(
            "refuse", "a passenger of priority -10 wants the wheels"
        )
        await self._robot.behaviors.add(passenger)
        await self._happens(
            "the passenger is refused", lambda: passenger.answer is not None
        )
        await self._robot.behaviors.remove("passenger")
        if (answer := passenger.answer) is not None:
            self._witness.tell(
                event,
                f"refused: {answer.holder} holds them with priority {answer.priority}",
            )

    async def _send_home(self) -> None:
        event = self._witness.event(
            "swap", "the user sends it to the dock: esair mode dock"
        )
        await self._robot.behaviors.switch("dock", "the show is nearly over")
        took = self._witness.now - event.time
        self._witness.tell(event, f"done in {_ms(took)}, everything else kept running")
        home = self._robot.behaviors.action("dock")
        assert isinstance(home, Home)
        await self._happens(
            "the rover is at its dock, and charges",
            lambda: home.arrived and self._robot.behaviors.mode == "charge",
            patience=self._duration - self._witness.now,
            must=False,
        )
        await asyncio.sleep(0.5)
        where = "charges" if home.arrived else "is on its way to the dock"
        self._witness.tell(
            self._witness.event("end", f"the rover {where}"),
            "the robot stops; the wheels get their safe command last of all",
        )

    # What can be seen.

    def _is(self, behavior: str, state: BehaviorState) -> bool:
        return self._robot.behaviors.query(behavior).state is state

    def _commands(self, since: float) -> list[tuple[float, int, float]]:
        """Return when which wheel was told which speed, in rad/s."""
        sides = {command_id(side): side for side in (LEFT, RIGHT)}
        found: list[tuple[float, int, float]] = []
        for when, frame in reversed(self._simulation.frames):
            if when < since:
                break
            if frame.id in sides:
                command = decode_command(sides[frame.id], frame.data)
                speed = command.speed if command.enable else 0.0
                found.append((when, sides[frame.id], speed))
        return found[::-1]

    def _moved(self, since: float) -> float:
        """Return when a wheel was told to move; 0 if none was."""
        return next((when for when, _, speed in self._commands(since) if speed), 0.0)

    def _stopped(self, since: float) -> float:
        """Return when the later wheel got a stop that nothing followed; 0 if none."""
        stopped = {LEFT: 0.0, RIGHT: 0.0}
        for when, side, speed in self._commands(since):
            stopped[side] = 0.0 if speed else stopped[side] or when
        return max(stopped.values()) if all(stopped.values()) else 0.0

    # Time.

    async def _until(self, time: float) -> None:
        await asyncio.sleep(max(0.0, time - self._witness.now))

    async def _happens(
        self,
        what: str,
        condition: Callable[[], bool],
        *,
        patience: float = PATIENCE,
        must: bool = True,
    ) -> float:
        """Wait until something is so; return how long it took, in seconds."""
        begin = self._witness.now
        tag = ("story", what)  # what a replay cannot see, the recording tells
        while not ask_outside(tag, condition):
            if self._witness.now - begin > patience:
                if must:
                    self.unmet.append(what)
                break
            # It is the world that is looked at: nothing could tell when to look.
            await asyncio.sleep(LOOK_PERIOD)
        return self._witness.now - begin


def _ms(seconds: float) -> str:
    return f"{seconds:.2f} s" if seconds >= 1.0 else f"{1000 * seconds:.0f} ms"
