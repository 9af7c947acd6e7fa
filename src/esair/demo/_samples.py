"""How things were, moment by moment: for the screen and the picture."""

from __future__ import annotations

import asyncio
import collections
from typing import Any

import attrs

from esair.demo._mapper import Mapper
from esair.demo._values import Twist
from esair.journal import Event, Kind
from esair.loop import every
from esair.sim import Simulation
from esair.standard import Robot

SAMPLE_PERIOD = 0.05  # Between two samples, in seconds
SAMPLE_LIMIT = 20_000  # How many samples are kept; then the newest win

STILL = Twist(0.0, 0.0)


@attrs.frozen
class Sample:
    """How things were at a moment."""

    time: float  # In seconds since the show began
    place: tuple[float, float]  # Where the rover really was, in metres
    heading: float  # In rad
    holder: str | None  # Who held the wheels; None if nobody did
    asked: float  # The speed that the holder had asked for last, in m/s
    linear: float  # The speed that the wheels were told last, in m/s
    sees: bool  # Whether the range finder was there


class Witness:
    """Sees everything and changes nothing: it is no part of the robot."""

    def __init__(self, robot: Robot, simulation: Simulation, mapper: Mapper) -> None:
        self.samples: collections.deque[Sample] = collections.deque(maxlen=SAMPLE_LIMIT)
        self.belief = mapper.belief()  # What the mapper believed last
        self.asked = self.told = STILL
        # When each device was lost, and when it was back, the newest
        self.turns: dict[tuple[str, Kind], float] = {}
        self._robot = robot
        self._simulation = simulation
        self._mapper = mapper
        self._wanted: dict[str, Any] = {}
        kinds = (Kind.COMMAND, Kind.SENT, Kind.SAFE, Kind.UP, Kind.DOWN)
        robot.journal.listen(self._hear, kinds=kinds)

    @property
    def is_braked(self) -> bool:
        """Whether the wheels were told less than they were asked for."""
        return bool(self.told.linear < self.asked.linear - 0.05)

    def _hear(self, event: Event) -> None:
        if event.kind in {Kind.UP, Kind.DOWN}:
            self.turns[event.component, event.kind] = event.time
        elif event.kind is Kind.COMMAND:
            self._wanted[event.peer] = event.value
        elif event.kind is Kind.SAFE:
            self.asked = self.told = event.value
        else:  # one that a guard has made less has no sender
            self.asked = self._wanted.get(event.peer, self.asked)
            self.told = event.value

    async def look(self) -> None:
        """Take a sample every 0.05 s, and look into the mapper now and then, for ever."""
        loop = asyncio.get_running_loop()
        begin = loop.time()
        async for _ in every(SAMPLE_PERIOD):
            pose = self._simulation.world.pose
            self.samples.append(
                Sample(
                    loop.time() - begin,
                    (pose.x, pose.y),
                    pose.heading,
                    self._robot.resources.why("wheels").holder,
                    self.asked.linear,
                    self.told.linear,
                    self._simulation.front.plugged,
                )
            )
            if len(self.samples) % 4 == 1:
                self.belief = self._mapper.belief()
