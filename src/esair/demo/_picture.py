"""The run as a picture: arena, track, map and events."""

from __future__ import annotations

import itertools
import math
import textwrap
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon, Rectangle

from esair.demo._story import Event, Run
from esair.sim import Arena

INK, PALE, PAPER, TRUTH = "#22262e", "#8a9099", "#fbfaf7", "#c9a227"
FREE, UNKNOWN, OCCUPIED = "#ffffff", "#dfe1e4", "#2f4b66"
FLOOR = LinearSegmentedColormap.from_list("floor", [FREE, UNKNOWN, OCCUPIED])
TRACK = LinearSegmentedColormap.from_list("track", ["#7b2cbf", "#d6336c", "#f4a259"])
KINDS = {
    "person": "#3a5ba0",
    "unplug": "#c1121f",
    "plug": "#2a9d4e",
    "refuse": "#d98e04",
    "swap": "#0077b6",
    "bump": "#7b2cbf",
    "end": INK,
}
HOLDERS = {
    "explore": "#9ecae1",
    "dock": "#0077b6",
    "charge": "#2a9d4e",
    "avoid": "#f4a259",
    "bump": "#7b2cbf",
    None: "#eceef0",
}
STYLE: Any = {
    "font.size": 8,
    "text.color": INK,
    "axes.edgecolor": PALE,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
}


def draw(run: Run, path: Path) -> None:
    """Write the picture."""
    drawn(run).savefig(path, format="png", facecolor=PAPER)


def drawn(run: Run) -> Figure:
    numbered = [event for event in run.events if event.kind != "bump"]
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(12.0, 8.6), dpi=130, facecolor=PAPER)
        FigureCanvasAgg(figure)
        grid = figure.add_gridspec(
            2,
            2,
            height_ratios=(1.0, 0.2),
            width_ratios=(1.0, 0.4),
            left=0.06,
            right=0.985,
            top=0.9,
            bottom=0.09,
            hspace=0.16,
            wspace=0.03,
        )
        figure.text(0.06, 0.955, "esair demo", size=19, weight="bold")
        figure.text(0.06, 0.918, run.headline, size=10.5, color=PALE)
        _draw_floor(figure.add_subplot(grid[0, 0]), run, numbered)
        _draw_story(figure.add_subplot(grid[0, 1]), numbered)
        _draw_speed(figure.add_subplot(grid[1, :]), run, numbered)
    return figure


def _draw_floor(axes: Axes, run: Run, numbered: list[Event]) -> None:
    floor = run.belief.floor
    left, bottom = floor.origin
    rows, columns = floor.odds.shape
    axes.imshow(
        floor.odds,
        cmap=FLOOR,
        vmin=-2.0,
        vmax=2.0,
        origin="lower",
        extent=(left, left + columns * floor.cell, bottom, bottom + rows * floor.cell),
        interpolation="bilinear",
    )
    _draw_arena(axes, run.arena)
    _draw_track(axes, run)
    felt = [event.place for event in run.events if event.kind == "bump"]
    axes.plot(*np.reshape(felt, (-1, 2)).T, "x", mew=2, color=KINDS["bump"], zorder=6)
    for number, event in enumerate(numbered, 1):
        up = all(math.dist(event.place, place) > 1.0 for place in felt)
        axes.annotate(
            str(number),
            event.place,
            (13 if number % 2 else -13, 13 if up else -13),
            textcoords="offset points",
            arrowprops={"arrowstyle": "-", "color": KINDS[event.kind]},
            zorder=8,
            **_badge(event),
        )
    keys: dict[str, tuple[str, dict[str, Any]]] = {
        "seen free": ("s", {"color": FREE, "mec": PALE}),
        "seen occupied": ("s", {"color": OCCUPIED}),
        "unknown": ("s", {"color": UNKNOWN, "mec": PALE}),
        "what is really there": ("_", {"color": TRUTH, "mew": 2}),
        "track, from first to last": ("_", {"color": "#d6336c", "mew": 3}),
        "felt by the bumper": ("x", {"color": KINDS["bump"], "mew": 2}),
    }
    for text, (marker, style) in keys.items():
        axes.plot([], [], marker, ms=7, label=text, **style)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, 0.0), ncols=len(keys))
    axes.set_aspect("equal")
    axes.set_axis_off()


def _badge(event: Event) -> dict[str, Any]:
    """Return how the number of an event looks."""
    box = {"boxstyle": "circle,pad=0.28", "fc": KINDS[event.kind], "ec": "white"}
    center = {"ha": "center", "va": "center"}
    return {"color": "white", "size": 9, "weight": "bold", "bbox": box, **center}


def _draw_arena(axes: Axes, arena: Arena) -> None:
    line: dict[str, Any] = {"ec": TRUTH, "fc": "none", "lw": 1.2}
    axes.add_patch(Rectangle((0, 0), *arena.size, **line))
    for wall in arena.walls:
        axes.add_patch(Polygon([wall.begin, wall.end], **line))
    for box in arena.boxes:
        axes.add_patch(Polygon(box.corners(), ls="--" if box.low else "-", **line))
        if box.low:
            x, y = min(box.corners(), key=lambda corner: corner[1])  # badges are above
            text = "low sill,\nonly felt"
            axes.text(x, y - 0.05, text, size=7, va="top", color="#9a7b16", zorder=7)
    for pillar in arena.pillars:
        axes.add_patch(Circle(pillar.center, pillar.radius, **line))


def _draw_track(axes: Axes, run: Run) -> None:
    pieces = [
        (before.place, after.place) for before, after in itertools.pairwise(run.samples)
    ]
    track = LineCollection(pieces, cmap=TRACK, lw=2.3, zorder=4, capstyle="round")
    track.set_array([sample.time for sample in run.samples[1:]])
    axes.add_collection(track)
    for sample in run.samples[-1:]:
        axes.add_patch(Circle(sample.place, 0.16, fc=PAPER, ec=INK, lw=1.4, zorder=5))
    x, y, _ = run.arena.start
    axes.text(x, y, "start", ha="right", va="top", zorder=5)


def _draw_story(axes: Axes, numbered: list[Event]) -> None:
    axes.set_axis_off()
    y = 0.985
    for number, event in enumerate(numbered, 1):
        axes.text(0.055, y - 0.012, str(number), **_badge(event))
        axes.text(0.12, y, f"{event.time:.1f} s", color=PALE, va="center")
        for text, weight, width in (
            (event.text, "bold", 39),
            (event.detail, "normal", 44),
        ):
            for line in textwrap.wrap(text, width):
                y -= 0.034
                axes.text(0.12, y, line, size=8.4, weight=weight, va="center")
        y -= 0.052


def _draw_speed(axes: Axes, run: Run, numbered: list[Event]) -> None:
    """Draw what the wheels were told, by whom, and what was kept back of it."""
    times = np.array([sample.time for sample in run.samples])
    told = np.array([sample.linear for sample in run.samples])
    asked = np.array([sample.asked for sample in run.samples])
    held = [sample.holder for sample in run.samples]
    for name, color in HOLDERS.items():
        mine = np.array([holder == name for holder in held])
        label = f"held by {name}" if name else "held by nobody"
        whole = axes.get_xaxis_transform()
        axes.fill_between(
            times, 0, 1, where=mine, step="post", color=color, alpha=0.5, lw=0,
            transform=whole, label=label,
        )  # fmt: skip
    axes.fill_between(
        times, told, asked, step="post", color=INK, alpha=0.4, lw=0,
        label="kept back by the brake",
    )  # fmt: skip
    axes.step(times, told, where="post", color="#d6336c", lw=1.2)
    blind = np.array([not sample.sees for sample in run.samples])
    axes.fill_between(
        times, 0, 0.06, where=blind, color=KINDS["unplug"], lw=0,
        transform=axes.get_xaxis_transform(), label="range finder away",
    )  # fmt: skip
    for number, event in enumerate(numbered, 1):
        axes.axvline(event.time, color=KINDS[event.kind], lw=1.2)
        where = (event.time, 1.02)
        axes.annotate(
            str(number), where, xycoords=("data", "axes fraction"), ha="center",
            weight="bold", color=KINDS[event.kind],
        )  # fmt: skip
    axes.margins(x=0.01)
    axes.set_ylabel("told the wheels, m/s")
    axes.set_xlabel("seconds", loc="right")
    axes.legend(
        loc="upper center", bbox_to_anchor=(0.45, -0.14), ncols=len(HOLDERS) + 2
    )
