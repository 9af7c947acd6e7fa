"""The resource supervisor (RS): deploys resources, registers who may use them."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import TYPE_CHECKING, Any, overload

from esair import abc, minimal
from esair.connections import Call, Registration, Terms
from esair.exceptions import EsairError
from esair.loop import VERB_COST, Budget
from esair.messages import Access, ResourceStatus, SupervisorPhase, Why
from esair.plan import examine_resource, in_use, refuse
from esair.resources import Actuator, Resource, adapt_resource
from esair.supervisors._behavior_deployment import name_of
from esair.supervisors._resource_deployment import ResourceDeployment
from esair.supervisors._resource_life import ResourceLife
from esair.values import check_name, same_type

if TYPE_CHECKING:
    from esair.buses import Bus


_DESCRIBED_WRONGLY = "the resource is described wrongly"


class ResourceSupervisor(abc.Supervisor):
    """Deploys resources, adds and removes them at run time, and grants their use.

    It is the only way to *configure* a resource (the control path). Data never
    passes through it: that is what the connections are for.

    Args:
        deployment: The resources of the robot.
        command: Does what an operator types.
    """

    def __init__(
        self, deployment: ResourceDeployment, command: Callable[[str], Awaitable[str]]
    ) -> None:
        self._deployment = deployment
        self._command = command
        self._control = deployment.control
        self._commands = deployment.commands

    # What everybody may ask.

    @property
    def phase(self) -> SupervisorPhase:
        """What the supervisor is doing."""
        return self._commands.phase

    def names(self) -> list[str]:
        """Return the names of the resources."""
        return list(self._deployment.lives)

    @property
    def buses(self) -> tuple[Bus, ...]:
        """Every bus that a resource of this robot is or was on."""
        return tuple(self._deployment.buses)

    def get(self, name: str) -> Resource:
        """Return a resource by its name.

        Raises:
            UnknownNameError: No resource has the name.
        """
        return self._deployment.life(name).resource

    def query(self, name: str) -> ResourceStatus:
        """Tell what a resource is doing. Answers at any time, without a wait.

        Raises:
            UnknownNameError: No resource has the name.
        """
        return self._deployment.life(name).status()

    def abandoned(self) -> tuple[Call, ...]:
        """Return the driver calls that were given up, and whose code still runs."""
        return tuple(sorted(self._deployment.left, key=lambda call: call.begun))

    @overload
    def why(self) -> tuple[Why, ...]: ...
    @overload
    def why(self, name: str) -> Why: ...
    def why(self, name: str | None = None) -> Why | tuple[Why, ...]:
        """Tell who holds an actuator, by which rule, since when, what would free it.

        And who may write it, who guards it, and what happens when each is blind.

        Args:
            name: The actuator; all of them, in a tuple, unless given.

        Raises:
            UnknownNameError: No actuator has the name.
        """
        if name is None:
            return tuple(self.why(each) for each in self._deployment.actuators.names())
        held = self._deployment.actuators.channel(name).why()
        protections = self._deployment.actuators.protections.of(name)
        holds = {each.component for each in protections if not each.guards}
        rights = self._deployment.registrations.of_resource(name)
        return held._replace(
            writers=tuple(
                f"{each.behavior} writes with priority {each.priority}; when blind: "
                f"{'safe' if each.behavior in holds else 'release'}"
                for each in sorted(rights, key=lambda r: (-r.priority, r.behavior))
                if Access.WRITE in each.access
            ),
            guards=tuple(each.describe() for each in protections),
            dies=self._deployment.dies(name),
            resting=self._deployment.resting_writers(name),
        )

    # What the user may do.

    async def add(self, resource: Resource | minimal.Sensor | minimal.Actuator) -> None:
        """Deploy a resource while everything else keeps running.

        Returns when the device was tried once. A device that is not there does not
        matter: it is LOST, and comes when it comes, unless it is ``required``.

        Raises:
            ConfigError: It is declared wrongly.
            NameTakenError: The name is in use.
            DeviceLostError: It is required, and not there.
            StoppingError: The robot is not running.
        """
        added: Resource = adapt_resource(resource)

        async def work() -> None:
            await self._deployment.gone(getattr(added, "name", ""))
            refuse(examine_resource(self._deployment.plan, added), _DESCRIBED_WRONGLY)
            life = self._deployment.deploy(added)
            self._commands.changed()
            try:
                await asyncio.shield(life.tried)
            except BaseException:
                await self._deployment.undo(life)
                raise
            self._deployment.came(added.name)

        await self._commands.run(work, name=f"add {name_of(added):.80}", undo=True)

    async def remove(self, name: str) -> None:
        """Take a resource away; nobody needs to agree.

        An actuator is made safe first. Every registration for it becomes void in
        one step, and whoever reads or waits gets `ResourceRemovedError` at once.

        Raises:
            UnknownNameError: No resource has the name.
            StoppingError: The robot is not running.
        """
        until = self._deployment.deadline()

        async def work() -> None:
            await self._deployment.gone(name)
            self._deployment.life(name)
            await self._deployment.remove(name, until)

        await self._commands.run(work, name=f"remove {name}", undo=False, lasts=True)

    async def restart(self, name: str) -> None:
        """Close a device and open it again, also one that has failed for good.

        It returns when the device was tried once; its budget of restarts is full again.

        Raises:
            UnknownNameError: No resource has the name.
            StoppingError: The robot is not running.
        """

        async def work() -> ResourceLife:
            await self._deployment.gone(name)  # what goes is not begun again
            life = self._deployment.life(name)
            life.restart()
            return life

        life = await self._commands.run(work, name=f"restart {name}", undo=False)
        await asyncio.shield(life.tried)

    async def replace(
        self, name: str, resource: Resource | minimal.Sensor | minimal.Actuator
    ) -> None:
        """Put another resource in the place of one, under the same name.

        Registrations go on if the new one is of the same kind and type; the others
        become void.

        Raises:
            UnknownNameError: No resource has the name.
            ConfigError: The new one is declared wrongly.
            StoppingError: The robot is not running.
        """
        added: Resource = adapt_resource(resource)
        until = self._deployment.deadline()

        async def work() -> ResourceLife:
            await self._deployment.gone(name)
            old = self._deployment.life(name).resource
            if isinstance(added, Resource) and not in_use(added):
                added._name = check_name("resource", name)  # noqa: SLF001 - a supervisor gives names
            plan = self._deployment.plan
            refuse(examine_resource(plan, added, instead_of=old), _DESCRIBED_WRONGLY)
            same_kind = isinstance(old, Actuator) is isinstance(added, Actuator)
            keep = same_kind and same_type(added.value_type, old.value_type)
            return await self._deployment.replace(name, added, keep=keep, until=until)

        life = await self._commands.run(
            work, name=f"replace {name}", undo=False, lasts=True
        )
        await asyncio.shield(life.tried)

    async def command(self, text: str) -> str:
        """Do what an operator types: as `BehaviorSupervisor.command`."""
        await Budget.spend(VERB_COST)
        return await self._command(text)

    # What behaviors may ask for.

    async def register(
        self,
        behavior: str | abc.Action,
        resource: str | abc.Resource,
        access: Access,
        *,
        priority: int = 0,
        hold: float | None = None,
    ) -> Registration:
        """Register a behavior to use a resource.

        Asking again on the same terms gives the same registration.

        Args:
            behavior: Who asks, or its name.
            resource: What for, or its name.
            access: What it wants to do.
            priority: With which priority it writes; higher wins.
            hold: For how long its writes hold an actuator, in seconds.

        Raises:
            UnknownNameError: No resource has the name.
            AccessDeniedError: A rule denies it.
            StoppingError: The robot is not running.
        """
        await Budget.spend()
        user = behavior.name if isinstance(behavior, abc.Component) else behavior
        used = resource.name if isinstance(resource, abc.Component) else resource
        return self._control.grant(Terms(user, used, access, priority, hold))

    def revoke(
        self, registration: Registration, reason: Callable[[], EsairError] | None = None
    ) -> None:
        """Make a registration void in one step; its actuator is made safe.

        Args:
            registration: What `register` has returned.
            reason: Makes the error that its holder gets from now on.
        """
        self._control.revoke(registration, reason)

    async def configure(self, registration: Registration, /, **settings: Any) -> None:
        """Change settings of a resource: all of them, or none.

        Args:
            registration: A registration with the CONFIGURE right.
            **settings: New values by name.

        Raises:
            NotRegisteredError: The registration is not valid.
            AccessDeniedError: It does not include CONFIGURE.
            BadValueError: Every mistake is named, nothing was changed.
            DeviceLostError: The device is not there.
            DeviceFaultError: The device did not take it; it was put back.
            DriverStuckError: The device did not answer in time; it was put back.
        """
        await self._control.configure(registration, **settings)

    async def operate(
        self, registration: Registration, name: str, /, **parameters: Any
    ) -> Any:
        """Call an operation of a resource, such as ``home``, when its device is free.

        Whoever is cancelled here ends the operation.

        Args:
            registration: A registration with the CONFIGURE right.
            name: The name of the operation; `Resource.operations` has them.
            **parameters: What it takes, by name.

        Returns:
            What the operation returns.

        Raises:
            NotRegisteredError: The registration is not valid (any more).
            AccessDeniedError: It does not include CONFIGURE, or somebody holds the
                actuator, or has made it safe meanwhile.
            HaltedError: The robot is halted, or was halted meanwhile.
            BusyError: Too many operations wait.
            EsairError: As `SensorPort.operate`.
        """
        return await self._control.operate(registration, name, **parameters)


def admit(
    resources: ResourceSupervisor,
    principal: str,
    resource: str,
    access: Access,
    *,
    priority: int = 0,
) -> Registration:
    """Register somebody who is no component: people rank above the rules."""
    control = resources._control  # noqa: SLF001 - not a verb of the architecture
    return control.admit(Terms(principal, resource, access, priority))
