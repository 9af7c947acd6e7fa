"""Modes: are those there that they name, and does the robot come to each of them?"""

from __future__ import annotations

from collections.abc import Iterator

from esair.exceptions import UnknownNameError
from esair.messages import BehaviorsPolicy, Mode, Modes
from esair.plan._finding import Finding, mistake, warning
from esair.plan._plan import Plan
from esair.resources import Actuator


def mistakes_in_modes(plan: Plan) -> Iterator[Finding]:
    """Find names of nobody, and modes that the robot never comes to."""
    table, first = plan.modes.table, plan.modes.first
    if first is None and table:
        told = f"the mode that it begins in is missing: one of {', '.join(table)}"
        yield mistake("mode", None, "mode", told, of="robot")
    elif first is not None and first not in table:
        yield _unknown(None, "mode", "mode", first, table)
    for name, mode in table.items():
        yield from _names_in(plan, name, mode)
    yield from _never(plan)


def _names_in(plan: Plan, name: str, mode: Mode) -> Iterator[Finding]:
    about = f"mode.{name}"
    for each in dict.fromkeys(mode.behaviors):
        if each not in plan.action_names:
            yield _unknown(
                mode, "behaviors", "behavior", each, plan.action_names, about
            )
        elif list(mode.behaviors).count(each) > 1:
            told = f"{each!r} is named more than once"
            yield mistake("mode", mode, "behaviors", told, of=about)
    for field in ("then", "on_failure"):
        other = getattr(mode, field)
        if other == name:
            told = "it is the mode itself: expected another one"
            yield mistake("mode", mode, field, told, of=about)
        elif other is not None and other not in plan.modes.table:
            yield _unknown(mode, field, "mode", other, plan.modes.table, about)


def _never(plan: Plan) -> Iterator[Finding]:
    """Find modes that only people come to, and what only they move."""
    reached = reached_in(plan.modes)
    manages = any(isinstance(p, BehaviorsPolicy) and p.allow for p in plan.policies)
    if manages or len(reached) == len(plan.modes.table):
        return
    for name, mode in plan.modes.table.items():
        if name not in reached:
            told = "no then or on_failure leads there, and no behavior may switch"
            advice = "only people come to it: esair mode, robot.behaviors.switch"
            yield warning("mode", mode, "", told, advice, of=f"mode.{name}")
    for name, resource in plan.resource_of.items():
        writers = plan.writes_of(name) if isinstance(resource, Actuator) else ()
        runs = (plan.modes.runs(w, mode) for w in writers for mode in reached)
        if writers and not any(runs):
            told = "no mode that the robot comes to by itself moves it"
            yield warning("mode", resource, "", told)


def reached_in(modes: Modes) -> set[str]:
    """Return the modes that a robot comes to by ``then`` and ``on_failure``."""
    reached: set[str] = set()
    next_ones = [modes.first]
    while next_ones:
        name = next_ones.pop()
        if name is not None and name in modes.table and name not in reached:
            reached.add(name)
            next_ones += [modes.table[name].then, modes.table[name].on_failure]
    return reached


def _unknown(
    mode: Mode | None,
    field: str,
    kind: str,
    name: str,
    known: object,
    about: str = "robot",
) -> Finding:
    error = UnknownNameError(kind, name, known)  # type: ignore[arg-type]
    return mistake("mode", mode, field, str(error), of=about, cause=error)
