"""How each actuator is made safe: who moves it, who guards it, and who stops it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import attrs

from esair.actions import Behavior, Guards, Reaction, Writes
from esair.plan._plan import Finding, Plan, warning
from esair.resources import Actuator, Resource
from esair.values import is_positive

_IN_DEVICE = "its device decides"  # What is said of a guard that is not of this robot

UNWATCHED = "UNWATCHED"
"""What is said of an actuator that no watchdog makes safe."""

KEEPS_ON = "it keeps its last command"
"""What is said of one that nothing makes safe when the computer dies."""

_MUTE_LIMIT = Reaction.mute_limit
"""What a class has that says nothing about it, in seconds."""


_LONG = 30.0
"""What moves on for longer than this without a write has milliseconds for seconds, maybe."""


@attrs.frozen
class Writer:
    """Who writes an actuator.

    Attributes:
        behavior: The name of the behavior or reaction.
        kind: ``"behavior"`` or ``"reaction"``.
        priority: With which priority it writes.
        when_blind: What happens while it cannot decide.
    """

    behavior: str
    kind: str
    priority: int
    when_blind: str


@attrs.frozen
class Guard:
    """Who guards an actuator: every command passes it.

    Attributes:
        reaction: The name of the reaction.
        priority: Which guard is asked first; higher is earlier.
        when_blind: What happens while it cannot see.
        latch: Whether nothing passes any more, once it has refused, until a reset.
    """

    reaction: str
    priority: int
    when_blind: str
    latch: bool


@attrs.frozen
class Protection:
    """How one actuator is made safe.

    Attributes:
        name: The actuator.
        driver: Its class, as ``module:Class``.
        safe: Its safe command, in Python's words; None if it has none.
        command_timeout: After how many seconds without a command it is sent; None if
            it does not say so as it must.
        writers: Who moves it, highest priority first.
        guards: Who guards it, in the order in which they are asked.
        sent_by: Who sends the safe command, and when.
        own_timeout: After how many seconds the device stops by itself when it
            hears nothing more; None if it does not.
        when_the_process_dies: Whether the watchdog process makes it safe then, or why
            it is UNWATCHED.
        when_the_host_dies: What it does when this computer is gone.
    """

    name: str
    driver: str
    safe: str | None
    command_timeout: float | None
    writers: tuple[Writer, ...]
    guards: tuple[Guard, ...]
    sent_by: str
    own_timeout: float | None
    when_the_process_dies: str
    when_the_host_dies: str


def protection(plan: Plan) -> list[Protection]:
    """Return how each actuator of a robot is made safe, in the robot's order."""
    return [
        _of(plan, name, resource)
        for name, resource in plan.resource_of.items()
        if isinstance(resource, Actuator)
    ]


def _of(plan: Plan, name: str, actuator: Actuator[object]) -> Protection:
    timeout, own = actuator.command_timeout, actuator.own_timeout
    good = is_positive(timeout)
    after = f"{timeout:g} s after the last command, and " if good else ""
    writers = sorted(_writers(plan, name), key=lambda w: (-w.priority, w.behavior))
    guards = sorted(_guards(plan, name), key=lambda g: (-g.priority, g.reaction))
    others = (Guard(o, 0, _IN_DEVICE, latch=False) for o in actuator.own_guards)
    return Protection(
        name=name,
        driver=f"{_public(type(actuator).__module__)}:{type(actuator).__qualname__}",
        safe=repr(actuator.safe) if hasattr(actuator, "safe") else None,
        command_timeout=float(timeout) if good else None,
        writers=tuple(writers),
        guards=(*guards, *others),
        sent_by=f"esair: {after}at every exit",
        own_timeout=own,
        when_the_process_dies=when_dead(actuator, _unwatched(plan, actuator)),
        when_the_host_dies=when_alone(actuator),
    )


def when_alone(actuator: Actuator[Any]) -> str:
    """Say what a device does that hears nothing more from anybody."""
    own = actuator.own_timeout
    if is_positive(own):
        return f"it stops itself after {own:g} s"
    if actuator.last_will is not None:
        return f"its last will is published after {actuator.last_will:g} s"
    return KEEPS_ON


def when_dead(actuator: Actuator[Any], unwatched: str) -> str:
    """Say who makes an actuator safe when this process dies, or why no watchdog does."""
    if unwatched and actuator.last_will is not None:
        return "its last will is published at once"
    return unwatched or "the watchdog sends its safe command"


def _unwatched(plan: Plan, actuator: Actuator[Any]) -> str:
    """Say why no watchdog makes an actuator safe; empty if one does."""
    if not plan.watchdog:
        return f"{UNWATCHED}: the robot has no watchdog"
    if type(actuator).safe_frames is Actuator.safe_frames:
        return f"{UNWATCHED}: its driver cannot say its safe command as bytes"
    return ""


def _writers(plan: Plan, resource: str) -> Iterator[Writer]:
    for name, need in plan.writes_of(resource).items():
        action = plan.action_of[name]
        holds = action.holds_when_blind(need)
        kind = "reaction" if isinstance(action, Reaction) else "behavior"
        told = "the actuator is kept safe" if holds else "it has no say"
        yield Writer(name, kind, need.priority, told)


def _guards(plan: Plan, resource: str) -> Iterator[Guard]:
    for name, action, _, need in plan.needs_of.get(resource, {}).values():
        if not (isinstance(need, Guards) and isinstance(action, Reaction)):
            continue
        if type(need.priority) is int:
            decides = type(action).blind is not Reaction.blind
            told = "its blind() decides" if decides else "nothing passes"
            yield Guard(name, need.priority, told, need.latch)


def unprotected(plan: Plan) -> Iterator[Finding]:
    """Find what moves without protection, and protection that is not what it seems."""
    rows = {row.name: row for row in protection(plan)}
    for name, row in rows.items():
        yield from _bare(plan, name, row)
        yield from _goes_on(plan, name)
        yield from _level(plan, name, row)
    for name, action, attribute, need in plan.needs():
        if (
            isinstance(need, Guards)
            and isinstance(action, Reaction)
            and need.latch is True
        ):
            told = (
                f"once it has refused a command for {need.resource!r}, nothing passes "
                f"until robot.behaviors.reset({name!r})"
            )
            field, advice = (
                f"{attribute}.latch",
                "see that somebody is there to call it",
            )
            yield warning("protect", action, field, told, advice)
    yield from _mutable(plan)
    yield from _half_guarded(plan, rows)


def _bare(plan: Plan, name: str, row: Protection) -> Iterator[Finding]:
    if "behavior" in plan.missing.values():
        return  # what could not be made may be what protects it
    actuator = plan.resource_of[name]
    if not _moves(actuator):
        return
    for mode in plan.modes.table or (None,):
        writers = [w for w in row.writers if plan.modes.runs(w.behavior, mode)]
        behaviors = [each.priority for each in writers if each.kind == "behavior"]
        guarded = any(plan.modes.runs(each.reaction, mode) for each in row.guards)
        above = any(
            each.kind == "reaction" and each.priority > max(behaviors, default=0)
            for each in writers
        )
        if not behaviors or guarded or above:
            continue
        told = (
            "it moves, and nothing protects it: it has no guard, and no reaction above "
            "its behaviors"
        ) + (f" in mode {mode!r}" if mode else "")
        advice = f"write a reaction with esair.guards(..., name={name!r})"
        yield warning("protect", actuator, "", told, advice)


def _moves(actuator: Resource) -> bool:
    """Tell whether an actuator moves: it says so, or has a time-out of its own."""
    says: bool | None = getattr(actuator, "moves", None)
    if says is not None:
        return says
    classes = type(actuator).__mro__
    own = classes[: classes.index(Actuator)]
    return "command_timeout" in vars(actuator) or any(
        "command_timeout" in vars(each) for each in own
    )


def _goes_on(plan: Plan, name: str) -> Iterator[Finding]:
    """Find what moves for long after its last write."""
    actuator = plan.resource_of[name]
    if not isinstance(actuator, Actuator) or not _moves(actuator):
        return
    found: list[tuple[Any, str, Any]]
    found = [(actuator, "command_timeout", actuator.command_timeout)]
    found += [
        (action, f"{attribute}.hold", need.hold)
        for _, action, attribute, need in plan.needs_of.get(name, {}).values()
        if isinstance(need, Writes)
    ]
    for whose, field, seconds in found:
        if is_positive(seconds) and seconds > _LONG:
            told = f"{name!r} moves on for {seconds:g} s after the last write"
            advice = (
                "it is in seconds: 0.5 for 500 ms (moves = False if it hurts nobody)"
            )
            yield warning("time", whose, field, told, advice)


def _level(plan: Plan, name: str, row: Protection) -> Iterator[Finding]:
    """Find blind holds at the priority of those that they are against."""
    writes = plan.writes_of(name)
    for holder, need in writes.items():
        action = plan.action_of[holder]
        if not isinstance(action, Reaction) or not action.holds_when_blind(need):
            continue
        equal = [
            each.behavior
            for each in row.writers
            if each.behavior != holder
            and each.priority == need.priority
            and plan.modes.meet(each.behavior, holder)
        ]
        if equal:
            told = (
                f"while it is blind it keeps {name!r} safe against {_and(equal)}, but "
                f"while it sees they have the same priority ({need.priority})"
            )
            yield warning("protect", action, need.attribute, told, "raise its priority")


def _mutable(plan: Plan) -> Iterator[Finding]:
    for action in plan.action_of.values():
        if not isinstance(action, Reaction) or action.mute_limit == _MUTE_LIMIT:
            continue
        protects = any(action.holds_when_blind(need) for need in action.needs.values())
        if protects and is_positive(action.mute_limit):
            told = f"the user may mute what it protects for {action.mute_limit:g} s"
            yield warning("protect", action, "mute_limit", told, "0 if never")


def _half_guarded(plan: Plan, rows: dict[str, Protection]) -> Iterator[Finding]:
    """Find commands of several parts of which only some are guarded."""
    for action in plan.action_of.values():
        parts = [
            need.resource
            for need in action.needs.values()
            if isinstance(need, Writes) and need.resource in rows
        ]
        if isinstance(action, Behavior) or len(parts) < 2:
            continue
        guarded = [each for each in parts if rows[each].guards]
        bare = [each for each in parts if not rows[each].guards]
        if guarded and bare:
            told = (
                f"it commands {_and(parts)} together, but only {_and(guarded)} "
                f"{'is' if len(guarded) == 1 else 'are'} guarded"
            )
            yield warning("protect", action, "", told, f"guard {_and(bare)} too")


def _and(names: list[str]) -> str:
    shown = [repr(name) for name in names]
    return shown[0] if len(shown) == 1 else f"{', '.join(shown[:-1])} and {shown[-1]}"


def _public(module: str) -> str:
    """Return the module that people import: that of ``esair.drivers.dbc._actuator``."""
    return module.partition("._")[0]
