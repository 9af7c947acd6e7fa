"""Where to go next, and on which way: plain functions of a map."""

from __future__ import annotations

import itertools

import attrs
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from esair.demo._map import FloorMap, Mask, Position

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
