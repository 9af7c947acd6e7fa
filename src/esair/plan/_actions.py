"""What one behavior or reaction declares: is it sound, whatever the robot?"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from esair import abc
from esair.actions import (
    Behavior,
    Guards,
    Need,
    Reaction,
    Reads,
    Writes,
    declared_requests,
    is_request,
)
from esair.exceptions import ConfigError
from esair.messages import Restart
from esair.plan._finding import Finding, because, mistake
from esair.plan._signatures import wrong_blind, wrong_methods, wrong_react, wrong_types
from esair.values import check_name, is_positive

_FASTEST = 100_000.0  # The highest rate of a reaction, in Hz


def mistakes_in_action(action: Behavior | Reaction) -> Iterator[Finding]:
    """Find what is wrong with the class of an action, or with its values."""
    for field, told in _in_action(action):
        yield mistake("declaration", action, field, told)
    for error in mistakes_in_requests(action):
        yield because("declaration", action, error)


def mistyped(reaction: Reaction) -> Iterator[Finding]:
    """Find parameters of ``react`` whose annotations do not fit the ports."""
    for told in wrong_types(reaction):
        yield mistake("declaration", reaction, "react", told)


def _in_action(action: Behavior | Reaction) -> Iterator[tuple[str, str]]:
    yield from _in_needs(action)
    if isinstance(action, Reaction):
        yield from _in_reaction(action)
    else:
        yield from _in_boxes(action)
        yield from wrong_methods(action)
    if not isinstance(action.restart, Restart):
        yield "restart", "expected an esair.Restart"


def _in_needs(action: Behavior | Reaction) -> Iterator[tuple[str, str]]:
    for attribute, need in action.needs.items():
        yield from wrong_port(attribute, need)
        if isinstance(need, Guards) and isinstance(action, Behavior):
            yield attribute, "only a reaction guards: make one of it"
        if isinstance(need, Reads) and need.every and isinstance(action, Behavior):
            told = "only a reaction runs on every reading; here the newest wins"
            yield f"{attribute}.every", told
        if isinstance(need, Writes) and need.blind not in {None, "safe", "release"}:
            told = f"expected 'safe' or 'release', not {need.blind!r:.80}"
            yield f"{attribute}.blind", told
        if not isinstance(need, Reads) and type(need.priority) is not int:
            told = f"expected a whole number, not {need.priority!r:.80}"
            yield f"{attribute}.priority", told


def wrong_port(attribute: str, need: Need) -> Iterator[tuple[str, str]]:
    """Yield each field of a declared port that is wrong, and what was expected."""
    try:
        check_name("resource", need.provider)
    except ConfigError as error:
        yield attribute, str(error)
    if need.type is None or isinstance(need.type, str | bytes | int | float):
        yield (
            attribute,
            f"expected a type such as float, not {need.type!r:.80} "
            "(a name is given by name=)",
        )
    for field in ("max_age", "hold"):
        seconds = getattr(need, field, None)
        if seconds is not None and not is_positive(seconds):
            told = f"expected seconds > 0, not {seconds!r:.80}"
            yield f"{attribute}.{field}", told
    for field in ("configure", "every", "optional", "latch"):
        if type(flag := getattr(need, field, False)) is not bool:
            told = f"expected True or False, not {flag!r:.80}"
            yield f"{attribute}.{field}", told


def _in_reaction(reaction: Reaction) -> Iterator[tuple[str, str]]:
    rate, budget, limit = reaction.rate, reaction.budget, reaction.overrun_limit
    if rate is not None and not (is_positive(rate) and rate <= _FASTEST):
        yield "rate", f"expected Hz > 0, not {rate!r:.80}"
    if budget is not None and not is_positive(budget):
        yield "budget", f"expected seconds > 0, not {budget!r:.80}"
    if limit is not None and (type(limit) is not int or limit < 0):
        yield "overrun_limit", f"expected a whole number, not {limit!r:.80}"
    mute_limit = reaction.mute_limit
    if mute_limit != 0 and not is_positive(mute_limit):
        yield "mute_limit", f"expected seconds >= 0, not {mute_limit!r:.80}"
    guards = [key for key, need in reaction.needs.items() if isinstance(need, Guards)]
    if len(guards) > 1 or (guards and reaction.outputs):
        others = ", ".join([*guards[1:], *reaction.outputs])
        told = "a guard guards one actuator and writes none"
        yield guards[0], f"{told}: make {others} part of another reaction"
    if rate is None and not reaction.inputs and not guards:
        yield "rate", "it reads no sensor, so it needs a rate (Hz) to run at"
    for told in wrong_react(reaction):
        yield "react", told
    if guards and (wrong := wrong_blind(reaction, guards[0])):
        yield "blind", wrong


def _in_boxes(behavior: Behavior) -> Iterator[tuple[str, str]]:
    for field in ("inbox_size", "outbox_size"):
        value = getattr(behavior, field)
        if type(value) is not int or value < 1:
            yield field, f"expected a whole number > 0, not {value!r}"
    for field in ("inbox_policy", "outbox_policy"):
        value = getattr(behavior, field)
        if value not in {"reject", "drop_oldest", "latest"}:
            told = f"expected 'reject', 'drop_oldest' or 'latest', not {value!r}"
            yield field, told


def mistakes_in_requests(action: abc.Action) -> list[ConfigError]:
    """Return what is wrong with the requests that an action takes."""
    found: list[ConfigError] = []
    by_type: dict[Any, str] = {}
    for attribute, each in declared_requests(type(action)).items():
        if isinstance(action, Reaction):
            message = "only a behavior takes requests"
        elif isinstance(each, str):
            message = each
        elif not is_request(each.type):
            message = (
                f"expected a class derived from esair.Request, not {each.type!r:.80}"
            )
        elif type(each.queue) is not int or each.queue < 1:
            message = f"expected a queue of 1 or more, not {each.queue!r:.80}"
        elif type(each.newest) is not bool:
            message = f"expected newest=True or False, not {each.newest!r:.80}"
        elif each.type in by_type:
            message = f"{each.type.__name__} is taken by {by_type[each.type]!r} already"
        else:
            by_type[each.type] = attribute
            continue
        found.append(ConfigError(action.name, attribute, message))
    return found
