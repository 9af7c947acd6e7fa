"""``esair top``: what a robot is doing, as a table that lives."""

from __future__ import annotations

import json
import sys
import time
from typing import Annotated, Any

from cyclopts import Parameter
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from esair.cli._errors import CANNOT_USE, tell
from esair.exceptions import EsairError
from esair.seat import Client, NoRobotError, connect
from esair.values import printable

NOT_SHOWN = 1
"""The exit code if the robot ended before it was seen."""

_COLORS = {
    "ready": "green",
    "running": "green",
    "finished": "cyan",
    "lost": "bold red",
    "failed": "bold red",
    "removed": "red",
}
"""The color of each state; of others it is yellow."""


def top(
    *,
    robot: Annotated[str | None, Parameter(name=["--robot", "-r"])] = None,
    machine: Annotated[bool, Parameter(name="--json", negative=())] = False,
) -> int:
    """Show what a robot is doing: state, holder, rate, age, late, losses, refusals.

    On a terminal until Ctrl-C; else once, as plain text.

    Args:
        robot: The name of the robot, if several run.
        machine: One picture in JSON, for other programs.
    """
    try:
        with connect(robot) as client:
            if machine or not sys.stdout.isatty():
                return _once(client, machine=machine)
            return _live(client)
    except NoRobotError as error:
        tell(printable(str(error)))
        return CANNOT_USE
    except (EsairError, TimeoutError) as error:
        tell(printable(str(error)))
        return NOT_SHOWN


def _once(client: Client, *, machine: bool) -> int:
    client.do("status")
    time.sleep(1.0)  # a rate needs two looks
    status = client.do("status")
    if machine:
        print(json.dumps(status))  # noqa: T201 - this is the output
        return 0
    console = Console(width=120, no_color=True, highlight=False)
    console.print(picture(status, 10_000))
    return 0


def _live(client: Client) -> int:
    console = Console(highlight=False)
    client.do("watch", {"every": 0.25})
    try:
        with Live(console=console, screen=True, auto_refresh=False) as live:
            for found in client.lines(timeout=5.0):
                if "status" in found:
                    shown = picture(found["status"], console.height)
                    live.update(shown, refresh=True)
    except KeyboardInterrupt:
        return 0
    tell(f"robot {client.name!r} has said nothing for 5 s")
    return NOT_SHOWN


def picture(status: dict[str, Any], height: int) -> RenderableType:
    """Return the table of a robot, for so many lines.

    What has a problem comes first where there is not room for all.
    """
    head = Text(printable(status["robot"]), "bold", no_wrap=True, overflow="ellipsis")
    head.append(f"  up {_span(status['up'])}  ", "not bold")
    if status["halted"] is not None:
        head.append(f"HALTED: {printable(status['halted'])}", "bold white on red")
    rows = [*_resources(status), *_behaviors(status)]
    room = max(height - 4, 3)
    left = len(rows) - room
    if left > 0:
        kept = sorted(range(len(rows)), key=lambda n: (-rows[n][0], n))[: room - 1]
        rows = [rows[n] for n in sorted(kept)]
    table = Table(box=None, expand=True, padding=(0, 1, 0, 0), header_style="dim")
    table.add_column("name", no_wrap=True, ratio=3, min_width=8)
    table.add_column("state", no_wrap=True, min_width=8)
    table.add_column("holder, value", no_wrap=True, ratio=5, overflow="ellipsis")
    for name in ("Hz", "age", "late", "lost", "refused"):
        table.add_column(name, no_wrap=True, justify="right")
    for _, cells in rows:
        table.add_row(*cells)
    foot = Text("Ctrl-C leaves; esair stop halts the robot", "dim", no_wrap=True)
    if left > 0:
        foot = Text(f"{left + 1} more rows have no room; ", "yellow").append(foot)
    return Group(head, table, foot)


Row = tuple[int, tuple[Text | str, ...]]
"""How much it asks for attention, and its cells."""


def _resources(status: dict[str, Any]) -> list[Row]:
    rows: list[Row] = []
    for each in status["resources"]:
        told = Text(no_wrap=True, overflow="ellipsis")
        if each["error"]:
            told.append(printable(each["error"]), "red")
        elif each["kind"] == "actuator":
            told.append(printable(each["holder"] or "free"), "bold")
            if each["priority"] is not None:
                told.append(f" ({each['priority']})")
            told.append(f" {printable(each.get('value') or '')}", "dim")
        else:
            told.append(printable(each.get("value") or ""), "dim")
        rows.append(
            (
                3 if each["state"] != "ready" else int(each["kind"] == "actuator"),
                (
                    printable(each["name"]),
                    _state(each["state"]),
                    told,
                    _number(each["rate"]),
                    _age(each["age"]),
                    str(each["late"]),
                    str(each["losses"]),
                    str(each["refusals"]),
                ),
            )
        )
    return rows


def _behaviors(status: dict[str, Any]) -> list[Row]:
    return [
        (
            2 if each["state"] not in {"running", "finished"} else 0,
            (
                printable(each["name"]),
                _state(each["state"]),
                Text(
                    printable(each["detail"] or each["error"] or each["kind"]),
                    "" if each["detail"] else "dim",
                    no_wrap=True,
                    overflow="ellipsis",
                ),
                _number(each["rate"]),
                "",
                str(each["late"]),
                str(each["restarts"]),
                str(each["refusals"]),
            ),
        )
        for each in status["behaviors"]
    ]


def _state(state: str) -> Text:
    return Text(printable(state), _COLORS.get(state, "yellow"))


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
