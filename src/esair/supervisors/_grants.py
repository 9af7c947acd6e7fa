"""What one component may use: its registrations, and the ports made of them."""

from __future__ import annotations

import logging
import types
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from esair.actions import (
    ActuatorPort,
    Behavior,
    BlockingCalls,
    BlockingRequestPort,
    GuardRunner,
    Guards,
    Need,
    Reaction,
    ReactionRunner,
    Reads,
    RequestPort,
    SensorPort,
    Takes,
    ThreadBehavior,
    Writes,
    blocking,
)
from esair.connections import ActuatorChannel, Registration, SensorChannel, Terms
from esair.exceptions import EsairError, describe
from esair.loop import Portal
from esair.messages import Access
from esair.plan import refuse, unmet

if TYPE_CHECKING:
    from esair.supervisors._behavior_deployment import BehaviorDeployment
    from esair.supervisors._member import Member
    from esair.supervisors._perform import BehaviorStep

Action = Behavior | Reaction
Port = SensorPort[Any] | ActuatorPort[Any]

_log = logging.getLogger("esair")


_METHODS = {
    name: method
    for name, method in vars(BlockingCalls).items()
    if isinstance(method, types.FunctionType)
}
"""What a plain behavior calls in its thread, and others await."""


class Grants:
    """Keeps the registrations of one component, and the ports that it declares.

    Args:
        name: In whose name it is registered.
        crew: The behaviors of the robot.
        under: The needs of the behavior that performs it, if it is a step: it writes
            with no higher priority than that.
    """

    __slots__ = ("_crew", "_name", "_ports", "_under", "registrations")

    def __init__(
        self,
        name: str,
        crew: BehaviorDeployment,
        under: Mapping[str, Need] | None = None,
    ) -> None:
        self._name = name
        self._under = under
        self._crew = crew
        self._ports: dict[str, Port] = {}
        """The declared ports of a behavior, by their attributes."""
        self.registrations: list[Registration] = []

    def grant(
        self,
        resource: str,
        access: Access,
        priority: int,
        hold: float | None,
        owned: list[Registration] | None = None,
    ) -> Registration:
        """Return a registration of its own: one that it has on these terms, or a new one.

        Never one of another member with the same name, which is about to give its
        place to this one and takes its registrations along.
        """
        if self._under is not None:
            own = [n.priority for n in self._under.values() if n.resource == resource]
            priority = min(priority, max(own, default=0))
        terms = Terms(self._name, resource, access, priority, hold)
        for known in tuple(self.registrations):
            if known.resource == resource and known.terms == terms:
                if known.usable:
                    return known
                self.registrations.remove(known)  # void: its resource was removed
        control = self._crew.resources.control
        registration = control.grant(terms, instead_of=self._name)
        (self.registrations if owned is None else owned).append(registration)
        return registration

    def of_need(
        self, need: Need, owned: list[Registration] | None = None
    ) -> Registration:
        return self.grant(need.resource, need.access, need.priority, need.hold, owned)

    def check_type(
        self, action: Action, resource: str, access: Access, wanted: type | None
    ) -> None:
        """Raise what is wrong with what a behavior registers for while it runs."""
        if wanted is not None:
            kind = Reads if Access.READ in access else Writes
            need: Need = kind(wanted, name=resource)
            if found := unmet(self._crew.resources.plan, action, resource, need):
                refuse([found], f"{self._name} is described wrongly")

    def misfit(self, action: Action, resource: str) -> str:
        """Say why a resource that is there now does not fit a port; empty if it does."""
        plan = self._crew.resources.plan
        for attribute, need in action.needs.items():
            asked = need.provider == resource and resource in plan.resource_names
            if asked and (found := unmet(plan, action, attribute, need)):
                return found.text
        return ""

    def is_there(self, need: Need) -> bool:
        """Tell whether what an action declares was added, and not removed."""
        return need.provider in self._crew.resources.lives

    def channel(self, resource: str) -> SensorChannel | ActuatorChannel:
        sensor = self._crew.resources.sensors.channels.get(resource)
        return sensor or self._crew.resources.actuators.channels[resource]

    def port(self, registration: Registration, max_age: float | None) -> Port:
        resources = self._crew.resources
        if registration.resource in resources.sensors.channels:
            return resources.sensors.port(registration, max_age=max_age)
        return resources.actuators.port(registration)

    def declare(self, attribute: str, need: Need) -> Port:
        max_age = need.max_age if isinstance(need, Reads) else None
        port = self._ports[attribute] = self.port(self.of_need(need), max_age)
        return port

    def revive(self, needs: Mapping[str, Need], resource: str) -> None:
        """Give the declared ports of a behavior their rights to a resource again."""
        there = self._crew.resources.lives
        for attribute, need in needs.items():
            port = self._ports.get(attribute)
            if port is None or need.provider != resource or resource not in there:
                continue
            if port.registration.reason is None:
                continue  # it was never revoked
            try:
                registration = self.of_need(need)
            except EsairError as error:
                _log.warning("%s: %s: %s", self._name, attribute, describe(error))
            else:
                port.revive(self.channel(need.resource), registration)


def bind(
    runner: ReactionRunner,
    reaction: Reaction,
    grants: Grants,
    owned: list[Registration] | None = None,
) -> list[Registration]:
    """Register for what a reaction reads and moves, and let it run."""
    inputs: dict[str, tuple[SensorChannel, Registration, float | None]] = {}
    outputs: dict[str, tuple[ActuatorChannel, Registration]] = {}
    guarded: ActuatorChannel | None = None
    uses: list[Registration] = []
    for attribute, need in reaction.needs.items():
        if need.optional and not grants.is_there(need):
            continue  # it gets None for it
        registration = grants.of_need(need, owned)
        if not need.optional:
            uses.append(registration)
        channel = grants.channel(need.resource)
        if isinstance(channel, SensorChannel):
            limit = need.max_age if isinstance(need, Reads) else None
            inputs[attribute] = (channel, registration, limit)
            reaction.__dict__[attribute] = grants.port(registration, limit)
        elif isinstance(need, Guards):
            guarded = channel
        else:
            outputs[attribute] = (channel, registration)
    if isinstance(runner, GuardRunner):
        assert guarded is not None
        runner.guard(guarded, inputs)
    else:
        runner.start(inputs, outputs)
    return uses


def fill(
    behavior: Behavior,
    host: Member | BehaviorStep,
    grants: Grants,
    portal: Portal | None,
) -> None:
    """Give a behavior what it declares; with a portal all of it waits, in its thread."""
    behavior._host, behavior._mail = host, host.mail  # noqa: SLF001 - its own supervisor's
    if portal is not None and not isinstance(behavior, ThreadBehavior):
        for name, method in _METHODS.items():
            behavior.__dict__[name] = types.MethodType(method, behavior)
    for attribute, need in behavior.needs.items():
        port: Any = grants.declare(attribute, need)
        behavior.__dict__[attribute] = blocking(port, portal) if portal else port
    for attribute, each in behavior.takes.items():
        if isinstance(each, Takes) and each.method is None:
            queue = host.mail.queues[each.type]
            behavior.__dict__[attribute] = (
                BlockingRequestPort(queue, portal) if portal else RequestPort(queue)
            )


def empty(
    behavior: Behavior | Reaction, host: Member | BehaviorStep, portal: Portal | None
) -> None:
    """Take a behavior its supervisor, if it has not another one by now."""
    if isinstance(behavior, Reaction) or vars(behavior).get("_host") is not host:
        return
    del behavior._host, behavior._mail  # noqa: SLF001 - as above
    if portal is not None:
        for method in _METHODS:
            behavior.__dict__.pop(method, None)
