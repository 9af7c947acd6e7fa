"""``Mapper``: where the rover is, and what it has seen so far."""

from __future__ import annotations

import asyncio
import math

import attrs
import numpy as np

from esair.actions import Behavior, reads
from esair.demo._devices import Travel
from esair.demo._plan import FloorMap, Position
from esair.demo._values import Scan, Touch
from esair.drivers.mpu6050 import Motion

REACH = 2.45  # How far the range finder is believed, in metres
BUMPER_RADIUS = 0.18  # Where the bumper is, from the rover's centre, in metres


SETTLED = 10  # After how many messages of standing wheels the rover stands still
LEARNED = 40  # After how many more the zero of the gyroscope is known


@attrs.frozen(eq=False)
class Belief:
    """What the mapper believes; nobody changes it any more.

    Attributes:
        position: Where the rover is.
        floor: What stands where.
        settled: Whether the zero of the gyroscope is known.
    """

    position: Position
    floor: FloorMap
    settled: bool


class Mapper(Behavior):
    """Follows the wheels and the gyroscope, and draws what the range finder sees.

    Others ask for the `Belief` by ``get``; nobody gets a map that was not asked for.

    Args:
        start: Where the rover stands at first: x, y in metres, heading in rad.
        size: The size of the floor in metres.
    """

    odometry = reads(Travel)
    imu = reads(Motion)
    ranges = reads(Scan)
    bumper = reads(Touch)

    def __init__(
        self,
        *,
        start: tuple[float, float, float] = (0.7, 0.8, 0.5),
        size: tuple[float, float] = (6.0, 4.0),
        name: str | None = None,
    ) -> None:
        super().__init__(name=name)
        self.start = start
        self.size = size
        self._restart()

    def _restart(self) -> None:
        self._position = Position(*self.start)
        self._floor = FloorMap.empty(self.size)
        self._travel: Travel | None = None
        self._bias = 0.0
        self._still = 0
        self._learned = 0
        self._imu_turn = 0.0
        self._imu_turn_before = 0.0
        self._imu_time: float | None = None
        self._touching = False

    async def run(self) -> None:
        """Follow all sensors until the end."""
        self._restart()
        async with asyncio.TaskGroup() as group:
            group.create_task(self._follow_wheels())
            group.create_task(self._follow_imu())
            group.create_task(self._follow_ranges())
            group.create_task(self._follow_bumper())

    async def provide(self) -> Belief:
        """Make the answer for whoever asks."""
        return self.belief()

    def belief(self) -> Belief:
        """Return what it believes now."""
        return Belief(self._position, self._floor.copy(), self._learned >= LEARNED)

    async def _follow_wheels(self) -> None:
        async for travel in self.odometry:
            before, self._travel = self._travel, travel
            if before is not None:
                self._move(before, travel)

    def _move(self, before: Travel, after: Travel) -> None:
        moved = after.distance - before.distance
        turned = after.turn - before.turn
        standing = abs(after.speed) < 0.002 and abs(after.turn_rate) < 0.01
        self._still = self._still + 1 if standing else 0
        if standing:
            turned = 0.0
        elif self._imu_time is not None and after.time - self._imu_time < 0.1:
            # A gyroscope drifts, but never slips: it knows turns better than the
            # wheels, which will do while it is away.
            turned = self._imu_turn - self._imu_turn_before
        self._imu_turn_before = self._imu_turn
        middle = self._position.heading + turned / 2
        self._position = Position(
            self._position.x + moved * math.cos(middle),
            self._position.y + moved * math.sin(middle),
            self._position.heading + turned,
        )

    async def _follow_imu(self) -> None:
        loop = asyncio.get_running_loop()
        async for motion in self.imu:
            now = loop.time()
            rate = motion.turn_rate[2]
            if self._still > SETTLED:  # its zero is learned whenever the wheels stand
                self._learned += 1
                self._bias += (rate - self._bias) / min(self._learned, 400)
            rate -= self._bias  # it is the mean since the last one
            if self._imu_time is not None:
                self._imu_turn += rate * (now - self._imu_time)
            self._imu_time = now

    async def _follow_ranges(self) -> None:
        async for scan in self.ranges:
            if self._travel is not None and abs(self._travel.turn_rate) > 0.8:
                continue  # a fast turn smears the sweep
            angles = scan.first + scan.step * np.arange(
                len(scan.ranges), dtype=np.float64
            )
            self._floor.see(self._position, angles, np.array(scan.ranges), REACH)

    async def _follow_bumper(self) -> None:
        async for touch in self.bumper:
            touching = touch.left or touch.right
            if touching and not self._touching:
                side = {(True, False): 0.6, (False, True): -0.6}.get(
                    (touch.left, touch.right), 0.0
                )
                direction = self._position.heading + side
                self._floor.feel(
                    self._position.x + BUMPER_RADIUS * math.cos(direction),
                    self._position.y + BUMPER_RADIUS * math.sin(direction),
                    direction,
                )
            self._touching = touching
