"""``esair plot``: a recording as a picture of tracks, holders and events."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from esair.cli._errors import CANNOT_USE, has_unknown, is_no_picture, tell
from esair.cli._log_file import NAMES
from esair.cli._options import Components, Out
from esair.values import printable

if TYPE_CHECKING:
    from esair.recording import Recorded

TRACKS = 24
"""How many tracks one picture has; what comes later in the alphabet is left out."""

POINTS = 4000
"""How many points of a track are kept."""

CHANGES = 4000
"""How many changes of who moves an actuator are drawn."""

MARKS = 1000
"""How many events are marked."""

LONGEST = 100  # How long a name in the picture may be

HIGHEST = 1e100  # No number that is greater can be drawn

_MARKED = {
    "down": "tab:red",
    "crashed": "tab:red",
    "failed": "tab:red",
    "halted": "black",
    "resumed": "tab:green",
    "up": "tab:green",
    "unanswered": "tab:orange",
}


def plot(file: Path, /, *, out: Out = None, component: Components = None) -> int:
    """Draw a recording: values, holders and events over time.

    Args:
        file: A recording; also one that was cut.
        out: The picture (PNG); beside the recording unless given.
        component: Only these sensors and actuators.
    """
    from esair.recording import events_of

    target = out or file.with_name(f"{file.stem}-plot.png")
    if is_no_picture(target):
        return CANNOT_USE
    seen = Seen(component)
    for event in events_of(file):
        seen.take(event)
    if seen.begin is None:
        tell(f"{file}: there is no event in it")
        return CANNOT_USE
    if has_unknown("--component", component or [], seen.named):
        return CANNOT_USE
    _draw(seen, target)
    print(target)  # noqa: T201 - this is the output
    return 0


class Track:
    """One number over time, thinned out so that it is never more than a picture shows.

    Of a stretch of time the first, the least, the greatest and the last are kept, and
    the stretch grows with the recording: no peak is lost, however long it is.
    """

    def __init__(self) -> None:
        self.points: list[tuple[float, float]] = []
        self._waiting: list[tuple[float, float]] = []
        self._at_once = 1  # how many points four are kept of

    def add(self, when: float, value: float) -> None:
        """Add a point."""
        if self._at_once == 1:
            self.points.append((when, value))
        else:
            self._waiting.append((when, value))
            if len(self._waiting) >= self._at_once:
                self.points += _outline(self._waiting)
                self._waiting = []
        if len(self.points) > POINTS:
            points, self.points = self.points, []
            for place in range(0, len(points), 8):
                self.points += _outline(points[place : place + 8])
            self._at_once = max(8, 2 * self._at_once)

    def all(self) -> list[tuple[float, float]]:
        """Return what is left of all points."""
        return [*self.points, *_outline(self._waiting)]


def _outline(points: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Return the first, the least, the greatest and the last of some points."""
    if len(points) <= 4:
        return points
    values = [value for _, value in points]
    wanted = {0, values.index(min(values)), values.index(max(values)), len(points) - 1}
    return [points[place] for place in sorted(wanted)]


class Seen:
    """What of a recording is in its picture; of any recording as much at the most."""

    def __init__(self, wanted: list[str] | None) -> None:
        self._wanted = wanted
        self.begin: float | None = None
        self.end = 0.0
        self.named: set[str] = set()
        self.tracks: dict[str, Track] = {}
        self.holders: dict[str, list[tuple[float, str]]] = {}
        self.marks: list[tuple[float, str, str]] = []
        self._came_up: set[str] = set()

    def take(self, event: Recorded) -> None:
        """Take the next event."""
        if self.begin is None:
            self.begin = event.time
        self.end = when = event.time - self.begin
        name, kind = event.component, event.kind
        if len(self.named) < NAMES:
            self.named.add(name)
        if self._wanted and name not in self._wanted and kind not in _MARKED:
            return
        if kind in {"reading", "sent", "safe"}:
            for field, number in _numbers(name, event.value):
                self._track(field, when, number)
        if kind in {"sent", "safe"}:
            self._hold(name, when, event)
        is_news = kind in _MARKED and (kind != "up" or name in self._came_up)
        if is_news and len(self.marks) < MARKS:
            self.marks.append((when, name, kind))
        if kind == "up" and name in self.named:  # the first one is the start
            self._came_up.add(name)

    def _track(self, field: str, when: float, number: float) -> None:
        track = self.tracks.get(field)
        if track is None:
            if len(self.tracks) >= TRACKS:
                last = max(self.tracks)
                if field > last:
                    return
                del self.tracks[last]
            track = self.tracks[field] = Track()
        track.add(when, number)

    def _hold(self, name: str, when: float, event: Recorded) -> None:
        told = self.holders.get(name)
        if told is None:
            if len(self.holders) >= TRACKS:
                return
            told = self.holders[name] = []
        before = told[-1][1] if told else "safe"
        # What a guard has made less goes on in the name of who asked for it.
        who = (event.peer or before) if event.kind == "sent" else "safe"
        if (not told or before != who) and len(told) < CHANGES:
            told.append((when, who))


def _numbers(name: str, value: Any, depth: int = 8) -> Iterator[tuple[str, float]]:
    """Yield the numbers in a plain value, by their full names."""
    if isinstance(value, bool | int | float):
        number = float(value) if abs(value) < HIGHEST else math.nan
        yield name[:LONGEST], number
    elif isinstance(value, dict) and depth and len(value) <= TRACKS:
        for field, part in value.items():
            yield from _numbers(f"{name}.{field}", part, depth - 1)
    elif isinstance(value, list) and depth and len(value) <= 8:
        for place, part in enumerate(value):
            yield from _numbers(f"{name}[{place}]", part, depth - 1)


def _draw(seen: Seen, target: Path) -> None:
    from matplotlib.figure import Figure

    from esair.recording import replaced

    tracks, holders = seen.tracks, seen.holders
    names = sorted(tracks)
    rows = len(names) + bool(holders)
    figure = Figure(figsize=(12, 1.2 + 1.1 * max(rows, 1)), layout="constrained")
    axes = figure.subplots(max(rows, 1), 1, sharex=True, squeeze=False)[:, 0]
    for axis, name in zip(axes, names, strict=False):
        times, values = zip(*tracks[name].all(), strict=True)
        # A command stands until the next one.
        style = "steps-post" if name.partition(".")[0] in holders else "default"
        axis.plot(times, values, ".-", markersize=2, linewidth=0.8, drawstyle=style)
        axis.set_ylabel(_shown(name), rotation=0, ha="right", va="center", fontsize=8)
        if set(values) <= {0.0, 1.0}:  # yes or no
            axis.set_ylim(-0.1, 1.1)
        axis.tick_params(labelsize=7)
    if holders:
        _draw_holders(axes[rows - 1], holders, seen.end)
    for axis in axes:
        for when, _, kind in seen.marks:
            axis.axvline(when, color=_MARKED[kind], linewidth=0.7, alpha=0.7)
    for place, (when, name, kind) in enumerate(seen.marks[:40]):
        axes[0].annotate(
            _shown(f"{name} {kind}"),
            (when, 1.02 + 0.12 * (place % 3)),
            xycoords=("data", "axes fraction"),
            fontsize=6,
            color=_MARKED[kind],
        )
    axes[-1].set_xlabel("s since the beginning of the recording", fontsize=8)
    # Not by its name: a link that lies there must not be written through.
    with replaced(target) as picture:
        figure.savefig(picture, dpi=110, format=target.suffix[1:] or "png")


def _shown(text: str) -> str:
    """Return a name of a recording as a text of the picture; a dollar is no formula."""
    return printable(text[:LONGEST]).replace("$", r"\$")


def _draw_holders(
    axis: Any, holders: dict[str, list[tuple[float, str]]], end: float
) -> None:
    """Draw a bar for each actuator: who moved it, and when it was safe."""
    colors: dict[str, str] = {"safe": "lightgray"}
    for row, name in enumerate(sorted(holders)):
        changes = holders[name]
        ends = [when for when, _ in changes[1:]] + [end]
        for (when, who), until in zip(changes, ends, strict=True):
            color = colors.setdefault(who, f"C{len(colors) - 1}")
            axis.barh(row, until - when, left=when, color=color, height=0.8)
    for who, color in colors.items():
        axis.plot([], [], color=color, linewidth=6, label=_shown(who))
    legend = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "frameon": False}
    axis.legend(fontsize=7, ncols=8, borderaxespad=0.1, **legend)
    axis.set_yticks(range(len(holders)), map(_shown, sorted(holders)), fontsize=7)
    axis.set_ylabel("moved by", rotation=0, ha="right", va="center", fontsize=8)
