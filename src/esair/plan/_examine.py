"""The rulebook itself: which rules are asked, of what, and in which order.

And what only the whole robot shows: names, modes, what is shared, who starves, what nobody uses.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

from esair import minimal
from esair.abc import Component
from esair.actions import Behavior, Derived, Reaction
from esair.exceptions import ConfigError, EsairError, NameTakenError, UnknownNameError
from esair.messages import OPERATOR, BehaviorsPolicy, Mode, Modes, Restart, is_placed
from esair.plan._declarations import (
    idle,
    mistakes_in_action,
    mistakes_in_resource,
    mistyped,
    raising,
    unplaceable,
)
from esair.plan._needs import (
    denied,
    lasting,
    mistakes_in_policies,
    underivable,
    unmet,
    untimely,
)
from esair.plan._plan import Finding, Plan, because, mistake, name_of, warning
from esair.plan._protection import unprotected
from esair.resources import Actuator, Resource, Sensor
from esair.values import check_party

if TYPE_CHECKING:
    from esair.buses import Bus


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


def wrong_kind(component: object, *, resource: bool) -> Finding | None:
    """Find what is no resource, or no action, has no good name, or cannot be asked."""
    wanted: tuple[type, ...] = (Sensor, Actuator) if resource else (Behavior, Reaction)
    of_min = (minimal.Sensor, minimal.Actuator) if resource else (minimal.Reaction,)
    if not isinstance(component, wanted):
        names = " or ".join(f"esair.{each.__name__}" for each in wanted)
        told, of = f"expected an {names}", repr(component)
        if isinstance(component, type) and issubclass(component, (*wanted, *of_min)):
            of = component.__name__
            told = f"you gave the class: write {of}()"
        return mistake("declaration", component, "", told, of=of)
    assert isinstance(component, Component)
    try:
        name = component.name
        if name != component._name:  # noqa: SLF001 - its class has it as an attribute
            check_party(component._kind, name)  # noqa: SLF001 - its base class's
        if name == OPERATOR:
            told = "this is the name in which people act: choose another name="
            raise ConfigError(name, "name", told)
    except EsairError as error:
        return because("name", component, error)
    return raising(component)


def in_use(component: object) -> bool:
    """Tell whether a component is deployed, in this robot or in another one."""
    if isinstance(component, Resource):
        return component._listener is not None  # noqa: SLF001 - set by a supervisor
    if isinstance(component, Reaction):
        return getattr(vars(component).get("_step_clock"), "runs", False)
    return isinstance(component, Behavior) and "_host" in vars(component)


def used_already(component: Component) -> Finding:
    """Make the finding for a component that a running robot has."""
    told = "it is in a running robot already: make another one for this place"
    return because("name", component, ConfigError(component.name, "", told))


def taken(
    kind: str, about: Iterable[object], everybody: Sequence[object], missing: set[str]
) -> Iterator[Finding]:
    """Find the components whose name another one has."""
    owners: dict[str, object] = {}
    for each in everybody:
        if name := name_of(each):
            owners.setdefault(name, each)
    seen: set[int] = set()
    for component in about:
        name = name_of(component)
        if name is None:
            continue
        again = id(component) in seen
        seen.add(id(component))
        if again or name in missing or owners.get(name, component) is not component:
            yield because("name", component, NameTakenError(kind, name))


def taken_by_another(
    kind: str, component: object, there: Mapping[str, object]
) -> Iterator[Finding]:
    """Find out if the name of a component that comes is another one's."""
    name = name_of(component)
    if name is not None and there.get(name, component) is not component:
        yield because("name", component, NameTakenError(kind, name))


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


FULL: Final = 0.8
"""The part of its time that a bus can be asked: each transfer has its gaps."""

_RENUMBERED: Final = re.compile(r"/dev/tty(USB|ACM)\d+\Z")


def claimed_twice(
    about: Iterable[Resource], claims: Mapping[tuple[int, str], str]
) -> Iterator[Finding]:
    """Find the resources that claim what another one has for itself alone."""
    for resource in about:
        if resource.claim is None:
            continue
        first = claims.get((id(resource.bus), resource.claim), resource.name)
        if first != resource.name:
            told = f"{resource.claim} belongs to {first!r}: they cannot share it"
            yield mistake("claim", resource, "", told)


def odd_buses(plan: Plan) -> Iterator[Finding]:
    """Find buses that nobody is on, and ports that are not always the same device."""
    used = {id(each.bus) for each in plan.resource_of.values()}
    for name, bus in _buses(plan):
        if id(bus) not in used and not plan.missing:
            yield warning("unused", bus, "", "no device is on it", of=name)
        port = getattr(bus, "port", None)
        if isinstance(port, str) and _RENUMBERED.match(port):
            told = f"{port} may be another device after the next plugging"
            advice = "expected the path of the same device in /dev/serial/by-id"
            yield warning("port", bus, "port", told, advice, of=name)


def unopened(plan: Plan, action: Any) -> Iterator[Finding]:
    """Find what stands for another robot on a bus that no device is on: it stays closed."""
    bus = action.bus
    if not any(each.bus is bus for each in plan.resource_of.values()):
        told = f"no device is on {bus.name!r}, so nobody opens it"
        advice = f"expected Peer(name={bus.name!r}, bus=...) of esair.drivers.peer"
        yield mistake("unopened", action, "bus", told, advice)


def overloaded(plan: Plan) -> Iterator[Finding]:
    """Find buses of which their devices ask more than they have time for."""
    for name, bus in _buses(plan):
        of_bus = (each for each in plan.resource_of.values() if each.bus is bus)
        cost = getattr(bus, "seconds_for", lambda _: 0.0)  # whatever is given as one
        load = sum(_per_second(each) * cost(each.traffic) for each in of_bus)
        if load > FULL:
            told = f"its devices ask {load:.0%} of its time at their rates"
            advice = "lower their rates, or give some of them another bus"
            yield warning("load", bus, "", told, advice, of=name)


def _per_second(resource: Resource) -> float:
    """Return how often a device is asked in a second, or told at least."""
    if isinstance(resource, Sensor):
        return resource.rate if resource.can_be_asked and not resource.pushes else 0.0
    timeout = getattr(resource, "command_timeout", None)
    return 1.0 / timeout if timeout else 0.0


def _buses(plan: Plan) -> list[tuple[str, Bus]]:
    named = list(plan.buses.items())
    known = {id(bus) for _, bus in named}
    for resource in plan.resource_of.values():
        if resource.bus is not None and id(resource.bus) not in known:
            known.add(id(resource.bus))
            named.append((str(getattr(resource.bus, "name", "bus")), resource.bus))
    return named


def examine(plan: Plan) -> list[Finding]:
    """Find everything that is wrong, or odd, with a robot before it starts.

    Nothing is opened, and nothing of the robot is changed.

    Returns:
        What was found: resources, behaviors, policies, in this order, and then what
        only the whole shows.
    """
    if found := [*filter(None, map(raising, [*plan.resources, *plan.behaviors]))]:
        return found  # no rule could ask them
    return [
        *_names(plan),
        *_about_resources(plan, plan.resources),
        *_about_actions(plan, plan.behaviors),
        *mistakes_in_policies(plan),
        *mistakes_in_modes(plan),
        *(found for each in plan.action_of.values() for found in idle(each)),
        *starving(plan),
        *never_failed(plan),
        *lasting(plan),
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
        *_about_action(plan, action),
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
    if found and any(finding.is_error for finding in found):
        return
    if isinstance(action, Reaction):
        yield from mistyped(action)
    if hasattr(action, "asked_alone"):
        yield from unopened(plan, action)
    for attribute, need in action.needs.items():
        missing = unmet(plan, action, attribute, need)
        if missing is not None:
            yield missing
        else:
            yield from untimely(plan, action, attribute, need)
        if need.provider in plan.resource_names:
            yield from denied(plan, action, need, user=user or action.name)
