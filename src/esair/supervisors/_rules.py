"""Who may do what: the developer's policies, and the declarations of the classes."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from esair.connections import Registrations, Terms
from esair.exceptions import AccessDeniedError
from esair.loop import current_owner, portal
from esair.messages import Access, Policy
from esair.plan import denial, not_alone

Declared = Callable[[str, str], Access]
"""What the class of a behavior declares to do with a resource."""


def only_the_user(what: str, asked: str, does: str) -> None:
    """Refuse what people decide to a component that asks, from wherever it asks."""
    if current_owner() is not None or portal.get(None) is not None:
        raise AccessDeniedError("a behavior", what, asked, f"only the user {does}")


class Rules:
    """Decides whether a behavior may register; says which rule denied it."""

    def __init__(
        self,
        policies: Iterable[Policy],
        registrations: Registrations,
        declared: Declared,
        meet: Callable[[str, str], bool],
    ) -> None:
        # What is no policy, or one too many, is found before the robot starts.
        self.policies: dict[str, Policy] = {
            each.resource: each for each in policies if isinstance(each, Policy)
        }
        self._registrations = registrations
        self._declared = declared
        self._meet = meet  # whether two run in the same mode

    def check(
        self, terms: Terms, *, is_actuator: bool, instead_of: str | None, provider: str
    ) -> None:
        """Pass if a behavior may have what it asks for."""
        behavior, resource, access, priority, _ = terms
        if not access:
            raise AccessDeniedError(
                behavior, resource, "nothing", "ask for some access"
            )
        wrong = access & (Access.READ if is_actuator else Access.WRITE | Access.GUARD)
        if wrong:
            kind = "an actuator is written" if is_actuator else "a sensor is read"
            raise AccessDeniedError(behavior, resource, str(wrong), kind)
        policy = self.policies.get(provider)
        if policy is None:
            allowed = self._declared(behavior, resource) | Access.READ
            if access not in allowed:
                raise AccessDeniedError(
                    behavior,
                    resource,
                    str(access & ~allowed),
                    f"no policy allows it and the class of {behavior!r} does not declare it",
                )
            return
        if refusal := denial(policy, behavior, access, priority):
            raise refusal[1]
        if policy.exclusive and Access.WRITE in access:
            for other in self.writers_of(resource):
                if other not in {behavior, instead_of} and self._meet(behavior, other):
                    raise not_alone(policy, behavior, other)

    def writers_of(self, resource: str) -> list[str]:
        """Return who is registered to write an actuator."""
        return [
            registration.behavior
            for registration in self._registrations.of_resource(resource)
            if Access.WRITE in registration.access
        ]
