"""``esair plot``: a recording as a picture of tracks, holders and events."""

from __future__ import annotations

import collections
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from esair.cli._errors import CANNOT_USE, has_unknown, tell
from esair.cli._options import Components, Out

if TYPE_CHECKING:
    from esair.recording import Recorded

TRACKS = 24
"""How many tracks one picture has; what comes later in the alphabet is left out."""

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
    events = list(events_of(file))
    if not events:
        tell(f"{file}: there is no event in it")
        return CANNOT_USE
    named = {event.component for event in events}
    if has_unknown("--component", component or [], named):
        return CANNOT_USE
    _draw(events, target, component)
    print(target)  # noqa: T201 - this is the output
    return 0


def _numbers(name: str, value: Any) -> Iterator[tuple[str, float]]:
    """Yield the numbers in a plain value, by their full names."""
    if isinstance(value, bool | int | float):
        yield name, float(value)
    elif isinstance(value, dict):
        for field, part in value.items():
            yield from _numbers(f"{name}.{field}", part)
    elif isinstance(value, list) and len(value) <= 8:
        for place, part in enumerate(value):
            yield from _numbers(f"{name}[{place}]", part)


def _draw(events: list[Recorded], target: Path, wanted: list[str] | None) -> None:
    from matplotlib.figure import Figure

    begin = events[0].time
    tracks: dict[str, list[tuple[float, float]]] = collections.defaultdict(list)
    holders: dict[str, list[tuple[float, str]]] = collections.defaultdict(list)
    marks = []
    seen: set[str] = set()
    for event in events:
        if wanted and event.component not in wanted and event.kind not in _MARKED:
            continue
        when = event.time - begin
        if event.kind in {"reading", "sent", "safe"}:
            for name, number in _numbers(event.component, event.value):
                tracks[name].append((when, number))
        if event.kind in {"sent", "safe"}:
            told = holders[event.component]
            before = told[-1][1] if told else "safe"
            # What a guard has made less goes on in the name of who asked for it.
            who = (event.peer or before) if event.kind == "sent" else "safe"
            if not told or before != who:
                told.append((when, who))
        if event.kind in _MARKED and (event.kind != "up" or event.component in seen):
            marks.append((when, event))
        if event.kind == "up":  # the first one is the start
            seen.add(event.component)
    names = sorted(tracks)[:TRACKS]
    rows = len(names) + bool(holders)
    figure = Figure(figsize=(12, 1.2 + 1.1 * max(rows, 1)), layout="constrained")
    axes = figure.subplots(max(rows, 1), 1, sharex=True, squeeze=False)[:, 0]
    for axis, name in zip(axes, names, strict=False):
        times, values = zip(*tracks[name], strict=True)
        # A command stands until the next one.
        style = "steps-post" if name.partition(".")[0] in holders else "default"
        axis.plot(times, values, ".-", markersize=2, linewidth=0.8, drawstyle=style)
        axis.set_ylabel(name, rotation=0, ha="right", va="center", fontsize=8)
        if set(values) <= {0.0, 1.0}:  # yes or no
            axis.set_ylim(-0.1, 1.1)
        axis.tick_params(labelsize=7)
    if holders:
        _draw_holders(axes[rows - 1], holders, events[-1].time - begin)
    for axis in axes:
        for when, event in marks:
            axis.axvline(when, color=_MARKED[event.kind], linewidth=0.7, alpha=0.7)
    for place, (when, event) in enumerate(marks[:40]):
        axes[0].annotate(
            f"{event.component} {event.kind}",
            (when, 1.02 + 0.12 * (place % 3)),
            xycoords=("data", "axes fraction"),
            fontsize=6,
            color=_MARKED[event.kind],
        )
    axes[-1].set_xlabel("s since the beginning of the recording", fontsize=8)
    figure.savefig(target, dpi=110)


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
        axis.plot([], [], color=color, linewidth=6, label=who)
    legend = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "frameon": False}
    axis.legend(fontsize=7, ncols=8, borderaxespad=0.1, **legend)
    axis.set_yticks(range(len(holders)), sorted(holders), fontsize=7)
    axis.set_ylabel("moved by", rotation=0, ha="right", va="center", fontsize=8)
