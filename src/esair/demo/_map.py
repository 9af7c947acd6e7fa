"""What the rover has seen: how likely something stands on each spot of the floor."""

from __future__ import annotations

import math
from typing import TypeVar

import attrs
import numpy as np
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
