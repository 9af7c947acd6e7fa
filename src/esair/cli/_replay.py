"""``esair replay``: a recording repeated by the robot's own code, and compared."""

from __future__ import annotations

import logging
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

from cyclopts import Parameter
from rich.console import Console
from rich.text import Text

import esair
from esair import config
from esair.cli._errors import CANNOT_USE, heeded, tell
from esair.cli._log_file import shown
from esair.cli._options import Verbose
from esair.values import printable

if TYPE_CHECKING:
    from esair.recording import Recorded
    from esair.replay import Divergence, Outcome, Replay

DIVERGED: Final = 3  # The exit code if the robot does otherwise than it did
WIDTH: Final = 120  # How much of a value is shown
ROBOT_FILE: Final = "robot.toml"
DEMO: Final = "demo"


def replay(
    file: Path,
    /,
    *,
    with_: Annotated[str | None, Parameter(name="--with")] = None,
    check: bool = False,
    verbose: Verbose = False,
) -> int:
    """Repeat a recorded run with the code of today, and compare.

    No driver is called: what the devices have given comes from the recording. It ends
    at the first difference, which is shown with what was decided on. The exit code
    is 0 if all is equal, 3 if something differs, 2 if nothing could be compared.

    Args:
        file: The recording of 'esair run' or 'esair sim'.
        with_: What the robot is made of: a robot.toml, module:robot, file.py:robot (or
            a function that returns it), or a program that runs it; 'demo' for that of
            'esair demo'. Unless given, the robot.toml of this folder, if it is the one
            of the recorded run: what a recording names is never run.
        check: Run nothing, and make nothing: read the source of the robot's code, and
            name what in it cannot be repeated. The exit code is 3 if there is such a
            thing.
        verbose: Show the log of the replay.
    """
    from esair.replay import Replay

    recorded = Replay(file)
    console = Console(highlight=False, soft_wrap=True)
    if not verbose:
        logging.disable(logging.CRITICAL)
    made_of = with_ or _own_file(recorded)
    if not made_of:
        return CANNOT_USE
    if check and made_of != DEMO:
        return _check(made_of)
    if made_of == DEMO:
        from esair.demo import repeat

        return show(repeat(recorded), console)
    robot = _robot_of(made_of, simulated=recorded.is_simulated)
    for line in _changes(recorded, robot):
        console.print(Text(printable(line), "yellow"))
    return show(recorded.run(robot), console)


def _own_file(recorded: Replay) -> str:
    """Return the robot.toml of this folder if it is that of the run; else say why."""
    place = Path(ROBOT_FILE)
    if recorded.script == DEMO:
        tell(f"{recorded.path}: 'esair demo' made it, say so: --with demo")
    elif not recorded.file:
        program = printable(recorded.program or "PROGRAM.py")
        told = f"a program made this robot, name it: --with {program:.200}"
        tell(f"{recorded.path}: {told}")
    elif not place.is_file() or config.digest_of(place) != recorded.digest:
        name = printable(recorded.file)
        told = f"no {ROBOT_FILE} in this folder is the one of the recorded run"
        tell(f"{recorded.path}: {told}, name yours: --with {name:.200}")
    else:
        return ROBOT_FILE
    return ""


def _robot_of(made_of: str, *, simulated: bool) -> esair.Robot:
    if config.is_of_module(made_of) or made_of.endswith(".py"):
        return config.robot_of(made_of)
    path = Path(made_of)
    described = config.load(path, simulated=simulated)
    sys.path.insert(0, str(path.resolve().parent))
    return config.build(described)


def _check(made_of: str) -> int:
    from esair.replay import unrepeatable

    found = unrepeatable(made_of)
    nothing = ["nothing was found that could not be repeated"]
    for line in [*map(str, found)] or nothing:
        print(printable(line))  # noqa: T201 - this is the command line
    return DIVERGED if found else 0


def _changes(recorded: Replay, robot: esair.Robot) -> list[str]:
    """Say what is not as it was recorded: a difference may come from there."""
    from esair.recording import facts_about
    from esair.standard import OWN

    lines: list[str] = []
    if recorded.script == OWN:
        lines.append("its program ran it, not esair.run: its own acts are not repeated")
    then = recorded.facts.get("versions", {}).get("esair", esair.__version__)
    if then != esair.__version__:
        lines.append(f"it was recorded with esair {then}; this is {esair.__version__}")
    file = None if robot.source is None else robot.source[0]
    if file is not None and config.digest_of(file) != recorded.digest:
        lines.append(f"{file.name} is not as it was when the run was recorded")
    components = [*robot.plan.resources, *robot.plan.behaviors]
    code = dict(facts_about("", components))["code"]
    known = recorded.facts.get("code", {})
    changed = sorted(
        name
        for name, now in code.items()
        # What was a part of the program then may be one of a module now.
        if now not in {known.get(name), known.get(f"__main__.{name.split('.')[-1]}")}
    )
    if changed:
        lines.append(f"changed since it was recorded: {', '.join(changed)}")
    return lines


def show(outcome: Outcome, console: Console) -> int:
    """Show what came of a replay; return the exit code."""
    if outcome.divergence is not None:
        with heeded(console):
            _show_divergence(outcome.divergence, outcome, console)
        return DIVERGED
    if not outcome.equal:
        tell(printable(f"nothing was compared: {outcome.short or 'nothing happened'}"))
        return CANNOT_USE
    speed = outcome.seconds / outcome.took if outcome.took > 0 else 0.0
    console.print(
        f"equal: {outcome.equal} events in {outcome.turns} turns; "
        f"{outcome.seconds:.1f} s were repeated in {outcome.took:.1f} s "
        f"({speed:.0f} times as fast)"
    )
    if outcome.short:
        told = printable(f"it was compared up to there: {outcome.short}")
        console.print(Text(told, "yellow"))
    return 0


def _show_divergence(found: Divergence, outcome: Outcome, console: Console) -> None:
    who = printable(f"{found.component} does otherwise"), "bold red"
    where = f" at {found.seconds:.3f} s (turn {found.turn})"
    equal = f", after {outcome.equal} events that were equal"
    console.print(Text.assemble(who, where, equal))
    lines = [
        f"  recorded  {_words(found.expected, found)}",
        f"  now       {_words(found.actual, found)}",
    ]
    if found.readings:
        lines.append(f"  {found.component} had these readings:")
    for seen in found.readings:
        age = _moment(found) - seen.time
        lines.append(
            f"    {seen.sensor}, {1000 * age:.0f} ms old: {shown(seen.value, WIDTH)}"
        )
    if outcome.late:
        told = "was waited for in vain: its code, or this computer, is slow"
        lines.append(f"  {outcome.late} {told}")
    for line in lines:
        console.print(Text(printable(line)))  # it may be a stranger's recording


def _moment(found: Divergence) -> float:
    return min(each.time for each in (found.expected, found.actual) if each is not None)


def _words(event: Recorded | None, found: Divergence) -> str:
    if event is None:
        return "nothing"
    where = f"{event.component} <- {event.peer}" if event.peer else event.component
    later = event.time - _moment(found)
    words = f"{event.kind} {where}: {shown(event.value, WIDTH)}"
    if event.value is None:
        words = f"{event.kind} {where} {event.text}".rstrip()
    return f"{words} ({1000 * later:.1f} ms later)" if later > 0 else words
