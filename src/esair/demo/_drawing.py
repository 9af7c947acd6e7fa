"""The map as text: half blocks, two rows of points in each line."""

from __future__ import annotations

import itertools
import math

import attrs
import numpy as np
from rich.text import Text

from esair.demo._map import FloorMap

COLORS = ("#1c1f26", "#c9cdd4", "#3b6ea5", "#e08a3c", "#d62828")
"""Unknown, free, occupied, track, rover."""


@attrs.frozen(eq=False)
class Drawing:
    """A map with what was driven on it."""

    floor: FloorMap
    track: tuple[tuple[float, float], ...]  # Where the rover has been, in metres
    place: tuple[float, float]  # Where it is, in metres

    def __call__(self, width: int, height: int) -> Text:
        """Draw it on so many columns and lines: as fine as there is room."""
        rows, columns = self.floor.odds.shape
        factor = max(2, math.ceil(columns / width), math.ceil(rows / (2 * height)))
        return draw_map(self.floor, self.track, self.place, factor)


def draw_map(
    floor: FloorMap,
    track: tuple[tuple[float, float], ...],
    place: tuple[float, float],
    factor: int = 2,
) -> Text:
    """Draw a map."""
    height, width = (length // factor * factor for length in floor.odds.shape)
    cut = floor.odds[:height, :width]
    blocks = cut.reshape(height // factor, factor, width // factor, factor)
    most = blocks.max(axis=(1, 3))
    mean = blocks.mean(axis=(1, 3))
    colors = np.full(most.shape, 0)
    colors[mean < -0.2] = 1
    colors[most > 0.6] = 2
    rows, columns = colors.shape
    for color, places in ((3, track), (4, (place,))):
        for x, y in places:
            row, column = floor.cell_of(x, y)
            colors[min(row // factor, rows - 1), min(column // factor, columns - 1)] = (
                color
            )
    if len(colors) % 2:
        colors = np.vstack([colors, np.zeros((1, colors.shape[1]), colors.dtype)])
    lines: list[Text] = []
    for upper, lower in zip(colors[-1::-2], colors[-2::-2], strict=True):
        line = Text(no_wrap=True)
        # Runs of the same colors are one piece: there are ten times fewer of them.
        for (above, below), run in itertools.groupby(zip(upper, lower, strict=True)):
            line.append("▀" * len(list(run)), f"{COLORS[above]} on {COLORS[below]}")
        lines.append(line)
    return Text("\n", no_wrap=True).join(lines)
