"""What ``esair check`` finds in a robot as a whole, beyond its single keys."""

from __future__ import annotations

import enum
import itertools
import re
from collections.abc import Iterator
from typing import Any, Final

import attrs

from esair.actions import Behavior, Need, Reaction, Reads, Writes
from esair.config._draft import Draft
from esair.config._words import unknown
from esair.exceptions import did_you_mean
from esair.messages import Access, Policy
from esair.resources import Actuator, Sensor
from esair.values import same_type, type_name

_RENUMBERED: Final = re.compile(r"/dev/tty(USB|ACM)\d+\Z")


class Severity(enum.Enum):
    """How bad a finding is."""

    ERROR = "error"
    """The robot does not start."""
    WARNING = "warning"
    """The robot starts, and may not do what was meant."""


@attrs.frozen
class Finding:
    """One thing that was found.

    Attributes:
        severity: How bad it is.
        rule: Which check found it, in one word.
        key: Where in the file, as a dotted path.
        message: What is wrong, and what to do.
    """

    severity: Severity
    rule: str
    key: str
    message: str


def examine(draft: Draft) -> list[Finding]:
    """Look at how the parts of a robot fit together."""
    everything = [
        (name, need)
        for name, action in draft.behaviors.items()
        if action is not None
        for need in action.needs.values()
    ]
    findings: list[Finding] = []
    for name, need in everything:
        findings += _provided(draft, name, need)
        findings += _allowed(draft, name, need)
        findings += _in_time(draft, name, need)
    findings += _exclusive(draft, everything)
    findings += _starving(draft, everything)
    findings += _rights(draft)
    findings += _unused(draft, everything)
    return findings


def _error(rule: str, key: str, message: str) -> Finding:
    return Finding(Severity.ERROR, rule, key, message)


def _warning(rule: str, key: str, message: str) -> Finding:
    return Finding(Severity.WARNING, rule, key, message)


def _provided(draft: Draft, name: str, need: Need) -> Iterator[Finding]:
    key = f"behavior.{name}"
    writes = isinstance(need, Writes)
    doing = "writes" if writes else "reads"
    known = draft.keys
    told = f"it {doing} {need.resource!r}"
    if need.resource not in known:
        yield _error(
            "need",
            key,
            f"{told}: {unknown('resource', need.resource, known)}",
        )
        return
    resource = draft.resources[need.resource]
    if resource is None:
        return  # its own mistakes are told already
    base: type = Actuator if writes else Sensor
    if not isinstance(resource, base):
        other = "a sensor" if writes else "an actuator"
        yield _error(
            "need",
            key,
            f"it {doing} {need.resource!r}, which is {other}: {known[need.resource]}",
        )
        return
    has: Any = resource.value_type
    fits = same_type(need.type, has) if writes else same_type(has, need.type)
    if not fits:
        yield _error(
            "need",
            key,
            f"it {doing} {type_name(need.type)}, but {need.resource!r} "
            f"{'takes' if writes else 'gives'} {type_name(has)}",
        )


def _right(policy: Policy, behavior: str) -> Access:
    return policy.allow.get(behavior, policy.allow.get("*", Access(0)))


def _level(policy: Policy, behavior: str) -> int | None:
    return policy.max_priority.get(behavior, policy.max_priority.get("*"))


def _allowed(draft: Draft, name: str, need: Need) -> Iterator[Finding]:
    policy = draft.policies.get(need.resource)
    if policy is None:
        return
    key = f"access.{need.resource}"
    denied = need.access & ~_right(policy, name)
    if denied:
        words = str(denied).lower().replace(" | ", ", ")
        yield _error(
            "denied",
            key,
            f"{name!r} needs {words}, and this table does not allow it: "
            f'add {name} = "{words}" to it',
        )
    level = _level(policy, name)
    if isinstance(need, Writes) and level is not None and need.priority > level:
        yield _error(
            "denied",
            f"{key}.max_priority",
            f"{name!r} writes with priority {need.priority}, but {level} is the most",
        )


def _in_time(draft: Draft, name: str, need: Need) -> Iterator[Finding]:
    """Find times that can never be met (both numbers are named)."""
    action = draft.behaviors[name]
    resource = draft.resources.get(need.resource)
    if not isinstance(action, Reaction):
        return
    rate = action.rate
    if isinstance(need, Writes) and isinstance(resource, Actuator) and rate:
        hold = resource.command_timeout if need.hold is None else need.hold
        longest = min(hold, resource.command_timeout)
        if 1 / rate >= longest:
            yield _warning(
                "time",
                f"behavior.{name}",
                f"it writes {need.resource!r} every {1 / rate:.3g} s, but a command is "
                f"good for {longest:.3g} s only: raise its rate or the command_timeout",
            )
    if isinstance(need, Reads) and isinstance(resource, Sensor) and not resource.pushes:
        period = 1 / resource.rate
        if need.max_age is not None and need.max_age < period:
            yield _error(
                "time",
                f"behavior.{name}",
                f"its readings of {need.resource!r} may be {need.max_age:.3g} s old at "
                f"most, but come every {period:.3g} s only: raise the rate or max_age",
            )


def _exclusive(draft: Draft, everything: list[tuple[str, Need]]) -> Iterator[Finding]:
    for resource, policy in draft.policies.items():
        writers = _writers(everything, resource)
        if policy.exclusive and len(writers) > 1:
            yield _error(
                "denied",
                f"access.{resource}.exclusive",
                f"only one may write {resource!r}, but {_and(list(writers))} want to",
            )


def _writers(everything: list[tuple[str, Need]], resource: str) -> dict[str, int]:
    found: dict[str, int] = {}
    for name, need in everything:
        if isinstance(need, Writes) and need.resource == resource:
            found[name] = max(need.priority, found.get(name, need.priority))
    return found


def _starving(draft: Draft, everything: list[tuple[str, Need]]) -> Iterator[Finding]:
    for resource in draft.keys:
        writers = _writers(everything, resource)
        for (one, low), (other, high) in itertools.combinations(
            sorted(writers.items(), key=lambda item: item[1]), 2
        ):
            if low == high:
                yield _warning(
                    "starve",
                    f"behavior.{other}",
                    f"{one!r} and {other!r} write {resource!r} with the same priority "
                    f"({low}): whoever holds it keeps the other out; raise one of them",
                )
            elif isinstance(draft.behaviors[other], Behavior):
                yield _warning(
                    "starve",
                    f"behavior.{other}",
                    f"{other!r} is no reaction, so it may write {resource!r} without "
                    f"pause, and its priority {high} is above that of {one!r} ({low}): "
                    f"see that it releases {resource!r}, or lower its priority",
                )


def _rights(draft: Draft) -> Iterator[Finding]:
    """Find rules for behaviors that are not there, and what nobody may do."""
    for resource, policy in draft.policies.items():
        key = f"access.{resource}"
        for name in dict.fromkeys((*policy.allow, *policy.max_priority)):
            if name == "*" or name in draft.behaviors:
                continue
            where = "" if name in policy.allow else "max_priority."
            # A name that is like no other may be that of a behavior added later; so
            # may one that is like another that the table names too.
            left = [each for each in draft.behaviors if each not in policy.allow]
            kind = _error if did_you_mean(name, left) else _warning
            yield kind(
                "rights",
                f"{key}.{where}{name}",
                "nobody here has this right: "
                + unknown("behavior", name, draft.behaviors),
            )
        asked = (
            Access.WRITE
            if draft.keys[resource].startswith("actuator.")
            else Access.READ
        )
        if not any(asked in _right(policy, name) for name in draft.behaviors):
            yield _warning("rights", key, f"nobody here may {asked.name} it".lower())


def _unused(draft: Draft, everything: list[tuple[str, Need]]) -> Iterator[Finding]:
    used = {need.resource for _, need in everything}
    for resource, key in draft.keys.items():
        if resource not in used and all(
            each is not None for each in draft.behaviors.values()
        ):
            doing = "writes" if key.startswith("actuator.") else "reads"
            yield _warning("unused", key, f"no behavior {doing} it")
    for name in draft.buses:
        if name not in draft.bus_of.values():
            yield _warning("unused", f"bus.{name}", "no device is on it")
    for name, table in draft.source.data.get("bus", {}).items():
        port = table.get("port")
        if isinstance(port, str) and _RENUMBERED.match(port):
            yield _warning(
                "port",
                f"bus.{name}.port",
                f"{port} may be another device after the next plugging: expected "
                "the path of the same device in /dev/serial/by-id",
            )


def _and(names: list[str]) -> str:
    shown = [repr(name) for name in names]
    return f"{', '.join(shown[:-1])} and {shown[-1]}"
