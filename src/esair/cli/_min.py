"""``esair min build``: the robot of a file for a microcontroller."""

from __future__ import annotations

from pathlib import Path

from cyclopts import App
from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from esair.firmware import Built
from esair.firmware import build as build_files

minimal = App(name="min", help="Robots on a microcontroller.")


@minimal.command
def build(
    file: Path,
    /,
    *,
    out: Path,
    board: str = "micropython",
    rate: float | None = None,
    watchdog: float | None = None,
) -> int:
    """Write the files that a microcontroller needs to run the robot of a robot.toml.

    Everything that does not fit is told at once; then nothing is written.

    Args:
        file: The configuration of the robot.
        out: The folder to write; copy what is in it to the board.
        board: "micropython", or "microbit" for its tiny memory.
        rate: Steps per second; the highest rate of a part, or 50, unless given.
        watchdog: Time-out of the board's hardware watchdog, in seconds.
    """
    built = build_files(file, out, board=board, rate=rate, watchdog=watchdog)
    console = Console(highlight=False)
    console.print(_files(built))
    compiled = "; compiled files are in compiled/" if built.compiled else ""
    console.print(
        Text(f"{built.folder} is ready: {built.rate:g} steps per second{compiled}"),
        soft_wrap=True,
    )
    return 0


def _files(built: Built) -> Table:
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("file", style="cyan")
    table.add_column("bytes", justify="right")
    table.add_column("compiled", justify="right")
    for name, size in built.files.items():
        table.add_row(name, str(size), str(built.compiled.get(name, "")))
    return table
