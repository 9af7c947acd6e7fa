"""``esair run`` and ``esair sim``: the robot of a file, real or simulated."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import attrs

import esair
from esair import config
from esair.cli._errors import CANNOT_USE, NOT_DONE, counted, say, tell, wrong_seconds
from esair.cli._log import shown_log
from esair.cli._options import Running
from esair.exceptions import EsairError
from esair.loop import check_priority
from esair.standard import leaves, told
from esair.values import printable

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
    wrong = wrong_seconds(options.seconds)
    described = config.load(file, simulated=simulated)
    sys.path.insert(0, str(file.resolve().parent))  # modules imported while it runs
    extra, mistakes = _extra(described, options)
    mistakes += _place(options.placement or [], described)
    for mistake in mistakes:
        tell(printable(str(mistake)))
    if wrong or mistakes:
        return CANNOT_USE
    robot = config.build(
        described, lambda **given: esair.Robot(**{"socket": True, **given, **extra})
    )
    say(_headline(described))
    try:
        with shown_log(verbose=options.verbose, tracebacks=options.traceback):
            esair.run(robot, duration=options.seconds, loop_factory=loop_factory)
    except (EsairError, ExceptionGroup) as error:
        errors = list(leaves(error))
        strange = not all(isinstance(each, EsairError) for each in errors)
        if strange or options.traceback:
            raise
        return _not_started(errors)
    # What each actuator was told at the end is in the log.
    return 0 if all(told.answered for told in robot.stopped) else NOT_DONE


def _extra(
    described: config.Description, how: Running
) -> tuple[dict[str, Any], list[EsairError]]:
    """Return the keywords of the robot that options give, and what is wrong with them."""
    extra: dict[str, Any] = {}
    mistakes: list[EsairError] = []
    if how.record is not None:
        (path,) = how.record or [Path()]
        known = described.robot.get("record") or esair.Recording(path)
        extra["record"] = attrs.evolve(known, path=path)
    if how.page is not None:
        try:
            known = described.robot.get("page")
            extra["page"] = _page(known, how.page, how.insecure)
        except esair.ConfigError as error:
            mistakes.append(error)
    if how.realtime is not None:
        extra["realtime"] = priority = how.realtime[0] if how.realtime else True
        try:
            check_priority("command line", priority)
        except esair.ConfigError as error:
            mistakes.append(error)
    return extra, mistakes


def _place(words: list[str], described: config.Description) -> list[EsairError]:
    """Let components live where the words say; return what is wrong with the words."""
    mistakes: list[EsairError] = []
    named: dict[str, Any] = {**described.resources, **described.behaviors}
    for word in words:
        name, _, where = word.partition("=")
        if where not in {"process", "task"}:
            told = f"expected NAME=process or NAME=task, not {word!r:.80}"
            mistakes.append(esair.ConfigError("--placement", "", told))
        elif name not in named:
            mistakes.append(esair.UnknownNameError("component", name, named))
        else:
            named[name].placement = where
    return mistakes


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


def _headline(described: config.Description) -> str:
    devices = counted(len(described.resources), "device")
    behaviors = counted(len(described.behaviors), "behavior")
    simulated = " (simulated)" if described.simulated else ""
    return f"{described.name}{simulated}: {devices}, {behaviors}; Ctrl-C stops it"


def _not_started(errors: list[BaseException]) -> int:
    for error in errors:
        tell("\n".join(told(error)))
    lacks = any(isinstance(error.__cause__, ImportError) for error in errors)
    return CANNOT_USE if lacks else NOT_DONE
