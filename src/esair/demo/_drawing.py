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
        # How many cells of the map, across and along, are one point.
        tall, wide = (length // factor for length in self.floor.odds.shape)
        cut = self.floor.odds[: tall * factor, : wide * factor]
        blocks = cut.reshape(tall, factor, wide, factor)
        colors = np.zeros((tall, wide), int)
        colors[blocks.mean(axis=(1, 3)) < -0.2] = 1
        colors[blocks.max(axis=(1, 3)) > 0.6] = 2
        for color, places in ((3, self.track), (4, (self.place,))):
            for x, y in places:
                row, column = self.floor.cell_of(x, y)
                colors[
                    min(row // factor, tall - 1), min(column // factor, wide - 1)
                ] = color
        if tall % 2:
            colors = np.vstack([colors, np.zeros((1, wide), int)])
        lines: list[Text] = []
        for upper, lower in zip(colors[-1::-2], colors[-2::-2], strict=True):
            line = Text(no_wrap=True)
            # Runs of the same colors are one piece: there are ten times fewer of them.
            for (above, below), run in itertools.groupby(
                zip(upper, lower, strict=True)
            ):
                line.append("▀" * len(list(run)), f"{COLORS[above]} on {COLORS[below]}")
            lines.append(line)
        return Text("\n", no_wrap=True).join(lines)
