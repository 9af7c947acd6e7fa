"""The floor: what has been seen of it, where to go next, and on which way."""

from __future__ import annotations

import itertools
import math
from typing import TypeVar

import attrs
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

Grid = NDArray[np.float32]
Mask = NDArray[np.bool_]
N = TypeVar("N", float, NDArray[np.float64])

# Steps of, and limit to, the log odds of a cell
SEEN_FREE, SEEN_THERE, FELT_THERE, CERTAIN = -0.45, 1.1, 4.0, 6.0
MARGIN = 0.2  # How far the map goes beyond the floor on each side, in metres


@attrs.frozen
class Position:
    """Where the rover believes it is: x, y in metres, heading in rad."""

    x: float
    y: float
    heading: float

    def distance_to(self, x: float, y: float) -> float:
        """Return the distance to a point in metres."""
        return math.hypot(x - self.x, y - self.y)

    def direction_to(self, x: float, y: float) -> float:
        """Return the direction of a point from straight ahead, in rad (-pi to pi)."""
        return math.remainder(
            math.atan2(y - self.y, x - self.x) - self.heading, math.tau
        )


@attrs.frozen(eq=False)
class FloorMap:
    """A grid over the floor."""

    # Log odds that a cell is occupied, 0 if unknown, shape (rows, columns); row 0 is at
    # the least y
    odds: Grid
    cell: float  # The width of a cell in metres
    origin: tuple[float, float]  # x and y of the corner of cell (0, 0), in metres

    @classmethod
    def empty(cls, size: tuple[float, float], cell: float = 0.05) -> FloorMap:
        """Return a map of a floor from (0, 0) to a size in metres, nothing known."""
        columns, rows = (math.ceil((length + 2 * MARGIN) / cell) for length in size)
        return cls(np.zeros((rows, columns), np.float32), cell, (-MARGIN, -MARGIN))

    def copy(self) -> FloorMap:
        """Return a map that stays as it is."""
        return attrs.evolve(self, odds=self.odds.copy())

    @property
    def free(self) -> Mask:
        """Where surely nothing stands."""
        return self.odds < -0.4

    @property
    def occupied(self) -> Mask:
        """Where something is likely to stand."""
        return self.odds > 0.6

    def known(self, size: tuple[float, float]) -> float:
        """Return which part of a floor from (0, 0) to a size is known, 0 to 1."""
        bottom, left = self.cell_of(0.0, 0.0)
        top, right = self.cell_of(size[0], size[1])
        return float(np.mean(np.abs(self.odds[bottom:top, left:right]) > 0.4))

    def cells_of(
        self, x: NDArray[np.float64], y: NDArray[np.float64]
    ) -> tuple[NDArray[np.intp], NDArray[np.intp], Mask]:
        """Return rows and columns of points, and which of them are on the map."""
        columns = np.floor((x - self.origin[0]) / self.cell).astype(np.intp)
        rows = np.floor((y - self.origin[1]) / self.cell).astype(np.intp)
        height, width = self.odds.shape
        inside = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
        return rows, columns, inside

    def cell_of(self, x: float, y: float) -> tuple[int, int]:
        """Return row and column of a point, or of the nearest point on the map."""
        height, width = self.odds.shape
        column = math.floor((x - self.origin[0]) / self.cell)
        row = math.floor((y - self.origin[1]) / self.cell)
        return min(max(row, 0), height - 1), min(max(column, 0), width - 1)

    def center_of(self, row: N, column: N) -> tuple[N, N]:
        """Return x and y of the middle of a cell, or of cells, in metres."""
        return (
            self.origin[0] + (column + 0.5) * self.cell,
            self.origin[1] + (row + 0.5) * self.cell,
        )

    def see(
        self,
        position: Position,
        angles: NDArray[np.float64],
        ranges: NDArray[np.float64],
        reach: float,
    ) -> None:
        """Take in one sweep."""
        directions = angles + position.heading
        cos, sin = np.cos(directions), np.sin(directions)
        seen = np.isfinite(ranges)
        clear = np.where(seen, ranges - 1.5 * self.cell, reach - self.cell)
        steps = np.arange(0.0, reach, 0.8 * self.cell)
        on_beam = steps[None, :] < clear[:, None]
        x = (position.x + steps[None, :] * cos[:, None])[on_beam]
        y = (position.y + steps[None, :] * sin[:, None])[on_beam]
        self._add(x, y, SEEN_FREE)
        hit = ranges[seen] + 0.3 * self.cell
        self._add(
            position.x + hit * cos[seen], position.y + hit * sin[seen], SEEN_THERE
        )

    def feel(self, x: float, y: float, direction: float) -> None:
        """Take in that something was touched at a point."""
        across = np.linspace(-0.12, 0.12, 9)
        xs, ys = x - across * math.sin(direction), y + across * math.cos(direction)
        deep = 0.04
        rows, columns, inside = self.cells_of(
            np.concatenate([xs, xs + deep * math.cos(direction)]),
            np.concatenate([ys, ys + deep * math.sin(direction)]),
        )
        # However often it was looked over: what is touched is there.
        self.odds[rows[inside], columns[inside]] = FELT_THERE

    def _add(
        self, x: NDArray[np.float64], y: NDArray[np.float64], change: float
    ) -> None:
        rows, columns, inside = self.cells_of(x, y)
        touched = np.zeros(self.odds.shape, np.bool_)
        touched[rows[inside], columns[inside]] = True  # each cell once a sweep
        if change < 0:
            touched &= self.odds < FELT_THERE - 0.5  # what was felt, is not seen away
        self.odds[touched] = np.clip(self.odds[touched] + change, -CERTAIN, CERTAIN)


CLEARANCE = 0.27  # How far the rover's centre keeps from things, in metres
TURN_COST = 9.0  # How many cells of way a turn by one radian is worth
LEAST_GAIN = 8  # How many cells of frontier make a goal worth while
FAR = np.iinfo(np.int32).max  # The number of steps to where no way leads

NEAR = 4.0  # How many cells beside a goal are near enough

BESIDE = ((-1, 0), (1, 0), (0, -1), (0, 1), (-1, -1), (-1, 1), (1, -1), (1, 1))
"""The eight cells beside one; the straight ones first, which are nearer."""

Point = tuple[float, float]


@attrs.frozen
class Way:
    """A way over the floor."""

    points: tuple[Point, ...]  # In metres, from the rover to the goal

    @property
    def goal(self) -> Point:
        """The last point, in metres."""
        return self.points[-1]


def way_to(floor: FloorMap, position: Position, goal: Point) -> Way | None:
    """Return the shortest way to a point over floor that is known to be free."""
    steps = _steps(floor, position)
    reachable = np.argwhere(steps < FAR)
    far = np.hypot(*(reachable - floor.cell_of(*goal)).T)
    nearest = int(np.argmin(far))
    return _way(floor, steps, reachable[nearest]) if far[nearest] <= NEAR else None


def way_to_frontier(
    floor: FloorMap, position: Position, avoid: tuple[Point, ...] = ()
) -> Way | None:
    """Return the way to where most can be learned at least cost.

    A frontier is where the floor known to be free meets the unknown.
    """
    steps = _steps(floor, position)
    edge, gain = _frontier(floor)
    goals = _grown(edge, 3) & (gain >= LEAST_GAIN) & (steps >= 5) & (steps < FAR)
    for goal in avoid:
        row, column = floor.cell_of(*goal)
        goals[max(0, row - 6) : row + 7, max(0, column - 6) : column + 7] = False
    candidates = np.argwhere(goals)
    if not len(candidates):
        return None
    rows, columns = candidates.T
    x, y = floor.center_of(rows.astype(np.float64), columns.astype(np.float64))
    turn = np.arctan2(y - position.y, x - position.x) - position.heading
    turn = np.abs(np.remainder(turn + np.pi, 2 * np.pi) - np.pi)
    worth = gain[rows, columns] / (20.0 + steps[rows, columns] + TURN_COST * turn)
    # The first of equals: argmax is the same on every machine.
    return _way(floor, steps, candidates[int(np.argmax(worth))])


def is_worth_while(floor: FloorMap, goal: Point) -> bool:
    """Tell whether there is still something unknown around a goal."""
    _, gain = _frontier(floor)
    return bool(gain[floor.cell_of(*goal)] >= LEAST_GAIN)


def is_blocked(floor: FloorMap, position: Position, way: Way) -> bool:
    """Tell whether something stands on a way that has not been known before."""
    passable = _passable(floor, position)
    return not all(passable[floor.cell_of(*point)] for point in way.points)


def _frontier(floor: FloorMap) -> tuple[Mask, NDArray[np.int32]]:
    """Return where the known floor ends, and how much of that is around each cell."""
    edge = floor.free & _widened(np.abs(floor.odds) <= 0.4)
    gain = edge.astype(np.int32)
    for axis in (0, 1):
        padded = np.pad(gain, [(5, 5) if each == axis else (0, 0) for each in (0, 1)])
        gain = sliding_window_view(padded, 11, axis=axis).sum(axis=-1, dtype=np.int32)
    return edge, gain


def _passable(floor: FloorMap, position: Position) -> Mask:
    passable = floor.free & ~_grown(floor.occupied, round(CLEARANCE / floor.cell))
    here = np.zeros_like(passable)
    here[floor.cell_of(position.x, position.y)] = True
    # Whoever stands too near a wall must be able to leave.
    near = _grown(here, round(1.2 * CLEARANCE / floor.cell))
    passable |= near & ~_grown(floor.occupied, 3)
    passable[[0, -1]] = passable[:, [0, -1]] = False  # each cell has eight beside it
    return passable


def _steps(floor: FloorMap, position: Position) -> NDArray[np.int32]:
    """Count the steps from the rover to each cell: a wave, ring by ring."""
    left = _passable(floor, position)
    steps = np.full(left.shape, FAR, np.int32)
    wave = np.zeros_like(left)
    wave[floor.cell_of(position.x, position.y)] = True
    for count in itertools.count():
        steps[wave] = count
        left &= ~wave
        wave = _widened(wave, diagonally=count % 2 == 1) & left
        if not wave.any():
            return steps
    raise AssertionError


def _way(floor: FloorMap, steps: NDArray[np.int32], goal: NDArray[np.intp]) -> Way:
    """Return the way to a cell: from there down to the rover, step by step."""
    cells = [(int(goal[0]), int(goal[1]))]
    while steps[cells[-1]] > 0:
        row, column = cells[-1]
        beside = [(row + down, column + right) for down, right in BESIDE]
        cells.append(min(beside, key=lambda each: int(steps[each])))
    return Way(tuple(floor.center_of(*each) for each in reversed(cells)))


def _grown(mask: Mask, cells: int) -> Mask:
    """Return a mask with everything that is near it, in an octagon of cells."""
    for count in range(cells):
        mask = _widened(mask, diagonally=count % 2 == 1)
    return mask


def _widened(mask: Mask, *, diagonally: bool = False) -> Mask:
    """Return a mask with what is beside it.

    Straight and diagonal by turns makes an octagon of it, nearly a circle.
    """
    upright = mask.copy()
    upright[1:] |= mask[:-1]
    upright[:-1] |= mask[1:]
    out, sideways = upright.copy(), upright if diagonally else mask
    out[:, 1:] |= sideways[:, :-1]
    out[:, :-1] |= sideways[:, 1:]
    return out
