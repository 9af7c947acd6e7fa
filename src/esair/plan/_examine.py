"""The rulebook itself: which rules are asked, of what, and in which order."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import Any

from esair.actions import Behavior, Derived, Reaction
from esair.exceptions import ConfigError
from esair.messages import is_placed
from esair.plan._actions import mistakes_in_action, mistyped
from esair.plan._buses import claimed_twice, odd_buses, overloaded
from esair.plan._derived import underivable
from esair.plan._finding import Finding, because, mistake
from esair.plan._modes import mistakes_in_modes
from esair.plan._names import in_use, taken, taken_by_another, used_already, wrong_kind
from esair.plan._needs import unmet, untimely
from esair.plan._placement import unplaceable
from esair.plan._plan import Plan
from esair.plan._protection import unprotected
from esair.plan._resources import mistakes_in_resource
from esair.plan._rights import denied, mistakes_in_policies
from esair.plan._together import never_failed, starving, unused
from esair.resources import Resource


def examine(plan: Plan) -> list[Finding]:
    """Find everything that is wrong, or odd, with a robot before it starts.

    Nothing is opened, and nothing of the robot is changed.

    Returns:
        What was found: resources, behaviors, policies, in this order, and then what
        only the whole shows.
    """
    return [
        *_names(plan),
        *_about_resources(plan, plan.resources),
        *_about_actions(plan, plan.behaviors),
        *mistakes_in_policies(plan),
        *mistakes_in_modes(plan),
        *starving(plan),
        *never_failed(plan),
        *unprotected(plan),
        *unused(plan),
        *odd_buses(plan),
        *overloaded(plan),
    ]


def examine_resource(
    plan: Plan, resource: Any, *, instead_of: Resource | None = None
) -> list[Finding]:
    """Find what is wrong with a resource that comes into a running robot.

    Args:
        plan: The robot, which does not have it yet.
        resource: What comes.
        instead_of: A resource that gives its place; it may take it again.
    """
    if in_use(resource) and resource is not instead_of:
        return [used_already(resource)]
    with plan.as_if(resource, instead_of):
        return [
            *taken_by_another("resource", resource, plan.resource_of),
            *_about_resources(plan, [resource], instead_of),
        ]


def examine_action(
    plan: Plan, action: Any, *, instead_of: Behavior | Reaction | None = None
) -> list[Finding]:
    """Find what is wrong with a behavior or reaction that comes into a running robot.

    Args:
        plan: The robot, which does not have it yet.
        action: What comes.
        instead_of: An action that gives its place.
    """
    if instead_of is not None and action is instead_of:
        told = "it cannot take its own place"
        return [because("name", action, ConfigError(instead_of.name, "", told))]
    if in_use(action):
        return [used_already(action)]
    there = plan.action_of if instead_of is None else {}
    return [
        *taken_by_another("behavior", action, there),
        *_about_actions(plan, [action]),
    ]


def examine_step(plan: Plan, action: Any, *, performer: str) -> list[Finding]:
    """Find what is wrong with what a behavior is about to perform.

    Args:
        plan: The robot.
        action: The reaction or behavior that is performed.
        performer: The name of the behavior, in whose name it is registered.
    """
    found = list(_about_action(plan, action, user=performer))
    if in_use(action):
        found.append(used_already(action))
    if isinstance(action, Behavior) and action.takes:
        told = "it takes requests: a step has no name of its own to be asked by"
        found.append(mistake("declaration", action, "", told))
    if is_placed(action):
        told = "a step runs where its performer runs, in no process of its own"
        advice = "give it placement 'task', or add it to the robot and ask it"
        found.append(mistake("placement", action, "placement", told, advice))
    return found


def _names(plan: Plan) -> Iterator[Finding]:
    def missing(*kinds: str) -> set[str]:
        return {name for name, kind in plan.missing.items() if kind in kinds}

    unmade = missing("sensor", "actuator")
    yield from taken("resource", plan.resources, plan.resources, unmade)
    yield from taken("behavior", plan.behaviors, plan.behaviors, missing("behavior"))


def _about_resources(
    plan: Plan, about: Collection[Any], instead_of: Resource | None = None
) -> Iterator[Finding]:
    sound = []
    for resource in about:
        strange = wrong_kind(resource, resource=True)
        if strange is not None:
            yield strange
            continue
        found = list(mistakes_in_resource(resource))
        if isinstance(resource, Derived) and not found:
            found += underivable(plan, resource)
        found += unplaceable(resource)
        if in_use(resource) and resource is not instead_of:
            found.insert(0, used_already(resource))
        yield from found
        if not any(finding.is_error for finding in found):
            sound.append(resource)
    if len(sound) == len(about):
        yield from claimed_twice(sound, plan.claims)


def _about_actions(plan: Plan, about: Collection[Any]) -> Iterator[Finding]:
    for action in about:
        yield from _about_action(plan, action)
        if in_use(action):
            yield used_already(action)


def _about_action(
    plan: Plan, action: Any, *, user: str | None = None
) -> Iterator[Finding]:
    strange = wrong_kind(action, resource=False)
    if strange is not None:
        yield strange
        return
    found = [*mistakes_in_action(action), *unplaceable(action)]
    yield from found
    if any(finding.is_error for finding in found):
        return
    if isinstance(action, Reaction):
        yield from mistyped(action)
    for attribute, need in action.needs.items():
        missing = unmet(plan, action, attribute, need)
        if missing is not None:
            yield missing
        else:
            yield from untimely(plan, action, attribute, need)
        if need.provider in plan.resource_names:
            yield from denied(plan, action, need, user=user or action.name)
