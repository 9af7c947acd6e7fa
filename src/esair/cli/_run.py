"""``esair run`` and ``esair sim``: the robot of a file, real or simulated."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import attrs
from rich.console import Console
from rich.text import Text

import esair
from esair import config
from esair.cli._errors import CANNOT_USE, NOT_DONE, counted, tell, wrong_seconds
from esair.cli._log import shown_log
from esair.cli._options import Running
from esair.exceptions import EsairError
from esair.standard import told

_AS_SAID = Running()


def run(
    file: Path,
    /,
    *,
    loop: Literal["asyncio", "uvloop"] = "asyncio",
    options: Running = _AS_SAID,
) -> int:
    """Run the robot of a robot.toml on its real hardware.

    Ctrl-C stops it: every actuator gets its safe command first.

    Args:
        file: The configuration of the robot.
        loop: The event loop: Python's own, or uvloop if it is installed.
        options: How.
    """
    factory = None
    if loop == "uvloop":
        try:
            import uvloop
        except ImportError:
            tell("--loop: uvloop is not installed: pip install 'esair[uvloop]'")
            return CANNOT_USE
        factory = uvloop.new_event_loop
    return _drive(file, options, simulated=False, loop_factory=factory)


def sim(file: Path, /, *, options: Running = _AS_SAID) -> int:
    """Run the robot of a robot.toml in simulation, by its sim tables.

    Ctrl-C stops it: every actuator gets its safe command first.

    Args:
        file: The configuration of the robot.
        options: How.
    """
    return _drive(file, options, simulated=True)


def _drive(
    file: Path,
    options: Running,
    *,
    simulated: bool,
    loop_factory: Callable[[], asyncio.AbstractEventLoop] | None = None,
) -> int:
    """Run the robot of a file until it ends, or until a signal."""
    if wrong_seconds(options.seconds):
        return CANNOT_USE
    console = Console(stderr=True, highlight=False)
    sys.path.insert(0, str(file.resolve().parent))  # modules imported while it runs
    described = config.load(file, simulated=simulated)
    try:
        robot = config.build(described, _with(described, options))
    except EsairError as error:
        return _not_started(error)
    console.print(_headline(described))
    try:
        with shown_log(verbose=options.verbose, tracebacks=options.traceback):
            esair.run(robot, duration=options.seconds, loop_factory=loop_factory)
    except EsairError as error:
        if options.traceback:
            raise
        return _not_started(error)
    except ExceptionGroup as group:
        errors, rest = group.split(EsairError)
        if errors is None or rest is not None or options.traceback:
            raise
        return _not_started(*errors.exceptions)
    # What each actuator was told at the end is in the log.
    return 0 if all(told.answered for told in robot.stopped) else NOT_DONE


def _with(described: config.Description, how: Running) -> Callable[..., esair.Robot]:
    """Return what makes the robot: with a control socket, and recorded if wanted."""
    extra: dict[str, Any] = {}
    if how.record is not None:
        (path,) = how.record or [Path()]
        known = described.robot.get("record") or esair.Recording(path)
        extra["record"] = attrs.evolve(known, path=path)
    if how.page is not None:
        extra["page"] = _page(described.robot.get("page"), how.page, how.insecure)
    if how.realtime is not None:
        extra["realtime"] = how.realtime[0] if how.realtime else True

    def make(**given: Any) -> esair.Robot:
        _place(how.placement or [], [*given["resources"], *given["behaviors"]])
        return esair.Robot(**{"socket": True, **given, **extra})

    return make


def _place(words: list[str], components: list[Any]) -> None:
    """Let components live where the words say."""
    named = {each.name: each for each in components}
    for word in words:
        name, _, where = word.partition("=")
        if where not in {"process", "task"}:
            told = f"expected NAME=process or NAME=task, not {word!r:.80}"
            raise esair.ConfigError("--placement", "", told)
        if name not in named:
            raise esair.UnknownNameError("component", name, named)
        named[name].placement = where


def _page(known: Any, words: list[str], insecure: Any) -> esair.Page:
    host, _, port = (words or [""])[0].rpartition(":")
    if port and not port.isdecimal():
        raise esair.ConfigError("--page", "", f"expected HOST:PORT, not {words[0]!r}")
    changes: dict[str, Any] = {"insecure": True} if insecure else {}
    if host:
        changes["host"] = host.removeprefix("[").removesuffix("]")
    if port:
        changes["port"] = int(port)
    return attrs.evolve(known or esair.Page(), **changes)


def _headline(described: config.Description) -> Text:
    text = Text(described.name, "bold")
    text.append(" (simulated)" if described.simulated else "", "cyan")
    text.append(
        f": {counted(len(described.resources), 'device')}, "
        f"{counted(len(described.behaviors), 'behavior')}; Ctrl-C stops it",
        "not bold",
    )
    return text


def _not_started(*errors: Exception) -> int:
    for error in errors:
        tell("\n".join(told(error)))
    lacks = any(isinstance(error.__cause__, ImportError) for error in errors)
    return CANNOT_USE if lacks else NOT_DONE
