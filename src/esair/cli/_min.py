"""``esair min``: the robot of a file for a microcontroller."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from cyclopts import App
from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from esair.cli._errors import CANNOT_USE, wrong_seconds
from esair.exceptions import ConfigError
from esair.firmware import Built, run_folder
from esair.firmware import build as build_files
from esair.firmware import deploy as deploy_files
from esair.firmware import monitor as monitor_board
from esair.firmware.c import TARGETS
from esair.firmware.c import build as build_c

minimal = App(name="min", help="Robots on a microcontroller.")


@minimal.command
def build(
    file: Path,
    /,
    *,
    out: Path,
    board: str = "pico",
    rate: float | None = None,
    watchdog: float | Literal["off"] | None = None,
    arm: str = "host",
    link: bool = False,
) -> int:
    """Write the files that a microcontroller needs to run the robot of a robot.toml.

    Everything that does not fit is told at once; then nothing is written. With a
    MicroPython on this computer (pip install 'esair[min]') what was written runs there
    for a second, and what fails is told with file and line.

    Args:
        file: The configuration of the robot.
        out: The folder to write; copy what is in it to the board.
        board: "pico", "pico2", "esp32", or "esp32s3"; "c" or "avr" for a chip without
            Python: the reactions as C99, on pins that you read and write yourself.
        rate: Steps per second; the highest rate of a part, or 50, unless given.
        watchdog: Time-out of the board's hardware watchdog, in seconds, or "off"; two
            seconds, or four steps, unless given.
        arm: When the board may move after a start: "host" (it is told so), "pin:NUMBER"
            (while that pin is low), or "always".
        link: The board is a part of a robot on a computer, on its serial line.
    """
    if board in TARGETS:
        if link:
            raise ConfigError("esair min build", "link", "C has no line to a computer")
        bite = None if watchdog == "off" else watchdog
        translated = build_c(file, out, target=board, rate=rate, watchdog=bite, arm=arm)
        for name, size in translated.files.items():
            _say(f"{translated.folder / name}: {size} bytes")
        kind = "double" if board == "c" else "float"
        floats = f"counts with {kind}" if translated.has_floats else "has no floats"
        _say(f"{translated.rate:g} steps per second; it {floats}")
        return 0
    built = build_files(
        file, out, board=board, rate=rate, watchdog=watchdog, arm=arm, link=link
    )
    Console(highlight=False).print(_files(built))
    compiled = "; compiled files are in compiled/" if built.compiled else ""
    _say(f"{built.folder} is ready: {built.rate:g} steps per second{compiled}")
    tried = "not tried: there is no MicroPython here: pip install 'esair[min]'"
    if built.trial is not None:
        used = f"{built.trial.memory / 1000:.1f} of {built.board.memory} KB"
        tried = f"it ran in MicroPython; on a {built.board.name} it takes about {used}"
    for line in (tried, *built.uneven):
        _say(line)
    return 0


@minimal.command
def run(folder: Path, /, *, seconds: float = 5.0) -> int:
    """Run a built folder under a real MicroPython on this computer.

    Nothing is connected to its pins; what it prints is shown.

    Args:
        folder: What esair min build has written.
        seconds: How long it runs.
    """
    if wrong_seconds(seconds, "--seconds"):
        return CANNOT_USE
    trial = run_folder(folder, seconds=seconds, show=True)
    late = [f"{trial.late} steps came too late on this computer"] * bool(trial.late)
    counts = f"{trial.steps} steps, {trial.refused} commands refused"
    for line in (*trial.faults, *late, counts):
        _say(line)
    return 1 if trial.mistakes else 0


@minimal.command
def deploy(folder: Path, /, *, port: str = "auto", seconds: float = 20.0) -> int:
    """Copy a built folder to a board, compare, reset it, and wait until it is ready.

    A program that runs there is stopped first, with the safe commands.

    Args:
        folder: What esair min build has written.
        port: The board's serial port, a path or usb:...; the only one at USB if not said.
        seconds: How long to wait for the board after its reset.
    """
    if wrong_seconds(seconds, "--seconds"):
        return CANNOT_USE
    done = deploy_files(folder, port=port, seconds=seconds, say=_say)
    size = sum(done.files.values()) / 1000
    _say(f"{len(done.files)} files, {size:.1f} KB, are on the board: {done.ready}")
    return 0


@minimal.command
def monitor(*, port: str = "auto", seconds: float | None = None) -> int:
    """Show what a board says, until Ctrl-C: its lines, and how a linked one is.

    Args:
        port: The board's serial port, a path or usb:...; the only one at USB if not said.
        seconds: How long; until Ctrl-C if not said.
    """
    if wrong_seconds(seconds, "--seconds"):
        return CANNOT_USE
    monitor_board(port, _say, seconds=seconds)
    return 0


def _say(line: object) -> None:
    Console(highlight=False).print(Text(str(line)), soft_wrap=True)


def _files(built: Built) -> Table:
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("file", style="cyan")
    table.add_column("bytes", justify="right")
    table.add_column("compiled", justify="right")
    for name, size in built.files.items():
        table.add_row(name, str(size), str(built.compiled.get(name, "")))
    return table
