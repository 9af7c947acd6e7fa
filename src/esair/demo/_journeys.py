"""Behaviors in turns: ``Explore`` where nobody was yet, ``Home`` to the dock, ``Charge``."""

from __future__ import annotations

import itertools
import math

from esair.actions import Behavior, reads, writes
from esair.demo._mapper import Belief
from esair.demo._plan import (
    Point,
    Position,
    Way,
    is_blocked,
    is_worth_while,
    way_to,
    way_to_frontier,
)
from esair.demo._values import Scan, Twist
from esair.exceptions import BehaviorFailedError, BehaviorRemovedError
from esair.loop import every

PERIOD = 0.05  # Between two commands for the wheels, in seconds
THINK = 8  # How many commands are made on one plan before it is looked at again
CRUISE = 0.55  # How fast the rover drives, in m/s
LOOK_AHEAD = 0.3  # Which point of the way is driven to, in metres ahead
ARRIVED = 0.22  # How near the goal is near enough, in metres


class Journey(Behavior):
    """Drives along ways over floor that it knows, and only while it can see."""

    ranges = reads(Scan, max_age=0.4)
    wheels = writes(Twist)

    def __init__(self, *, mapper: str = "mapper", name: str | None = None) -> None:
        super().__init__(name=name)
        self.mapper = mapper
        self.blind: int = (
            0  # How many commands it did not make because it could not see
        )
        self.way: Way | None = None
        self.tried: tuple[Point, ...] = ()  # Where it did not get to
        self._left = math.inf  # How long the way was at least, when it was looked at

    async def run(self) -> None:
        """Go on until there is nowhere to go."""
        seeing = False
        thinking = 0
        async for _ in every(PERIOD):
            belief = await self._look(seeing)
            seeing = belief is not None
            thinking -= 1
            if belief is None:
                self.way = None
                continue
            position = belief.position
            if self.way is not None and position.distance_to(*self.way.goal) < ARRIVED:
                self.way = None
            if self.way is None or thinking <= 0:
                self._think(belief)
                thinking = THINK
            if self.way is not None:
                await self.wheels.write(follow(self.way, position))
            elif await self.rest(position):
                return

    def _think(self, belief: Belief) -> None:
        """Look for another way, unless this one is good and it gets on."""
        if self.way is not None:
            before, self._left = self._left, _length(self.way, belief.position)
            if self._left > before - 0.05:  # it does not get there
                self.tried = (*self.tried[-7:], self.way.goal)
            elif self.is_good(self.way, belief):
                return
        self.way, self._left = self.plan(belief), math.inf

    def plan(self, belief: Belief) -> Way | None:
        """Return the way to go now; None if there is nowhere to go."""
        raise NotImplementedError

    def is_good(self, way: Way, belief: Belief) -> bool:
        """Tell whether to go on on this way."""
        return not is_blocked(belief.floor, belief.position, way)

    async def rest(self, position: Position) -> bool:
        """Do what is left to do when there is nowhere to go; True ends the journey."""
        raise NotImplementedError

    async def _look(self, was_seeing: bool) -> Belief | None:
        try:
            await self.ranges.read(timeout=0.1)
        except OSError:  # lost, at fault or stale
            self.blind += 1
            if was_seeing:  # the rover does not drive on blindly till the time-out
                await self.wheels.write(Twist(0.0, 0.0))
                self.wheels.release()
            return None
        try:
            belief: Belief = await self.get(self.mapper, interval=0.1)
        except (BehaviorFailedError, BehaviorRemovedError, OSError, LookupError):
            return None  # no mapper, or one that is busy
        return belief if belief.settled else None


class Explore(Journey):
    """Goes to where the known floor ends, where most can be learned at least cost."""

    def plan(self, belief: Belief) -> Way | None:
        """Return the way to the best frontier."""
        way = way_to_frontier(belief.floor, belief.position, self.tried)
        if way is None and self.tried:
            self.tried = ()
            way = way_to_frontier(belief.floor, belief.position)
        return way

    def is_good(self, way: Way, belief: Belief) -> bool:
        """Tell whether there is still something to learn on this way."""
        return is_worth_while(belief.floor, way.goal) and super().is_good(way, belief)

    async def rest(self, position: Position) -> bool:
        """Turn and look around: what is unknown may come into sight."""
        await self.wheels.write(Twist(0.0, 0.8))
        return False


class Home(Journey):
    """Goes back to where the rover started, and stays there.

    Args:
        place: x and y in metres.
    """

    def __init__(
        self,
        *,
        place: tuple[float, float] = (0.7, 0.8),
        mapper: str = "mapper",
        name: str | None = None,
    ) -> None:
        super().__init__(mapper=mapper, name=name)
        self.place = place
        self.arrived: bool = False

    async def run(self) -> None:
        """Go there anew, each time that it has its turn."""
        self.arrived = False
        await super().run()

    def plan(self, belief: Belief) -> Way | None:
        """Return the way home."""
        if belief.position.distance_to(*self.place) < ARRIVED:
            return None
        return way_to(belief.floor, belief.position, self.place)

    async def rest(self, position: Position) -> bool:
        """Stop at home; else wait for the map to show a way."""
        if position.distance_to(*self.place) < 1.5 * ARRIVED:
            self.arrived = True
            await self.wheels.write(Twist(0.0, 0.0))
            self.wheels.release()
            return True
        return False


class Charge(Behavior):
    """Stays at the dock until the battery is full.

    Args:
        seconds: How long that takes.
    """

    wheels = writes(Twist)

    def __init__(self, *, seconds: float = 20.0, name: str | None = None) -> None:
        super().__init__(name=name)
        self.seconds = seconds
        self.level: float = 0.0  # How full the battery is: 0 to 1

    async def run(self) -> None:
        """Hold the wheels still meanwhile: nobody drives away with a cable."""
        self.level = 0.0
        async for _ in every(PERIOD):
            await self.wheels.write(Twist(0.0, 0.0))
            self.level += PERIOD / self.seconds
            if self.level >= 1.0:
                return


def follow(way: Way, position: Position) -> Twist:
    """Return how to move along a way: turn first, then drive in a curve."""
    x, y = _point_ahead(way, position)
    error = position.direction_to(x, y)
    turn = max(-2.0, min(2.0, 2.4 * error))
    if abs(error) > 0.8:
        return Twist(0.0, turn)
    near = min(1.0, position.distance_to(*way.goal) / 0.5 + 0.35)
    return Twist(CRUISE * near * math.cos(error) ** 2, turn)


def _nearest(way: Way, position: Position) -> int:
    return min(
        range(len(way.points)),
        key=lambda index: position.distance_to(*way.points[index]),
    )


def _point_ahead(way: Way, position: Position) -> Point:
    for point in way.points[_nearest(way, position) :]:
        if position.distance_to(*point) >= LOOK_AHEAD:
            return point
    return way.goal


def _length(way: Way, position: Position) -> float:
    points = way.points[_nearest(way, position) :]
    return sum(math.dist(*pair) for pair in itertools.pairwise(points))
