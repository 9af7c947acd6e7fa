"""Who sees everything and does nothing: for the screen, the table and the picture."""

from __future__ import annotations

import asyncio
import collections
from typing import Any

import attrs

from esair.actions import Behavior, SensorPort, reads
from esair.demo._devices import Travel
from esair.demo._mapper import Belief
from esair.demo._pace import Pace
from esair.demo._values import Scan, Touch
from esair.drivers.mpu6050 import Motion
from esair.exceptions import EsairError
from esair.loop import every
from esair.sim import Simulation
from esair.standard import Robot

SAMPLE_PERIOD = 0.05
"""Between two samples, in seconds."""

SAMPLE_LIMIT = 20_000
"""How many samples are kept; then the newest win."""

NOMINAL = {"ranges": 0.05, "bumper": 0.1, "odometry": 0.02, "imu": 0.02}
"""How often each sensor should speak, in seconds."""


@attrs.frozen
class Sample:
    """How things were at a moment.

    Attributes:
        time: In seconds since the show began.
        place: Where the rover really was, in metres.
        heading: In rad.
        holder: Who held the wheels; None if nobody did.
        linear: The speed that the wheels were told last, in m/s.
        angular: The turn rate that they were told last, in rad/s.
        sees: Whether the range finder was there.
    """

    time: float
    place: tuple[float, float]
    heading: float
    holder: str | None
    linear: float
    angular: float
    sees: bool


class Witness(Behavior):
    """Follows every sensor, and asks the mapper what it believes.

    Attributes:
        paces: How regularly each sensor spoke.
        belief: What the mapper believed last.
    """

    ranges = reads(Scan)
    bumper = reads(Touch)
    odometry = reads(Travel)
    imu = reads(Motion)

    def __init__(self, *, name: str | None = None) -> None:
        super().__init__(name=name)
        self.paces = {sensor: Pace() for sensor in NOMINAL}
        self.belief: Belief | None = None

    async def run(self) -> None:
        """Look until the end."""
        async with asyncio.TaskGroup() as group:
            group.create_task(self._follow("ranges", self.ranges))
            group.create_task(self._follow("bumper", self.bumper))
            group.create_task(self._follow("odometry", self.odometry))
            group.create_task(self._follow("imu", self.imu))
            group.create_task(self._ask())

    async def _follow(self, name: str, port: SensorPort[Any]) -> None:
        pace = self.paces[name]
        loop = asyncio.get_running_loop()
        async for _ in port:
            now = loop.time()
            before = pace.last
            # After an outage the clock of the sensor begins anew.
            going_on = before is not None and now - before < 20 * NOMINAL[name]
            pace.note(now, before + NOMINAL[name] if going_on and before else None)

    async def _ask(self) -> None:
        async for _ in every(0.2):
            try:
                self.belief = await self.get("mapper", interval=0.1)
            except EsairError:
                continue  # it is busy or restarts; the picture is a little older then


async def take_samples(
    robot: Robot, simulation: Simulation, samples: collections.deque[Sample]
) -> None:
    """Add a sample every 0.05 s, for ever."""
    loop = asyncio.get_running_loop()
    begin = loop.time()
    async for _ in every(SAMPLE_PERIOD):
        pose = simulation.world.pose
        why = robot.resources.why("wheels")
        samples.append(
            Sample(
                loop.time() - begin,
                (pose.x, pose.y),
                pose.heading,
                why.holder,
                getattr(why.last, "linear", 0.0),
                getattr(why.last, "angular", 0.0),
                simulation.front.plugged,
            )
        )
