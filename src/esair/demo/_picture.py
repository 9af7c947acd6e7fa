"""The run as a picture: arena, track, map and events."""

from __future__ import annotations

import itertools
import textwrap
from collections.abc import Sequence
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

from esair.demo._map import FloorMap
from esair.demo._samples import Sample
from esair.demo._story import Event
from esair.demo._summary import Run
from esair.sim import Arena

INK = "#22262e"
PALE = "#8a9099"
PAPER = "#fbfaf7"
FLOOR = "#ffffff"
UNKNOWN = "#dfe1e4"
WALL = "#2f4b66"
TRUTH = "#c9a227"
TRACK = LinearSegmentedColormap.from_list("track", ["#7b2cbf", "#d6336c", "#f4a259"])
KINDS = {
    "person": "#3a5ba0",
    "unplug": "#c1121f",
    "plug": "#2a9d4e",
    "refuse": "#d98e04",
    "swap": "#0077b6",
    "bump": "#7b2cbf",
    "end": "#22262e",
}
KEPT_BACK = "#9bb0d9"
"""What the guard has kept back of what was asked for."""

STYLE: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 8,
    "text.color": INK,
    "axes.facecolor": FLOOR,
    "axes.edgecolor": PALE,
    "axes.labelcolor": INK,
    "axes.labelsize": 8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.spines.bottom": False,
    "xtick.color": INK,
    "xtick.labelsize": 8,
    "xtick.major.size": 2,
    "ytick.color": INK,
    "ytick.labelsize": 8,
    "ytick.major.size": 2,
}

HOLDERS = {
    "explore": "#9ecae1",
    "home": "#0077b6",
    "avoid": "#f4a259",
    "bump": "#7b2cbf",
    None: "#eceef0",
}


def draw(run: Run, path: Path) -> None:
    """Write the picture."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(12.0, 8.6), dpi=130, facecolor=PAPER)
        FigureCanvasAgg(figure)
        grid = figure.add_gridspec(
            3,
            2,
            height_ratios=(1.0, 0.16, 0.045),
            width_ratios=(1.0, 0.40),
            left=0.05,
            right=0.985,
            top=0.9,
            bottom=0.07,
            hspace=0.2,
            wspace=0.03,
        )
        figure.text(0.05, 0.955, "esair demo", size=19, weight="bold")
        figure.text(0.05, 0.918, run.headline, size=10.5, color=PALE)
        _draw_floor(figure.add_subplot(grid[0, 0]), run)
        _draw_story(figure.add_subplot(grid[0, 1]), run)
        speed = figure.add_subplot(grid[1, :])
        _draw_speed(speed, run)
        _draw_key(speed)
        _draw_holders(figure.add_subplot(grid[2, :], sharex=speed), run)
        figure.savefig(path, format="png", facecolor=PAPER)


def _draw_floor(axes: Axes, run: Run) -> None:
    floor = run.belief.floor
    rows, columns = floor.odds.shape
    left, bottom = floor.origin
    extent = (left, left + columns * floor.cell, bottom, bottom + rows * floor.cell)
    axes.imshow(
        _colors(floor),
        origin="lower",
        extent=extent,
        zorder=0,
        interpolation="bilinear",
    )
    _draw_arena(axes, run.arena)
    _draw_track(axes, run.samples)
    for number, event in enumerate(_numbered(run.events), 1):
        _mark(axes, event, number)
    for event in run.events:
        if event.kind == "bump":
            axes.plot(*event.place, "x", ms=7, mew=2, color=KINDS["bump"], zorder=6)
    x, y, _ = run.arena.start
    axes.plot(x, y, marker="o", ms=11, mfc="none", mec=INK, mew=1.4, zorder=5)
    axes.annotate("start", (x, y), (-24, -3), textcoords="offset points", ha="center")
    axes.set_xlim(-0.12, run.arena.size[0] + 0.12)
    axes.set_ylim(-0.24, run.arena.size[1] + 0.12)
    axes.set_aspect("equal")
    axes.set_axis_off()
    # A metre, to see how large all this is.
    line: dict[str, Any] = {
        "color": INK,
        "lw": 2,
        "solid_capstyle": "butt",
        "clip_on": False,
    }
    axes.plot([0.0, 1.0], [-0.17, -0.17], **line)
    axes.text(1.06, -0.17, "1 m", va="center")


def _colors(floor: FloorMap) -> Any:
    def rgb(color: str) -> Any:
        return np.array(
            [int(color[index : index + 2], 16) / 255 for index in (1, 3, 5)]
        )

    odds = floor.odds[..., None]
    free = np.clip(-odds / 2.0, 0.0, 1.0)
    there = np.clip(odds / 2.0, 0.0, 1.0)
    known = rgb(UNKNOWN) * (1 - free) + rgb(FLOOR) * free
    return known * (1 - there) + rgb(WALL) * there


def _draw_arena(axes: Axes, arena: Arena) -> None:
    line: dict[str, Any] = {"ec": TRUTH, "fc": "none", "lw": 1.2, "zorder": 2}
    width, height = arena.size
    axes.add_patch(Rectangle((0, 0), width, height, **line))
    for wall in arena.walls:
        axes.plot(
            [wall.begin[0], wall.end[0]], [wall.begin[1], wall.end[1]],
            color=TRUTH, lw=1.2, zorder=2,
        )  # fmt: skip
    for box in arena.boxes:
        style = {**line, "ls": (0, (3, 2))} if box.low else line
        axes.add_patch(Polygon(box.corners(), closed=True, **style))
        if box.low:
            axes.annotate(
                "low sill,\nonly felt", box.center, (-30, 0),
                textcoords="offset points",
                ha="center", va="center", size=7, color="#9a7b16", zorder=4,
            )  # fmt: skip
    for pillar in arena.pillars:
        axes.add_patch(Circle(pillar.center, pillar.radius, **line))


def _draw_track(axes: Axes, samples: Sequence[Sample]) -> None:
    points = np.array([sample.place for sample in samples])
    times = np.array([sample.time for sample in samples])
    if len(points) < 2:
        return
    segments = np.stack([points[:-1], points[1:]], axis=1)
    pieces = list(segments)
    below = LineCollection(pieces, colors="white", lw=4.5, alpha=0.8, zorder=3)
    track = LineCollection(pieces, cmap=TRACK, lw=2.3, zorder=4, capstyle="round")
    track.set_array(times[:-1])
    for each in (below, track):
        axes.add_collection(each)
    sample = samples[-1]
    x, y = sample.place
    axes.add_patch(Circle((x, y), 0.16, fc=PAPER, ec=INK, lw=1.4, zorder=5))
    ahead = 0.16 * np.array([np.cos(sample.heading), np.sin(sample.heading)])
    axes.plot([x, x + ahead[0]], [y, y + ahead[1]], color=INK, lw=1.8, zorder=5)


def _mark(axes: Axes, event: Event, number: int) -> None:
    axes.annotate(
        str(number),
        event.place,
        (13 if number % 2 else -13, 13),
        textcoords="offset points",
        ha="center",
        va="center",
        color="white",
        size=9,
        weight="bold",
        zorder=8,
        bbox={
            "boxstyle": "circle,pad=0.28",
            "fc": KINDS[event.kind],
            "ec": "white",
            "lw": 1,
        },
        arrowprops={"arrowstyle": "-", "color": KINDS[event.kind], "lw": 1.2},
    )


def _draw_story(axes: Axes, run: Run) -> None:
    axes.set_axis_off()
    axes.set_xlim(0, 1)
    axes.set_ylim(0, 1)
    y = 0.985
    for number, event in enumerate(_numbered(run.events), 1):
        axes.text(
            0.055, y - 0.012, str(number), color="white", size=9, weight="bold",
            ha="center", va="center",
            bbox={"boxstyle": "circle,pad=0.28", "fc": KINDS[event.kind], "ec": "none"},
        )  # fmt: skip
        axes.text(0.12, y, f"{event.time:.1f} s", color=PALE, va="center")
        for text, weight, width in (
            (event.text, "bold", 39),
            (event.detail, "normal", 44),
        ):
            for line in textwrap.wrap(text, width):
                y -= 0.034
                axes.text(0.12, y, line, size=8.4, weight=weight, va="center")
        y -= 0.052


def _draw_key(axes: Axes) -> None:
    keys: tuple[tuple[str, str, dict[str, Any]], ...] = (
        ("seen free", "s", {"color": FLOOR, "mec": PALE}),
        ("seen occupied", "s", {"color": WALL}),
        ("unknown", "s", {"color": UNKNOWN, "mec": PALE}),
        ("what is really there", "_", {"color": TRUTH, "mew": 2}),
        ("track, from first to last", "_", {"color": "#d6336c", "mew": 3}),
        ("felt by the bumper", "x", {"color": KINDS["bump"], "mew": 2}),
        ("kept back by the brake", "s", {"color": KEPT_BACK}),
    )
    column = 0.0
    for text, marker, style in keys:
        where: dict[str, Any] = {"transform": axes.transAxes}
        axes.plot(column, 1.3, marker, ms=8, clip_on=False, **where, **style)
        axes.text(column + 0.01, 1.3, text, va="center", **where)
        column += 0.035 + 0.0063 * len(text)


def _draw_speed(axes: Axes, run: Run) -> None:
    times = [sample.time for sample in run.samples]
    linear = [sample.linear for sample in run.samples]
    _shade_outages(axes, run.samples)
    asked = [sample.asked for sample in run.samples]
    axes.fill_between(times, asked, linear, step="post", color=KEPT_BACK, lw=0)
    axes.fill_between(times, linear, step="post", color="#d6336c", alpha=0.25, lw=0)
    axes.step(times, linear, where="post", color="#d6336c", lw=1.0)
    axes.axhline(0, color=PALE, lw=0.6)
    top = max([0.5, *linear]) * 1.3
    axes.set_ylim(min([-0.1, *linear]) * 1.15, top)
    for number, event in enumerate(_numbered(run.events), 1):
        axes.axvline(event.time, color=KINDS[event.kind], lw=1.2)
        style: dict[str, Any] = {
            "weight": "bold",
            "color": KINDS[event.kind],
            "va": "top",
        }
        axes.text(event.time, top, f" {number}", **style)
    axes.set_xlim(0, times[-1] + 0.35 if times else 1.0)
    axes.set_ylabel("told the wheels\nm/s")
    axes.tick_params(labelbottom=False)


def _shade_outages(axes: Axes, samples: Sequence[Sample]) -> None:
    begin: float | None = None
    for sample in samples:
        if not sample.sees and begin is None:
            begin = sample.time
        if sample.sees and begin is not None:
            axes.axvspan(begin, sample.time, color="#c1121f", alpha=0.09, lw=0)
            middle = (begin + sample.time) / 2
            axes.text(middle, 0.04, "range finder\naway", ha="center", color="#c1121f")
            begin = None


def _draw_holders(axes: Axes, run: Run) -> None:
    swapped = next((event.time for event in run.events if event.kind == "swap"), np.inf)
    spans: list[tuple[str | None, float, float]] = []
    for sample, after in itertools.pairwise(run.samples):
        holder = sample.holder
        if holder == "explore" and sample.time > swapped:
            holder = "home"
        if spans and spans[-1][0] == holder:
            spans[-1] = (holder, spans[-1][1], after.time)
        else:
            spans.append((holder, sample.time, after.time))
    for holder, begin, end in spans:
        color = HOLDERS.get(holder, PALE)
        axes.add_patch(Rectangle((begin, 0), end - begin, 1, color=color, lw=0))
    axes.set_ylim(0, 1)
    axes.set_yticks([])
    axes.set_ylabel("who", rotation=0, ha="right", va="center")
    axes.set_xlabel("seconds", loc="right")
    axes.spines["left"].set_visible(False)
    where: dict[str, Any] = {"transform": axes.transAxes, "clip_on": False}
    for index, (name, color) in enumerate(HOLDERS.items()):
        x = 0.005 + 0.085 * index
        axes.text(x, -1.35, f"  {name or 'nobody'}", va="center", **where)
        axes.plot(x, -1.35, "s", ms=7, color=color, **where)


def _numbered(events: Sequence[Event]) -> list[Event]:
    return [event for event in events if event.kind != "bump"]
