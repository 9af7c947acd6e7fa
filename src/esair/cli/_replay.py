"""``esair replay``: a recording repeated by the robot's own code, and compared."""

from __future__ import annotations

import logging
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

from cyclopts import Parameter
from rich.console import Console
from rich.text import Text

from esair import config
from esair.cli._errors import CANNOT_USE, missing_extra, tell
from esair.exceptions import EsairError, describe

if TYPE_CHECKING:
    from esair.recording import Recorded
    from esair.replay import Divergence, Outcome, Replay

DIVERGED: Final = 3
"""The exit code if the robot does otherwise than it did."""

WIDTH: Final = 120
"""How much of a value is shown."""


def replay(
    file: Path,
    /,
    *,
    with_: Annotated[Path | None, Parameter(name="--with")] = None,
    check: Annotated[bool, Parameter(negative=())] = False,
    verbose: Annotated[bool, Parameter(name=["--verbose", "-v"], negative=())] = False,
) -> int:
    """Repeat a recorded run with the robot's code of today, and compare.

    No driver is called: what the devices have given comes from the recording. It ends
    at the first difference, which is shown with what was decided on. The exit code
    is 0 if all is equal, 3 if something differs.

    Args:
        file: The recording of 'esair run' or 'esair sim'.
        with_: The robot.toml; that of the recorded run unless given.
        check: Run nothing: name what in the robot's code cannot be repeated. The exit
            code is 3 if there is such a thing.
        verbose: Show the log of the replay.
    """
    if not file.exists():
        tell(f"{file}: there is no such file")
        return CANNOT_USE
    try:
        from esair.replay import Replay

        recorded = Replay(file)
        console = Console(highlight=False, soft_wrap=True)
        if not verbose:
            logging.disable(logging.CRITICAL)
        if with_ is None and not check:
            outcome = recorded.run_script()
            if outcome is not None:
                return show(outcome, console)
        robot_file = with_ or recorded.file
        if robot_file is None:
            tell(
                f"{file}: the robot was made by a program: name a robot.toml that makes "
                "the same one, --with robot.toml"
            )
            return CANNOT_USE
        sys.path.insert(0, str(robot_file.resolve().parent))
        described = config.load(robot_file, simulated=recorded.is_simulated)
        if check:
            return _check(described)
        robot = config.build(described)
        for line in _changes(recorded, robot_file, described):
            console.print(line, style="yellow")
        outcome = recorded.run(robot)
    except ModuleNotFoundError as error:
        code = missing_extra(error, "record")
        if code is None:
            raise
        return code
    except (EsairError, OSError) as error:
        if isinstance(error, config.ConfigFileError):
            raise
        tell(describe(error))
        return CANNOT_USE
    return show(outcome, console)


def _check(described: config.Description) -> int:
    from esair.replay import unrepeatable

    found = unrepeatable(described.behaviors.values())
    for each in found:
        print(each)  # noqa: T201 - this is the command line
    if not found:
        print("nothing was found that could not be repeated")  # noqa: T201 - as above
    return DIVERGED if found else 0


def _changes(
    recorded: Replay, robot_file: Path, described: config.Description
) -> list[str]:
    """Say what is not as it was recorded: a difference may come from there."""
    from esair.recording import facts_about

    lines: list[str] = []
    text = robot_file.read_text(encoding="utf-8")
    if text != recorded.facts["robot"].get("robot.toml", text):
        lines.append(f"{robot_file.name} is not as it was when the run was recorded")
    components = [*described.resources.values(), *described.behaviors.values()]
    code = dict(facts_about("", components))["code"]
    before = recorded.facts.get("code", {})
    changed = sorted(name for name in code if before.get(name, "") != code[name])
    if changed:
        lines.append(f"changed since it was recorded: {', '.join(changed)}")
    return lines


def show(outcome: Outcome, console: Console) -> int:
    """Show what came of a replay; return the exit code."""
    if outcome.divergence is not None:
        _show_divergence(outcome.divergence, outcome, console)
        return DIVERGED
    speed = outcome.seconds / outcome.took if outcome.took > 0 else 0.0
    console.print(
        f"equal: {outcome.equal} events in {outcome.turns} turns; "
        f"{outcome.seconds:.1f} s were repeated in {outcome.took:.1f} s "
        f"({speed:.0f} times as fast)"
    )
    if outcome.short:
        console.print(f"it was compared up to there: {outcome.short}", style="yellow")
    return 0


def _show_divergence(found: Divergence, outcome: Outcome, console: Console) -> None:
    text = Text()
    text.append(f"{found.component} does otherwise", "bold red")
    text.append(
        f" at {found.seconds:.3f} s (turn {found.turn}), after {outcome.equal} events "
        "that were equal"
    )
    console.print(text)
    console.print(f"  recorded  {_words(found.expected, found)}")
    console.print(f"  now       {_words(found.actual, found)}")
    if found.readings:
        console.print(f"  {found.component} had these readings:")
    for seen in found.readings:
        age = _moment(found) - seen.time
        console.print(
            f"    {seen.sensor}, {1000 * age:.0f} ms old: {_value(seen.value)}"
        )


def _moment(found: Divergence) -> float:
    return min(each.time for each in (found.expected, found.actual) if each is not None)


def _words(event: Recorded | None, found: Divergence) -> str:
    if event is None:
        return "nothing"
    where = f"{event.component} <- {event.peer}" if event.peer else event.component
    later = event.time - _moment(found)
    words = f"{event.kind} {where}: {_value(event.value)}"
    if event.value is None:
        words = f"{event.kind} {where} {event.text}".rstrip()
    return f"{words} ({1000 * later:.1f} ms later)" if later > 0 else words


def _value(value: Any) -> str:
    text = str(value)
    return text if len(text) <= WIDTH else f"{text[:WIDTH]}..."
