"""Policies: do they fit the robot, and do they allow what its actions declare?"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from esair.actions import Behavior, Need, Reaction, Reads, Writes
from esair.exceptions import AccessDeniedError, UnknownNameError, did_you_mean
from esair.messages import Access, BehaviorsPolicy, Policy
from esair.plan._finding import Finding, mistake, warning
from esair.plan._plan import Plan
from esair.resources import Actuator


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
