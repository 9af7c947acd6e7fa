"""The entry point ``esair``: which verb, and what becomes of its errors."""

from __future__ import annotations

import contextlib
import errno
import importlib.metadata
import importlib.util
import os
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

from esair.cli._errors import CANNOT_USE, NOT_DONE, exit_code_of, tell
from esair.exceptions import describe

if TYPE_CHECKING:
    from cyclopts import App

_NEEDED: Final = ("cyclopts", "rich")


def main(arguments: Sequence[str] | None) -> None:
    """Run one verb and end the process with its exit code."""
    for package in _NEEDED:
        if importlib.util.find_spec(package) is None:
            tell(f'the command line needs {package}: pip install "esair[cli]"')
            sys.exit(CANNOT_USE)
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:  # closed: its number would be a device's
            setattr(sys, name, open(os.devnull, mode))  # noqa: SIM115 - it stays
    with contextlib.suppress(AttributeError):  # of a program that has put its own there
        # A terminal of few letters gets the others as numbers, not an error.
        sys.stdout.reconfigure(errors="backslashreplace")  # type: ignore[union-attr]
    code = 0
    try:
        code = _run(sys.argv[1:] if arguments is None else list(arguments))
        sys.stdout.flush()
    except BrokenPipeError:  # the reader, such as ``head``, has seen enough
        _write_no_more()
    except SystemExit as end:  # rich has met a reader that has seen enough
        if not isinstance(end.__context__, BrokenPipeError):
            raise
    except OSError as error:
        if error.errno != errno.ENOSPC:
            raise
        _write_no_more()
        tell(describe(error))
        code = NOT_DONE  # there is no room for what is to be written
    sys.exit(code)


def _write_no_more() -> None:
    """Keep the interpreter from writing the rest at its end."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _run(arguments: list[str]) -> int:
    from cyclopts import CycloptsError, MissingArgumentError

    try:
        verb, bound, _ = make_app().parse_args(
            arguments, exit_on_error=False, print_error=True
        )
    except CycloptsError as error:
        greedy = [
            word for word in arguments if word in ("--record", "--page", "--realtime")
        ]
        if greedy and isinstance(error, MissingArgumentError):
            tell(f"{greedy[0]} takes the word after it: write it after the FILE")
        return CANNOT_USE
    try:
        return verb(*bound.args, **bound.kwargs) or 0
    except Exception as error:
        code = exit_code_of(error)
        if code is None or "--traceback" in arguments:
            raise
        return code


def make_app() -> App:
    """Return the command line with all its verbs."""
    from cyclopts import App, Group, Parameter

    from esair.cli._check import check
    from esair.cli._demo import demo
    from esair.cli._devices import devices
    from esair.cli._hand import drive
    from esair.cli._log_file import log, recover
    from esair.cli._measure import measure
    from esair.cli._min import minimal
    from esair.cli._new import new
    from esair.cli._peers import peers
    from esair.cli._plot import plot
    from esair.cli._replay import replay
    from esair.cli._ros import ros
    from esair.cli._run import run, sim
    from esair.cli._steer import VERBS, verb_of
    from esair.cli._top import top
    from esair.cli._torture import torture
    from esair.cli._view import view

    app = App(
        name="esair",
        help="Robots that must not hurt anyone, lose data, or stop for a loose cable.",
        version=importlib.metadata.version("esair"),
        default_parameter=Parameter(negative=()),  # no --no-json, no --empty-page
    )
    for verb in (new, check, sim, run, measure, torture, demo, devices):
        app.command(verb)
    for other in (log, plot, replay, recover, minimal):
        app.command(other)
    running = Group("A robot that runs", sort_key=1)
    for steer in (top, peers, ros, view, drive):
        app.command(steer, group=running)
    for name in VERBS:
        app.command(verb_of(name), group=running)
    return app
