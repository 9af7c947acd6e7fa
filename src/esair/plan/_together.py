"""How the actions of a robot get on with each other, and what nobody uses."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

from esair.actions import Behavior
from esair.messages import Restart
from esair.plan._finding import Finding, mistake, warning
from esair.plan._plan import Plan
from esair.resources import Actuator


def starving(plan: Plan) -> Iterator[Finding]:
    """Find actions that keep each other from an actuator."""
    for resource in plan.resource_names:
        writers = plan.writes_of(resource)
        for (one, low), (other, high) in itertools.combinations(
            sorted(writers.items(), key=lambda item: item[1].priority), 2
        ):
            action = plan.action_of[other]
            if not plan.modes.meet(one, other):
                continue
            if low.priority == high.priority and (
                plan.action_of[one].holds_when_blind(low)
                or action.holds_when_blind(high)
            ):
                continue  # that is told of the one that keeps the other out
            if low.priority == high.priority:
                told = (
                    f"{one!r} and {other!r} write {resource!r} with the same priority "
                    f"({low.priority}): whoever holds it keeps the other out"
                )
                yield warning(
                    "starve", action, high.attribute, told, "raise one of them"
                )
            elif isinstance(action, Behavior):
                told = (
                    f"{other!r} is no reaction, so it may write {resource!r} without "
                    f"pause, and its priority {high.priority} is above that of {one!r} "
                    f"({low.priority})"
                )
                advice = f"see that it releases {resource!r}, or lower its priority"
                yield warning("starve", action, high.attribute, told, advice)


def failures(plan: Plan) -> dict[str, str]:
    """Say of each behavior and reaction what happens when it fails again and again."""
    return {name: _failure(plan, name) for name in plan.action_of}


def _failure(plan: Plan, name: str) -> str:
    action, modes = plan.action_of[name], plan.modes
    policy = action.restart
    if not isinstance(policy, Restart):
        return "its restart is none"  # that is told as a mistake
    times = f"{policy.max} restart{'s' * (policy.max != 1)} in {policy.within:g} s"
    if policy.retry is not None:
        return f"{times}, then again every {policy.retry:g} s, for ever"
    if action.essential:
        return f"{times}, then the robot ends with an exit code"
    next_ones = {
        f"mode {modes.table[mode].on_failure} follows {mode}"
        for mode in modes.of_behavior(name)
        if modes.table[mode].on_failure
    }
    then = ", ".join(sorted(next_ones)) or "the others go on without it"
    return f"{times}, then it is FAILED: {then}"


def never_failed(plan: Plan) -> Iterator[Finding]:
    """Find what ends the robot when it is FAILED, and is tried for ever instead."""
    for action in plan.action_of.values():
        policy = action.restart
        if action.essential and isinstance(policy, Restart) and policy.retry:
            told = "it is essential, and never FAILED, for restart.retry tries for ever"
            yield mistake("declaration", action, "essential", told, "leave one out")


def unused(plan: Plan) -> Iterator[Finding]:
    """Find resources that no action declares to use."""
    if "behavior" in plan.missing.values():
        return
    used = {need.provider for _, _, _, need in plan.needs()}
    for derived in plan.derived_of.values():
        used |= {need.provider for need in derived.inputs.values()}
    for name, resource in plan.resource_of.items():
        if name not in used and name not in plan.implied:
            doing = "writes" if isinstance(resource, Actuator) else "reads"
            yield warning(
                "unused", resource, "", f"no behavior declares that it {doing} it"
            )
