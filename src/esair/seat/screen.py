"""What a robot is doing, drawn for a terminal: the screen of ``top`` and of the demo.

It is drawn from a picture of the robot alone (`Status.picture`), so that whoever draws may
be another process or another thread than the robot's. It needs ``rich``.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from rich.console import Console, Group, RenderableType
from rich.table import Table
from rich.text import Text

from esair.journal import Kind
from esair.values import printable

HAPPENED = (
    Kind.UP,
    Kind.DOWN,
    Kind.PARKED,
    Kind.CRASHED,
    Kind.RESTARTED,
    Kind.FAILED,
    Kind.FINISHED,
    Kind.MODE,
    Kind.ADDED,
    Kind.REMOVED,
    Kind.HALTED,
    Kind.RESUMED,
    Kind.UNANSWERED,
    Kind.OPERATOR,
    Kind.CONFIGURED,
)
"""What is told below the table: what is seldom, and matters."""

_COLORS = {
    "ready": "green",
    "running": "green",
    "finished": "cyan",
    "resting": "dim",
    "mode": "cyan",
    "up": "green",
    "resumed": "green",
    "lost": "bold red",
    "failed": "bold red",
    "halted": "bold red",
    "down": "red",
    "crashed": "red",
    "removed": "red",
}
"""The color of each state and event; of others it is yellow."""

_NUMBERS = ("Hz", "age", "late", "lost", "refused")

Drawing = Callable[[int, int], Text]
"""Draws something beside what has happened, on so many columns and lines at most."""


def picture(
    status: Mapping[str, Any],
    console: Console,
    *,
    happened: Sequence[Text] = (),
    drawing: Drawing | None = None,
    height: int | None = None,
    hint: str = "Ctrl-C leaves; esair stop halts the robot",
) -> RenderableType:
    """Return the picture of a robot as a screen.

    Where there is not room for all components, those with a problem come first; where
    it is narrow, the holder before the numbers.

    Args:
        status: The picture of the robot.
        console: What it is for.
        happened: What has happened, the oldest first; the newest are shown.
        drawing: What is drawn beside that, if there is room.
        height: How many lines there are; those of the console unless given.
        hint: What the head says to whoever looks.
    """
    height = height or console.height
    rows = [*_resources(status), *_behaviors(status)]
    left = len(rows) - max(height - 3, 3)
    if left > 0:
        kept = sorted(range(len(rows)), key=lambda n: (-rows[n][0], n))
        rows = [rows[n] for n in sorted(kept[: len(rows) - left - 1])]
    table = Table(box=None, expand=True, padding=(0, 1, 0, 0), header_style="dim")
    widest = max(console.width * 3 // 10, 8)
    table.add_column("name", no_wrap=True, min_width=8, max_width=widest)
    table.add_column("state", no_wrap=True, min_width=8)
    table.add_column("holder, value", no_wrap=True, ratio=1, overflow="ellipsis")
    # Where it is narrow the numbers make room for the holder, each with its 6 columns.
    numbers = _NUMBERS[: max(len(_NUMBERS) - max(85 - console.width, 0) // 6, 0)]
    for name in numbers:
        table.add_column(name, no_wrap=True, justify="right")
    for _, cells in rows:
        table.add_row(*cells[: 3 + len(numbers)])
    parts: list[RenderableType] = [_head(status, hint, console.width), table]
    if left > 0:
        parts.append(Text(f"{left + 1} more rows have no room", "yellow"))
    room = height - 2 - len(rows) - (left > 0) - 1
    if room > 1 and (happened or drawing):
        parts += [Text(), _below(console, happened, drawing, room - 1)]
    return Group(*parts)


def event_line(event: Mapping[str, Any], clock: str) -> Text:
    """Return an event of the journal as a line.

    Args:
        event: As a robot tells it.
        clock: When that was, in words.
    """
    kind, peer = event["kind"], event["peer"]
    by = f" by {peer}" if peer and kind not in {"added", "removed"} else ""
    rest = event["text"] or _told_value(event["value"])
    line = Text(f"{clock} ", "dim", no_wrap=True, overflow="ellipsis")
    what = f"{event['component']} {kind}{by}"
    if kind == Kind.MODE:
        what = f"mode {event['component']}"
    line.append(printable(what), f"not dim {_color(kind)}")
    return line.append(f" {printable(rest)[:400]}", "not dim")


def _told_value(value: Any) -> str:
    if value is None or isinstance(value, str):
        return value or ""
    if isinstance(value, dict) and "act" in value:  # what an operator did
        value = [value["act"], *(v for k, v in value.items() if k not in {"act", "by"})]
        return " ".join(str(each) for each in value if each is not None)
    return json.dumps(value)


def _head(status: Mapping[str, Any], hint: str, width: int) -> Text:
    head = Text(printable(status["robot"]), "bold", no_wrap=True, overflow="ellipsis")
    head.truncate(width // 3, overflow="ellipsis")  # however long, a halt is seen
    mode = status.get("mode")
    told = "" if mode is None else f"mode {printable(mode)}  "
    head.append(f"  up {_span(status['up'])}  ", "not bold")
    if status["halted"] is not None:
        head.append(f"HALTED: {printable(status['halted'])}", "bold white on red")
        return head.append(f"  {told}", "not bold")
    return head.append(told, "not bold").append(hint, "not bold dim")


def _below(
    console: Console, happened: Sequence[Text], drawing: Drawing | None, room: int
) -> RenderableType:
    width = console.width
    drawn = None if drawing is None else drawing(width // 2, room)
    if drawn is not None:
        width -= max((len(line) for line in drawn.plain.split("\n")), default=0) + 2
    lines: list[Text] = []
    for event in reversed(happened):
        wrapped = event.wrap(console, width)
        if len(lines) + len(wrapped) > room:
            break
        lines = [*wrapped, *lines]
    if drawn is None:
        return Group(*lines)
    grid = Table.grid(padding=(0, 2, 0, 0))
    grid.add_row(drawn, Group(*lines))
    return grid


Row = tuple[int, tuple[Text | str, ...]]
"""How much it asks for attention, and its cells."""


def _row(each: Mapping[str, Any], attention: int, told: Text, lost: str) -> Row:
    cells: tuple[Text | str, ...] = (
        printable(each["name"]),
        Text(printable(each["state"]), _color(each["state"])),
        told,
        _number(each["rate"]),
        _age(each.get("age")),
        *(str(each[name]) for name in ("late", lost, "refusals")),
    )
    return attention, cells


def _resources(status: Mapping[str, Any]) -> list[Row]:
    return [
        _row(
            each,
            3 if each["state"] != "ready" else int(each["kind"] == "actuator"),
            _told(each),
            "losses",
        )
        for each in status["resources"]
    ]


def _behaviors(status: Mapping[str, Any]) -> list[Row]:
    rows = []
    for each in status["behaviors"]:
        pid = each.get("pid")
        kind = each["kind"] if pid is None else f"{each['kind']} in process {pid}"
        told = printable(each["detail"] or each["error"] or kind)
        style = "" if each["detail"] else "dim"
        text = Text(told, style, no_wrap=True, overflow="ellipsis")
        calm = each["state"] in {"running", "finished", "resting"}
        rows.append(_row(each, 0 if calm else 2, text, "restarts"))
    return rows


def _told(each: Mapping[str, Any]) -> Text:
    """Return the value of a sensor, or who moves an actuator, or why it stands."""
    told = Text(no_wrap=True, overflow="ellipsis")
    value = f" {printable(each.get('value') or '')}"
    if each["error"]:
        return told.append(_without_long_words(printable(each["error"])), "red")
    if each["kind"] == "sensor":
        return told.append(value[1:], "dim")
    if each["stands"]:
        return told.append(printable(each["stands"]), "bold red")
    told.append(printable(each["holder"] or "free"), "bold")
    if each["priority"] is not None:
        told.append(f" ({each['priority']})")
    return told.append(value, "dim")


def _without_long_words(text: str) -> str:
    """Return a text whose long words, such as paths, leave room for the others."""
    words = text.split(" ")
    return " ".join(w if len(w) <= 24 else f"{w[:5]}…{w[-16:]}" for w in words)


def _color(word: str) -> str:
    return _COLORS.get(word, "yellow")


def _number(rate: float | None) -> str:
    return "" if rate is None else f"{rate:.0f}" if rate >= 10 else f"{rate:.1f}"


def _age(seconds: float | None) -> str:
    if seconds is None:
        return ""
    return f"{seconds * 1000:.0f} ms" if seconds < 1.0 else _span(seconds)


def _span(seconds: float) -> str:
    if seconds < 60:
        return f"{seconds:.0f} s"
    minutes, hours = int(seconds // 60), int(seconds // 3600)
    return f"{minutes} min" if minutes < 120 else f"{hours} h"
