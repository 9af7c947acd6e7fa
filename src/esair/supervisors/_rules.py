"""Who may do what: the developer's policies, and the declarations of the classes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

from esair.connections import Registrations
from esair.exceptions import (
    AccessDeniedError,
    ConfigError,
    UnknownNameError,
    did_you_mean,
)
from esair.messages import Access, Policy

Declared = Callable[[str, str], Access]
"""What the class of a behavior declares to do with a resource."""


class Rules:
    """Decides whether a behavior may register; says which rule denied it.

    Args:
        policies: The developer's rules, at most one for each resource.
        registrations: Who is registered now, for exclusive use.
        declared: What the class of a behavior declares.
    """

    def __init__(
        self,
        policies: Iterable[Policy],
        registrations: Registrations,
        declared: Declared,
    ) -> None:
        self.policies: dict[str, Policy] = {}
        self.repeated: list[str] = []
        """Resources that have more than one policy, which is a mistake."""
        self._strange: list[object] = []
        for policy in policies:
            if not isinstance(policy, Policy):
                self._strange.append(policy)
                continue
            if policy.resource in self.policies:
                self.repeated.append(policy.resource)
            self.policies[policy.resource] = policy
        self._registrations = registrations
        self._declared = declared

    def check(
        self,
        behavior: str,
        resource: str,
        access: Access,
        priority: int,
        *,
        is_actuator: bool,
        declares: Access | None = None,
        instead_of: str | None = None,
    ) -> None:
        """Pass if a behavior may have what it asks for.

        Args:
            behavior: Who asks.
            resource: What for.
            access: What it wants to do.
            priority: With which priority it wants to write.
            is_actuator: Whether the resource is an actuator.
            declares: What its class declares, if it is not in the robot yet.
            instead_of: A behavior that is about to give its place to this one.

        Raises:
            AccessDeniedError: It may not; the error names the rule.
        """
        if not access:
            raise AccessDeniedError(
                behavior, resource, "nothing", "ask for some access"
            )
        wrong = access & (Access.READ if is_actuator else Access.WRITE | Access.GUARD)
        if wrong:
            kind = "an actuator is written" if is_actuator else "a sensor is read"
            raise AccessDeniedError(behavior, resource, str(wrong), kind)
        policy = self.policies.get(resource)
        if policy is None:
            if declares is None:
                declares = self._declared(behavior, resource)
            allowed = declares | Access.READ
            if access not in allowed:
                raise AccessDeniedError(
                    behavior,
                    resource,
                    str(access & ~allowed),
                    f"no policy allows it and the class of {behavior!r} does not declare it",
                )
            return
        allowed = policy.allow.get(behavior, policy.allow.get("*", Access(0)))
        if access not in allowed:
            raise AccessDeniedError(
                behavior,
                resource,
                str(access & ~allowed),
                f"the policy of {resource!r} allows it {str(allowed) or 'nothing'}",
            )
        highest = policy.max_priority.get(behavior, policy.max_priority.get("*"))
        if Access.WRITE in access and highest is not None and priority > highest:
            raise AccessDeniedError(
                behavior,
                resource,
                f"WRITE with priority {priority}",
                f"the policy of {resource!r} allows it priority {highest} at most",
            )
        if policy.exclusive and Access.WRITE in access:
            for other in self._registrations.of_resource(resource):
                if Access.WRITE in other.access and other.behavior not in {
                    behavior,
                    instead_of,
                }:
                    raise AccessDeniedError(
                        behavior,
                        resource,
                        "WRITE",
                        f"the policy of {resource!r} is exclusive and "
                        f"{other.behavior!r} is registered",
                    )

    def mistakes(
        self, resources: Mapping[str, object], behaviors: Iterable[str]
    ) -> list[ConfigError]:
        """Return what is wrong with the policies of a robot before it starts."""
        known = sorted(behaviors)
        found = [
            ConfigError("policies", "", f"expected an esair.Policy, not {each!r:.80}")
            for each in self._strange
        ]
        found.extend(
            ConfigError(
                f"policy of {name!r}", "resource", "it has more than one policy"
            )
            for name in self.repeated
        )
        for name, policy in self.policies.items():
            if name not in resources:
                unknown = UnknownNameError("resource", name, resources)
                found.append(
                    ConfigError(f"policy of {name!r}", "resource", str(unknown))
                )
            found.extend(
                ConfigError(
                    f"policy of {name!r}",
                    f"max_priority.{who}",
                    "expected a whole number",
                )
                for who, value in policy.max_priority.items()
                if type(value) is not int
            )
            # A name that is like no other may be that of a behavior added later; so
            # may one that is like another that the policy names too.
            left = [each for each in known if each not in policy.allow]
            found.extend(
                ConfigError(
                    f"policy of {name!r}",
                    f"allow.{who}",
                    f"no behavior is named {who!r}{nearest}",
                )
                for who in policy.allow
                if who not in known and (nearest := did_you_mean(who, left))
            )
        return found
