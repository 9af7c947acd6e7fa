"""The control path: who may do what with a resource, and how it is configured.

By the developer's policies, and by the declarations of the classes.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any

from esair.connections import (
    AppliedChannel,
    Registration,
    Registrations,
    Terms,
)
from esair.exceptions import (
    AccessDeniedError,
    BadValueError,
    BusyError,
    ConfigError,
    DeviceLostError,
    DriverStuckError,
    EsairError,
    ResourceRemovedError,
    StoppingError,
    UnknownNameError,
)
from esair.journal import Kind
from esair.loop import VERB_COST, Budget, current_owner, look_at, portal, spawn
from esair.messages import Access, Policy, ResourceState, SupervisorPhase
from esair.plan import denial, not_alone, plain_mistakes
from esair.resources import APPLIED, Resource, check_settings, operation_of, shown
from esair.supervisors._resource_life import ResourceLife
from esair.values import check_party, is_positive

if TYPE_CHECKING:
    from esair.supervisors._resource_deployment import ResourceDeployment

Declared = Callable[[str, str], Access]
"""What the class of a behavior declares to do with a resource."""


def only_the_user(what: str, asked: str, does: str) -> None:
    """Refuse what people decide to a component that asks, from wherever it asks."""
    if current_owner() is not None or portal.get(None) is not None:
        raise AccessDeniedError("a behavior", what, asked, f"only the user {does}")


WAITING_LIMIT = 16
"""How many operations of one resource may wait or run; more are refused."""


class ControlPath:
    """Issues registrations by the rules, and lets their holders configure."""

    def __init__(
        self,
        resources: ResourceDeployment,
        policies: Iterable[Policy],
        declared: Declared,
    ) -> None:
        self._resources = resources
        self.registrations: Registrations = resources.registrations
        self._lives, self._leaving = resources.lives, resources.leaving
        self._sensors, self._actuators = resources.sensors, resources.actuators
        # What is no policy, or one too many, is found before the robot starts.
        self.policies: dict[str, Policy] = {
            each.resource: each for each in policies if isinstance(each, Policy)
        }
        self._declared = declared
        self.turned_away: int = 0  # how many operations there was no room for
        self.closed = False  # the robot stops: nobody gets a right any more

    def grant(self, terms: Terms, *, instead_of: str | None = None) -> Registration:
        """Register a behavior, in one step without an await."""
        check_party("behavior", terms.behavior)
        resource = terms.resource
        provider = self._provider(resource)
        self._check_there(resource, provider)
        _check_terms(terms)
        self._check_rules(terms, provider, instead_of)
        if provider != resource:
            self._tell_applied(provider)
        known = self.registrations.find(terms) if instead_of is None else None
        return known or self.registrations.issue(terms)

    def _check_rules(self, terms: Terms, provider: str, instead_of: str | None) -> None:
        """Pass if a behavior may have what it asks for."""
        behavior, resource, access, priority, _ = terms
        if not access:
            raise AccessDeniedError(
                behavior, resource, "nothing", "ask for some access"
            )
        is_actuator = resource in self._actuators.channels
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
            meet = self._resources.plan.modes.meet
            for other in self.writers_of(resource):
                if other not in {behavior, instead_of} and meet(behavior, other):
                    raise not_alone(policy, behavior, other)

    def writers_of(self, resource: str) -> list[str]:
        """Return who is registered to write an actuator."""
        return [
            registration.behavior
            for registration in self.registrations.of_resource(resource)
            if Access.WRITE in registration.access
        ]

    def admit(self, terms: Terms) -> Registration:
        """Register somebody who is no component: people rank above the rules."""
        self._check_there(terms.resource, terms.resource)
        return self.registrations.issue(terms)

    def _provider(self, resource: str) -> str:
        """Return the actuator if a name is that of its last command."""
        actuator = str(resource).removesuffix(APPLIED)  # no name at all is told then
        return actuator if actuator in self._actuators.channels else resource

    def _check_there(self, resource: str, provider: str) -> None:
        if self.closed:
            raise StoppingError("resources", SupervisorPhase.STOPPED.value)
        if provider not in self._lives:
            raise UnknownNameError("resource", resource, self._lives)
        if provider in self._leaving:
            raise ResourceRemovedError(resource)

    def _tell_applied(self, actuator: str) -> None:
        """Have the last command of an actuator as a reading, from now on."""
        channel = self._actuators.channels[actuator]
        if channel.wire.applied is None:
            applied = AppliedChannel(channel.actuator, self.registrations)
            self._sensors.channels[applied.name] = applied
            channel.tell_applied(applied)

    def revoke(
        self, registration: Registration, reason: Callable[[], EsairError] | None = None
    ) -> None:
        """Make a registration void in one step; its actuator is made safe."""
        if self.registrations.revoke(registration, reason):
            life = self._lives.get(registration.resource)
            if life is not None:
                life.channel.drop(registration)

    async def configure(self, registration: Registration, /, **settings: Any) -> None:
        """Change settings of a resource; see `ResourceSupervisor.configure`."""
        await Budget.spend(VERB_COST)
        life = self._configurable(registration)
        _checked(life.resource, settings)
        task = spawn(
            asyncio.get_running_loop(),
            self._configure(registration, settings),
            name=f"configure {registration.resource}",
        )
        task.add_done_callback(look_at)
        await asyncio.shield(task)

    async def operate(
        self, registration: Registration, name: str, /, **parameters: Any
    ) -> Any:
        """Call an operation of a resource; see `ResourceSupervisor.operate`."""
        await Budget.spend(VERB_COST)
        life = self._configurable(registration)
        resource = life.resource
        operation = operation_of(resource, name)
        checked = operation.check(resource.name, parameters)
        limit = operation.deadline or resource.deadline
        until = asyncio.get_running_loop().time() + limit
        if life.operations >= WAITING_LIMIT:
            self.turned_away += 1
            raise BusyError(resource.name, "number of operations", WAITING_LIMIT)
        life.operations += 1
        try:
            try:
                async with asyncio.timeout_at(until):
                    await life.configuring.acquire()
            except TimeoutError as error:
                what = f"operate {name}, which waited for its turn,"
                raise DriverStuckError(life.name, what, limit) from error
            free = life.configuring.release
            if life.is_over:
                free()
                raise DeviceLostError(resource.name, "it was replaced")
            # It has the device for itself until then: nothing is configured or opened.
            run = life.channel.operations.run
            return await run(registration, name, checked, until, limit, free)
        finally:
            life.operations -= 1

    def _configurable(self, registration: Registration) -> ResourceLife:
        if (
            not isinstance(registration, Registration)
            or self.registrations.live.get(registration.number) is not registration
        ):
            raise self.registrations.refusal(registration)
        if Access.CONFIGURE not in registration.access:
            raise AccessDeniedError(
                registration.behavior,
                registration.resource,
                str(Access.CONFIGURE),
                f"it is registered to {registration.access} only: declare configure=True",
            )
        life = self._lives.get(registration.resource)
        if life is None:  # a right ends with its resource, but not with the robot
            raise StoppingError("resources", SupervisorPhase.STOPPED.value)
        if life.channel.state is not ResourceState.READY:
            raise life.channel.absence()
        return life

    async def _configure(
        self, registration: Registration, settings: dict[str, Any]
    ) -> None:
        life = self._configurable(registration)
        async with life.configuring:
            if self._configurable(registration) is not life:
                raise DeviceLostError(registration.resource, "it was replaced")
            changes = _checked(life.resource, settings)
            await life.configure(changes)
            self.registrations.journal.publish(
                Kind.CONFIGURED,
                registration.resource,
                registration.behavior,
                shown(life.resource, changes),
            )


def _checked(resource: Resource, settings: dict[str, Any]) -> dict[str, object]:
    """Return new settings; one for what every device has is such as its class may say."""
    changes = check_settings(resource, settings)
    for field, told in plain_mistakes(changes):
        raise BadValueError(resource.name, field, told)
    return changes


def _check_terms(terms: Terms) -> None:
    behavior, resource, access, priority, hold = terms
    if not isinstance(access, Access):
        told = f"expected an esair.Access, not {access!r:.80}"
        raise ConfigError(behavior, resource, told)
    if type(priority) is not int:
        told = f"expected a whole number, not {priority!r:.80}"
        raise ConfigError(behavior, f"{resource}.priority", told)
    if hold is not None and not is_positive(hold):
        told = f"expected seconds > 0, not {hold!r:.80}"
        raise ConfigError(behavior, f"{resource}.hold", told)
