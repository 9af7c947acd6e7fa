"""``python -m benchmarks``: every goal in one table."""

from __future__ import annotations

import argparse
import asyncio
import json
import logging
import os
import platform
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import attrs
from rich.console import Console
from rich.table import Table

from benchmarks import harness
from benchmarks.cases import (
    data_path,
    devices,
    garbage,
    journal,
    large,
    lifecycle,
    mediator,
    minimal,
    placed,
    reactions,
    realtime,
    recording,
    remote,
    ros2,
    seat,
    starting,
    wire_garbage,
)
from benchmarks.harness import Row
from esair.loop import TurnLoop

CASES = {
    "P1,P2": mediator,
    "P3,P4": data_path,
    "P5,P6,P7": reactions,
    "P8,P9": devices,
    "P10,P12": lifecycle,
    "P10,LARGE": large,
    "P11": starting,
    "P13": garbage,
    "P15": minimal,
    "P18": journal,
    "P19": ros2,
    "P21": wire_garbage,
    "P22": realtime,
    "P23": placed,
    "P24": remote,
    "OPS": seat,
    "REC": recording,
}


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("--only", default="", help="goals to measure, such as P1,P5")
    parser.add_argument(
        "--loop",
        choices=["esair", "asyncio", "uvloop"],
        default="esair",
        help="what cases run on: the loop of esair.run, unless given",
    )
    parser.add_argument(
        "--smoke", action="store_true", help="see that all cases run; measure nothing"
    )
    parser.add_argument("--json", type=Path, help="write the rows to a file")
    parser.add_argument(
        "--markdown",
        type=Path,
        help="write the table to a file: between its marks, if it has some",
    )
    parser.add_argument(
        "--ros", type=Path, help="a Python of its own with ros-kilted-rclpy, for P19"
    )
    arguments = parser.parse_args()
    harness.ros_python = arguments.ros
    logging.disable(logging.WARNING)
    if arguments.smoke:
        _shorten()
    wanted = {goal for goal in arguments.only.upper().split(",") if goal}
    factory: Callable[[], asyncio.AbstractEventLoop] | None = TurnLoop
    if arguments.loop == "uvloop":
        import uvloop

        factory = uvloop.new_event_loop
    elif arguments.loop == "asyncio":
        factory = None
    begin, load = time.perf_counter(), os.getloadavg()[0]
    rows: list[Row] = []
    for goals, case in CASES.items():
        if not wanted or wanted & set(goals.split(",")):
            with asyncio.Runner(loop_factory=factory) as runner:
                rows += runner.run(case.rows())
    seconds = time.perf_counter() - begin
    machine = (
        f"Python {platform.python_version()}, loop: {arguments.loop}, {seconds:.0f} s, "
        f"{os.cpu_count()} cores, load {load:.1f} at the start"
    )
    _show(rows, machine)
    if arguments.json:
        text = json.dumps([attrs.asdict(row) for row in rows], indent=2)
        arguments.json.write_text(text + "\n")
    if arguments.markdown:
        _write(arguments.markdown, _markdown(rows, machine))


SMOKE: dict[ModuleType, dict[str, object]] = {
    harness: {"smoke": True},
    data_path: {"COUNT": 50},
    reactions: {"SLICE": 0.1, "COUNT": 40, "HOUR": 60.0},
    devices: {"COUNT": 20},
    lifecycle: {"PAIRS": 18},
    large: {"FEW": 10, "MOST": 60, "REQUESTS": 100},
    garbage: {"SECONDS": 0.5},
    ros2: {"SECONDS": 0.1},
    realtime: {"SECONDS": 0.2},
    placed: {"IDLE": 3},
    remote: {"COUNT": 5},
    seat: {"SECONDS": 0.1},
}
"""How long, and how large, the cases are when nothing is measured."""


def _shorten() -> None:
    for module, constants in SMOKE.items():
        for name, value in constants.items():
            getattr(module, name)  # a constant that has gone is an error
            setattr(module, name, value)


def _cells(row: Row) -> list[str]:
    ratio = f"{row.ratio:.3f}" if row.ratio or row.goal is not None else ""
    goal = f"<= {row.goal:.3g}" if row.goal is not None else ""
    return [row.case, row.esair, row.limit, ratio, goal, row.met, row.note]


HEAD = ["case", "esair", "limit or peer", "ratio", "goal", "met", "note"]


def _show(rows: list[Row], machine: str) -> None:
    table = Table(*HEAD, title=f"esair benchmarks ({machine})")
    for row in rows:
        table.add_row(*_cells(row), style="red" if row.met == "NO" else "")
    Console(width=None if sys.stdout.isatty() else 150).print(table)


BEGIN, END = "<!-- python -m benchmarks -->", "<!-- end -->"
"""Between these marks the table of a page is written."""


def _write(page: Path, table: str) -> None:
    text = page.read_text() if page.exists() else f"{BEGIN}\n{END}\n"
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not (begin and end):
        sys.exit(f"{page}: expected the marks {BEGIN} and {END} around its table")
    page.write_text(f"{before}{BEGIN}\n\n{table}\n{END}{after}")


def _markdown(rows: list[Row], machine: str) -> str:
    lines = ["| " + " | ".join(HEAD) + " |", "|" + "---|" * len(HEAD)]
    lines += ["| " + " | ".join(_cells(row)) + " |" for row in rows]
    return f"{machine}\n\n" + "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
