"""Where to go next, and on which way: plain functions of a map."""

from __future__ import annotations

import attrs
import numpy as np
from numpy.typing import NDArray

from esair.demo._map import FloorMap, Mask, Position

CLEARANCE = 0.27  # How far the rover's centre keeps from things, in metres
TURN_COST = 9.0  # How many cells of way a turn by one radian is worth
LEAST_GAIN = 8  # How many cells of frontier make a goal worth while
FAR = np.iinfo(np.int32).max  # The number of steps to where no way leads

Point = tuple[float, float]


@attrs.frozen
class Way:
    """A way over the floor."""

    points: tuple[Point, ...]  # In metres, from the rover to the goal
    gain: int = 0  # How many unknown cells begin near the goal

    @property
    def goal(self) -> Point:
        """The last point, in metres."""
        return self.points[-1]


def grow(mask: Mask, cells: int) -> Mask:
    """Return a mask with everything that is near it, in a circle of cells."""
    grown = mask.copy()
    for row in range(-cells, cells + 1):
        for column in range(-cells, cells + 1):
            if row * row + column * column <= cells * cells:
                grown |= _shifted(mask, row, column)
    return grown


def way_to(floor: FloorMap, position: Position, goal: Point) -> Way | None:
    """Return the shortest way to a point over floor that is known to be free."""
    passable = _passable(floor, position)
    steps = _steps(passable, floor.cell_of(position.x, position.y))
    row, column = floor.cell_of(*goal)
    near = np.zeros_like(passable)
    near[row, column] = True
    reachable = np.argwhere(grow(near, 4) & (steps < FAR))
    if not len(reachable):
        return None
    best = min(
        ((int(cell[0]), int(cell[1])) for cell in reachable),
        key=lambda cell: (cell[0] - row) ** 2 + (cell[1] - column) ** 2,
    )
    return Way(_points(floor, steps, best))


def way_to_frontier(
    floor: FloorMap, position: Position, avoid: tuple[Point, ...] = ()
) -> Way | None:
    """Return the way to where most can be learned at least cost.

    A frontier is where the floor known to be free meets the unknown.
    """
    passable = _passable(floor, position)
    steps = _steps(passable, floor.cell_of(position.x, position.y))
    edge, gain = _frontier(floor)
    near_edge = grow(edge, 3) & passable & (steps < FAR)
    for goal in avoid:
        row, column = floor.cell_of(*goal)
        near_edge[max(0, row - 6) : row + 7, max(0, column - 6) : column + 7] = False
    near_edge &= (gain >= LEAST_GAIN) & (steps >= 5)
    candidates = np.argwhere(near_edge)
    if not len(candidates):
        return None
    rows, columns = candidates[:, 0], candidates[:, 1]
    x, y = floor.center_of(rows.astype(np.float64), columns.astype(np.float64))
    turn = np.arctan2(y - position.y, x - position.x) - position.heading
    turn = np.abs(np.remainder(turn + np.pi, 2 * np.pi) - np.pi)
    worth = gain[rows, columns] / (20.0 + steps[rows, columns] + TURN_COST * turn)
    # The first of equals: argmax is the same on every machine.
    best = int(np.argmax(worth))
    cell = (int(rows[best]), int(columns[best]))
    return Way(_points(floor, steps, cell), int(gain[cell]))


def is_worth_while(floor: FloorMap, goal: Point) -> bool:
    """Tell whether there is still something unknown around a goal."""
    _, gain = _frontier(floor)
    return bool(gain[floor.cell_of(*goal)] >= LEAST_GAIN)


def is_blocked(floor: FloorMap, position: Position, way: Way) -> bool:
    """Tell whether something stands on a way that has not been known before."""
    blocked = ~_passable(floor, position)
    return any(blocked[floor.cell_of(*point)] for point in way.points)


def _frontier(floor: FloorMap) -> tuple[Mask, NDArray[np.int32]]:
    """Return where the known floor ends, and how much of that is around each cell."""
    unknown = np.abs(floor.odds) <= 0.4
    edge = floor.free & _neighbours(unknown)
    return edge, _box_sum(edge.astype(np.int32), 5)


def _passable(floor: FloorMap, position: Position) -> Mask:
    passable = floor.free & ~grow(floor.occupied, round(CLEARANCE / floor.cell))
    here = np.zeros_like(passable)
    here[floor.cell_of(position.x, position.y)] = True
    # Whoever stands too near a wall must be able to leave.
    near = grow(here, round(1.2 * CLEARANCE / floor.cell))
    out: Mask = passable | (near & ~grow(floor.occupied, 3))
    return out


def _steps(passable: Mask, start: tuple[int, int]) -> NDArray[np.int32]:
    """Count the steps from a cell to all others: a wave, a ring of cells at a time."""
    steps = np.full(passable.shape, FAR, np.int32)
    wave = np.zeros_like(passable)
    wave[start] = True
    steps[start] = 0
    left = passable.copy()
    left[start] = False
    count = 0
    while wave.any():
        count += 1
        # Straight and diagonal by turns makes the wave an octagon, nearly a circle.
        wave = (_neighbours(wave) if count % 2 else _around(wave)) & left
        steps[wave] = count
        left &= ~wave
    return steps


def _points(
    floor: FloorMap, steps: NDArray[np.int32], goal: tuple[int, int]
) -> tuple[Point, ...]:
    height, width = steps.shape
    cell = goal
    cells = [goal]
    while steps[cell] > 0:
        around = [
            (row, column)
            for row in range(max(0, cell[0] - 1), min(height, cell[0] + 2))
            for column in range(max(0, cell[1] - 1), min(width, cell[1] + 2))
        ]
        cell = min(
            around,
            key=lambda each: (
                int(steps[each]),
                abs(each[0] - cell[0]) + abs(each[1] - cell[1]),
            ),
        )
        if cell == cells[-1]:
            break
        cells.append(cell)
    return tuple(floor.center_of(*each) for each in reversed(cells))


def _shifted(mask: Mask, rows: int, columns: int) -> Mask:
    out = np.zeros_like(mask)
    height, width = mask.shape
    out[
        max(0, rows) : height + min(0, rows), max(0, columns) : width + min(0, columns)
    ] = mask[
        max(0, -rows) : height + min(0, -rows),
        max(0, -columns) : width + min(0, -columns),
    ]
    return out


def _neighbours(mask: Mask) -> Mask:
    out = mask.copy()
    out[1:] |= mask[:-1]
    out[:-1] |= mask[1:]
    out[:, 1:] |= mask[:, :-1]
    out[:, :-1] |= mask[:, 1:]
    return out


def _around(mask: Mask) -> Mask:
    rows = mask.copy()
    rows[1:] |= mask[:-1]
    rows[:-1] |= mask[1:]
    out = rows.copy()
    out[:, 1:] |= rows[:, :-1]
    out[:, :-1] |= rows[:, 1:]
    return out


def _box_sum(values: NDArray[np.int32], half: int) -> NDArray[np.int32]:
    padded = np.pad(values, ((half + 1, half), (half + 1, half)))
    total = padded.cumsum(0).cumsum(1)
    size = 2 * half + 1
    out: NDArray[np.int32] = (
        total[size:, size:]
        - total[:-size, size:]
        - total[size:, :-size]
        + total[:-size, :-size]
    ).astype(np.int32)
    return out
