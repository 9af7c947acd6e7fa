"""What actions, and computed sensors, ask of resources: is it there, in time, and allowed?"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

from esair.actions import Behavior, Derived, Guards, Need, Reaction, Reads, Writes
from esair.exceptions import AccessDeniedError, UnknownNameError, did_you_mean
from esair.messages import Access, BehaviorsPolicy, Policy
from esair.plan._plan import Finding, Plan, mistake, warning
from esair.resources import APPLIED, Actuator, Resource, Sensor
from esair.values import is_positive, same_type, type_name

_DOING: Final = {Reads: "reads", Writes: "writes", Guards: "guards"}


def unmet(
    plan: Plan, action: Behavior | Reaction | Derived[Any], attribute: str, need: Need
) -> Finding | None:
    """Find out if nobody provides what a port of an action, or a derived sensor, asks for."""
    name, wanted = action.name, need.resource
    resource = plan.provided(need)
    if resource is None:
        if (
            need.provider in plan.resource_names
            and need.provider not in plan.resource_of
        ):
            return None  # its own mistakes are told already
        user = f"{name}: {attribute}"
        cause = UnknownNameError("resource", wanted, plan.resource_names, user=user)
        told = str(cause).removeprefix(f"{user}: ")
        return mistake("need", action, attribute, told, cause=cause)
    writes = not isinstance(need, Reads)
    doing = _DOING[type(need)]
    if writes is not isinstance(resource, Actuator):
        is_a = "a sensor" if writes else "an actuator"
        told = f"it {doing} {wanted!r}, which is {is_a}"
        applied = f"its last command is read as name={wanted + APPLIED!r}"
        advice = "" if writes else applied
        return mistake("need", action, attribute, told, advice)
    has = resource.value_type
    if not (same_type(need.type, has) if writes else same_type(has, need.type)):
        told = (
            f"it {doing} {type_name(need.type)}, but {wanted!r} "
            f"{'takes' if writes else 'gives'} {type_name(has)}"
        )
        return mistake("need", action, attribute, told)
    return None


def untimely(
    plan: Plan, action: Behavior | Reaction, attribute: str, need: Need
) -> Iterator[Finding]:
    """Find times that can never be met; both numbers are named."""
    if not isinstance(action, Reaction):
        return  # a behavior asks the device again when a reading is too old for it
    resource = plan.provided(need)
    if isinstance(need, Reads) and isinstance(resource, Sensor):
        yield from _too_young(action, attribute, need, resource)
        yield from _silent(action, attribute, need, resource)
    elif isinstance(need, Writes) and isinstance(resource, Actuator) and action.rate:
        timeout = resource.command_timeout
        if not is_positive(timeout):
            return
        longest = timeout if need.hold is None else min(need.hold, timeout)
        if 1 / action.rate >= longest:
            told = (
                f"it writes {need.resource!r} every {1 / action.rate:.3g} s, but a "
                f"command is good for {longest:.3g} s only"
            )
            yield warning(
                "time", action, attribute, told, "raise its rate or the command_timeout"
            )


def _too_young(
    action: Reaction, attribute: str, need: Reads[Any], sensor: Sensor[Any]
) -> Iterator[Finding]:
    if need.max_age is None or not sensor.can_be_asked or sensor.pushes:
        return
    period = 1 / sensor.rate
    if need.max_age <= period * (1 + 1e-9):  # 1 / 0.1 is not quite 10
        told = (
            f"its readings of {need.resource!r} may be {need.max_age:.3g} s old at "
            f"most, but come every {period:.3g} s only"
        )
        yield mistake(
            "time", action, f"{attribute}.max_age", told, "raise the rate or max_age"
        )


def _silent(
    action: Reaction, attribute: str, need: Reads[Any], sensor: Sensor[Any]
) -> Iterator[Finding]:
    """A device that pushes when something happens may have nothing to say at first."""
    if not _may_be_silent(sensor) or not _waits_for(need, sensor):
        return
    told = f"it is blind until {need.resource!r} first speaks"
    advice = (
        f"give {type(sensor).__name__} a read, an initial value, or a period (its "
        "greatest silence)"
    )
    yield warning("silent", action, attribute, told, advice)


def _may_be_silent(sensor: Sensor[Any]) -> bool:
    return sensor.pushes and sensor.period is None


def _waits_for(need: Reads[Any], sensor: Sensor[Any]) -> bool:
    """Tell whether it may be blind at first: nothing says the value at an opening."""
    return not (need.optional or sensor.can_be_asked or hasattr(sensor, "initial"))


def lasting(plan: Plan) -> Iterator[Finding]:
    """Find devices that push, and whose last reading is current for ever."""
    needs: list[tuple[str, Any, Need]]
    needs = [(name, action, need) for name, action, _, need in plan.needs()]
    for derived in plan.derived_of.values():
        needs += [(derived.name, derived, need) for need in derived.inputs.values()]
    for name, sensor in plan.resource_of.items():
        if not isinstance(sensor, Sensor) or not _may_be_silent(sensor):
            continue
        readers = {
            reader: None
            for reader, action, need in needs
            if need.provider == name and isinstance(need, Reads)
            if need.max_age is None
            if not (isinstance(action, Reaction) and _waits_for(need, sensor))
        }
        if readers:
            told = "however long it is silent, its last reading is current for "
            advice = (
                "give it a period (its greatest silence), or each of them a max_age"
            )
            yield warning("silent", sensor, "period", told + ", ".join(readers), advice)


def denial(
    policy: Policy, behavior: str, access: Access, priority: int
) -> tuple[str, AccessDeniedError] | None:
    """Return why a policy denies something, and the field that does; None if it allows.

    Args:
        policy: The policy of the resource.
        behavior: Who asks.
        access: What it wants to do.
        priority: With which priority it wants to write.
    """
    resource = policy.resource
    allowed = policy.allow.get(behavior, policy.allow.get("*", Access(0)))
    if access not in allowed:
        asked = str(access & ~allowed)
        return "allow", AccessDeniedError(
            behavior,
            resource,
            asked,
            f"the policy of {resource!r} allows it {str(allowed) or 'nothing'}: "
            f"allow {behavior!r} {asked} there",
        )
    highest = policy.max_priority.get(behavior, policy.max_priority.get("*"))
    if Access.WRITE in access and highest is not None and priority > highest:
        return "max_priority", AccessDeniedError(
            behavior,
            resource,
            f"WRITE with priority {priority}",
            f"the policy of {resource!r} allows it priority {highest} at most",
        )
    return None


def not_alone(policy: Policy, behavior: str, other: str) -> AccessDeniedError:
    """Make the error for a second writer of an exclusive actuator."""
    resource = policy.resource
    rule = f"the policy of {resource!r} is exclusive, and {other!r} writes it"
    return AccessDeniedError(behavior, resource, "WRITE", rule)


def denied(
    plan: Plan, action: Behavior | Reaction, need: Need, *, user: str
) -> Iterator[Finding]:
    """Find out if a policy denies what a port of an action asks for."""
    policy = plan.policy_of.get(need.provider)
    if policy is None:
        return
    if refusal := denial(policy, user, need.access, need.priority):
        field, error = refusal
        yield _against(policy, field, error)
    elif policy.exclusive and isinstance(need, Writes):
        writers = _writers(plan, action, need)
        meet = plan.modes.meet
        others = [each for each in writers if each != user and meet(each, user)]
        if others:
            yield _against(policy, "exclusive", not_alone(policy, user, others[0]))


def refused(plan: Plan, derived: str, need: Reads[Any]) -> Iterator[Finding]:
    """Find out if a policy keeps what a derived sensor is computed of from it."""
    policy = plan.policy_of.get(need.provider)
    if policy is not None and (refusal := denial(policy, derived, need.access, 0)):
        yield _against(policy, *refusal)


def _writers(
    plan: Plan, action: Behavior | Reaction, need: Writes[Any]
) -> Iterator[str]:
    """Yield who writes an actuator before an action does: the later one is refused."""
    if plan.writers is not None:
        yield from plan.writers(need.resource)
        return
    writers = plan.writes_of(need.resource)
    for name, other in plan.action_of.items():
        if other is action:
            return
        if name in writers:
            yield name


def _against(policy: Policy, field: str, error: AccessDeniedError) -> Finding:
    return mistake("denied", policy, field, str(error), cause=error)


def mistakes_in_policies(plan: Plan) -> Iterator[Finding]:
    """Find policies that do not fit the robot."""
    seen: set[str] = set()
    for policy in plan.policies:
        if isinstance(policy, BehaviorsPolicy):
            yield from _unknown(plan, policy, dict.fromkeys(policy.allow, "allow"))
            continue
        if not isinstance(policy, Policy):
            told = f"expected an esair.Policy, not {policy!r:.80}"
            yield mistake("rights", policy, "", told, of="policies")
            continue
        if policy.resource in seen:
            told = "it has more than one policy: join them"
            yield mistake("rights", policy, "resource", told)
        seen.add(policy.resource)
    for policy in plan.policy_of.values():
        yield from _in_policy(plan, policy)


def _in_policy(plan: Plan, policy: Policy) -> Iterator[Finding]:
    if policy.resource not in plan.resource_names:
        error = UnknownNameError("resource", policy.resource, plan.resource_names)
        yield mistake("rights", policy, "resource", str(error))
        return
    for who, level in policy.max_priority.items():
        if type(level) is not int:
            told = f"expected a whole number, not {level!r:.80}"
            yield mistake("rights", policy, f"max_priority.{who}", told)
    named = dict.fromkeys(policy.max_priority, "max_priority")
    named |= dict.fromkeys(policy.allow, "allow")
    yield from _unknown(plan, policy, named)
    yield from _useless(plan, policy)


def _unknown(plan: Plan, policy: object, named: Mapping[str, str]) -> Iterator[Finding]:
    """Find names of nobody, by the field that names them.

    One that is like no other may be that of a behavior added later; so may one that is
    like another that the policy names too.
    """
    left = [each for each in plan.action_names if named.get(each) != "allow"]
    for who, field in named.items():
        if who == "*" or who in plan.action_names:
            continue
        if who in plan.derived_of:
            continue  # it reads what it is computed of in its own name
        if nearest := did_you_mean(who, left):
            told = f"no behavior is named {who!r}{nearest}"
            yield mistake("rights", policy, f"{field}.{who}", told)
        else:
            told = f"nobody here has this right: no behavior is named {who!r}"
            yield warning("rights", policy, f"{field}.{who}", told)


def _useless(plan: Plan, policy: Policy) -> Iterator[Finding]:
    is_actuator = (
        isinstance(plan.resource_of.get(policy.resource), Actuator)
        or plan.missing.get(policy.resource) == "actuator"
    )
    asked = Access.WRITE if is_actuator else Access.READ
    everybody = policy.allow.get("*", Access(0))
    users = [*plan.action_names, *plan.derived_of]
    if not any(asked in policy.allow.get(name, everybody) for name in users):
        doing = "write" if is_actuator else "read"
        told = f"nobody here may {doing} it: no behavior of the robot is allowed to"
        yield warning("rights", policy, "", told)


def underivable(plan: Plan, derived: Derived[Any]) -> Iterator[Finding]:
    """Find out if a derived sensor lacks what it is computed of, or is one of those."""
    for attribute, need in derived.inputs.items():
        if missing := unmet(plan, derived, attribute, need):
            yield missing
        yield from refused(plan, derived.name, need)
    if path := _circle(plan, derived):
        told = f"it is computed of itself: {' of '.join(path)}"
        yield mistake("need", derived, "", told)


def _circle(plan: Plan, derived: Derived[Any]) -> list[str] | None:
    """Return the way from a derived sensor back to itself; None if there is none."""
    paths = [[derived.name]]
    seen: set[str] = set()
    while paths:
        path = paths.pop()
        source = plan.resource_of.get(path[-1])
        if not isinstance(source, Derived):
            continue
        for need in source.inputs.values():
            if need.resource == derived.name:
                return [*path, derived.name]
            if need.resource not in seen:
                seen.add(need.resource)
                paths.append([*path, need.resource])
    return None


def depths(resources: Sequence[Resource]) -> dict[str, int]:
    """Return how many computations come before each resource, one of the other."""
    known = {each.name: each for each in resources}
    found: dict[str, int] = {}

    def depth(name: str) -> int:
        if name not in found:
            found[name] = 0  # were it a circle, it would end here
            if isinstance(each := known.get(name), Derived):
                below = (depth(need.resource) for need in each.inputs.values())
                found[name] = 1 + max(below, default=0)
        return found[name]

    for each in known:
        depth(each)
    return found
