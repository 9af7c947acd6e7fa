"""A robot from a file, run until it ends: what ``esair run`` and ``sim`` share."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import attrs
from rich.console import Console
from rich.text import Text

import esair
from esair import config
from esair.cli._errors import CANNOT_USE, tell
from esair.cli._log import shown_log
from esair.exceptions import BehaviorFailedError, EsairError, describe

ENDED_WITH_AN_ERROR: Final = 1
"""The exit code of a robot that did not start, or whose behavior has failed."""


def drive(
    file: Path,
    *,
    simulated: bool,
    seconds: float | None,
    verbose: bool,
    record: list[Path] | None = None,
    page: list[str] | None = None,
    insecure: bool = False,
    loop_factory: Callable[[], asyncio.AbstractEventLoop] | None = None,
) -> int:
    """Run the robot of a file until it ends, or until a signal."""
    if seconds is not None and not 0 < seconds < float("inf"):
        tell(f"--for: expected seconds > 0, not {seconds:g}")
        return CANNOT_USE
    console = Console(stderr=True, highlight=False)
    sys.path.insert(0, str(file.resolve().parent))  # modules imported while it runs
    described = config.load(file, simulated=simulated)
    try:
        robot = config.build(described, _with(described, record, page, insecure))
    except EsairError as error:
        return _not_started([error])
    console.print(_headline(described))
    try:
        with shown_log(verbose=verbose):
            esair.run(robot, duration=seconds, loop_factory=loop_factory)
    except BehaviorFailedError as error:
        tell(describe(error))
        return ENDED_WITH_AN_ERROR
    except EsairError as error:
        return _not_started([error])
    except ExceptionGroup as group:
        errors, rest = group.split(EsairError)
        if errors is None or rest is not None:
            raise
        return _not_started(errors.exceptions)
    # What each actuator was told at the end is in the log.
    return 0 if all(told.answered for told in robot.stopped) else ENDED_WITH_AN_ERROR


def _with(
    described: config.Description,
    record: list[Path] | None,
    page: list[str] | None,
    insecure: bool,
) -> Callable[..., esair.Robot]:
    """Return what makes the robot: with a control socket, and recorded if wanted."""
    extra: dict[str, Any] = {}
    if record is not None:
        (path,) = record or [Path()]
        known = described.robot.get("record") or esair.Recording(path)
        extra["record"] = attrs.evolve(known, path=path)
    if page is not None:
        extra["page"] = _page(described.robot.get("page"), page, insecure)
    return lambda **given: esair.Robot(**{"socket": True, **given, **extra})


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
    def count(number: int, word: str) -> str:
        return f"{number} {word}" if number == 1 else f"{number} {word}s"

    text = Text(described.name, "bold")
    text.append(" (simulated)" if described.simulated else "", "cyan")
    text.append(
        f": {count(len(described.resources), 'device')}, "
        f"{count(len(described.behaviors), 'behavior')}; Ctrl-C stops it",
        "not bold",
    )
    return text


def _not_started(errors: tuple[Exception, ...] | list[EsairError]) -> int:
    for error in errors:
        tell(describe(error))
    return ENDED_WITH_AN_ERROR
