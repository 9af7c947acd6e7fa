"""The resource supervisor (RS): deploys resources, registers who may use them."""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import Callable, Coroutine, Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeVar, overload

from esair import abc, minimal
from esair.connections import (
    ActuatorChannel,
    ActuatorConnection,
    Call,
    LastCommand,
    Registration,
    Registrations,
    SensorChannel,
    SensorConnection,
)
from esair.exceptions import (
    AccessDeniedError,
    ConfigError,
    DeviceLostError,
    EsairError,
    HaltedError,
    ResourceRemovedError,
    StoppingError,
    UnknownNameError,
)
from esair.journal import Kind
from esair.loop import spawn
from esair.messages import (
    Access,
    Policy,
    ResourceState,
    ResourceStatus,
    Restart,
    SupervisorPhase,
    Why,
)
from esair.plan import Finding, Plan, examine_resource, in_use, refuse
from esair.resources import (
    Actuator,
    Resource,
    Sensor,
    adapt_resource,
    check_settings,
    shown,
)
from esair.supervisors._command_queue import CommandQueue
from esair.supervisors._operate import operate
from esair.supervisors._resource_life import ResourceLife
from esair.supervisors._rules import Declared, Rules
from esair.values import check_name, is_positive, same_type

if TYPE_CHECKING:
    from esair.buses import Bus
    from esair.watchdog import Watchdog

T = TypeVar("T")

_log = logging.getLogger("esair")


class ResourceSupervisor(abc.Supervisor):
    """Deploys resources, adds and removes them at run time, and grants their use.

    It is the only way to *configure* a resource (the control path). Data never
    passes through it: that is what the connections are for.
    """

    def __init__(
        self,
        sensors: SensorConnection,
        actuators: ActuatorConnection,
        registrations: Registrations,
        *,
        policies: Iterable[Policy] = (),
        declared: Declared = lambda _behavior, _resource: Access(0),
        grace: float = 1.0,
    ) -> None:
        self._sensors = sensors
        self._actuators = actuators
        self._registrations = registrations
        self.rules = Rules(policies, registrations, declared)
        self._grace = grace
        self._command_queue = CommandQueue("resources", asleep=True)
        self._lives: dict[str, ResourceLife] = {}
        self._leaving: set[str] = set()
        self._departures: dict[str, asyncio.Future[None]] = {}
        self._works: set[asyncio.Task[Any]] = set()
        self._left: set[Call] = set()
        self.watchdog: Watchdog | None = None
        """The second process that makes safe what this one cannot; the robot's."""
        self.buses: list[Bus] = []
        """Every bus that a resource of this robot is or was on."""
        self.journal = registrations.journal
        self.journal.count("resources", self._counted)

    # What everybody may ask.

    @property
    def phase(self) -> SupervisorPhase:
        """What the supervisor is doing."""
        return self._command_queue.phase

    def names(self) -> list[str]:
        """Return the names of the resources."""
        return list(self._lives)

    def get(self, name: str) -> Resource:
        """Return a resource by its name.

        Raises:
            UnknownNameError: No resource has the name.
        """
        return self._life(name).resource

    def query(self, name: str) -> ResourceStatus:
        """Tell what a resource is doing. Answers at any time, without a wait.

        Raises:
            UnknownNameError: No resource has the name.
        """
        life = self._life(name)
        return ResourceStatus(
            name,
            life.channel.state,
            life.channel.error,
            life.losses,
            life.faults,
            tuple(
                dict.fromkeys(r.behavior for r in self._registrations.of_resource(name))
            ),
            shown(life.resource, life.resource.settings),
        )

    def abandoned(self) -> tuple[Call, ...]:
        """Return the driver calls that were given up, and whose code still runs."""
        return tuple(sorted(self._left, key=lambda call: call.begun))

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
            return tuple(self.why(each) for each in self._actuators.names())
        held = self._actuators.channel(name).why()
        protections = self._actuators.protections.of(name)
        holds = {each.component for each in protections if not each.guards}
        writers = sorted(
            (
                r
                for r in self._registrations.of_resource(name)
                if Access.WRITE in r.access
            ),
            key=lambda each: (-each.priority, each.behavior),
        )
        return held._replace(
            writers=tuple(
                f"{each.behavior} writes with priority {each.priority}; when blind: "
                f"{'safe' if each.behavior in holds else 'release'}"
                for each in writers
            ),
            guards=tuple(each.describe() for each in protections),
        )

    def is_ready(self, name: str) -> bool:
        """Tell whether a resource is there, and its device is ready."""
        life = self._lives.get(name)
        return (
            life is not None
            and life.channel.state is ResourceState.READY
            and name not in self._leaving
        )

    # What the user may do.

    async def add(
        self, component: Resource | minimal.Sensor | minimal.Actuator
    ) -> None:
        """Deploy a resource while everything else keeps running.

        Returns when the device was tried once. A device that is not there does not
        matter: it is LOST, and comes when it comes, unless it is ``required``.

        Raises:
            ConfigError: It is declared wrongly.
            NameTakenError: The name is in use.
            DeviceLostError: It is required, and not there.
            StoppingError: The robot is not running.
        """
        resource: Resource = adapt_resource(component)

        life: ResourceLife | None = None

        async def deploy() -> ResourceLife:
            nonlocal life
            self._refuse(examine_resource(self._plan(resource), resource))
            life = self._deploy(resource)
            return life

        title = f"add {resource!r:.80}"
        await self._departed(getattr(resource, "name", ""))
        try:
            deployed = await self._command_queue.run(deploy, name=title, undo=True)
            await asyncio.shield(deployed.tried)
        except BaseException:
            # Undone, unless somebody has taken it away meanwhile.
            if life is not None and self._lives.get(resource.name) is life:
                self._depart(resource.name)
                until = self._deadline()
                undoing = self._apart(self._leave(resource.name, life, until), title)
                await asyncio.wait({undoing})
            raise
        self.journal.publish(Kind.ADDED, resource.name, "resource")

    async def remove(self, name: str) -> None:
        """Take a resource away; nobody needs to agree.

        An actuator is made safe first. Every registration for it becomes void in
        one step, and whoever reads or waits gets `ResourceRemovedError` at once.

        Raises:
            UnknownNameError: No resource has the name.
            StoppingError: The robot is not running.
        """
        until = self._deadline()

        title = f"remove {name}"

        async def fence() -> asyncio.Task[None] | None:
            life = self._life(name)
            if name in self._departures:
                return None
            self._depart(name)
            self._fence(name)
            return self._apart(self._leave(name, life, until), title)

        await self._fenced(name, fence, title)

    async def restart(self, name: str) -> None:
        """Close a device and open it again, also one that has failed for good.

        It returns when the device was tried once; its budget of restarts is full again.

        Raises:
            UnknownNameError: No resource has the name.
            StoppingError: The robot is not running.
        """

        async def begin() -> ResourceLife | None:
            life = self._life(name)
            if name in self._departures:
                return None
            life.restart()
            return life

        life = None
        while life is None:
            await self._departed(name)  # what goes is not begun again
            life = await self._command_queue.run(
                begin, name=f"restart {name}", undo=False
            )
        await asyncio.shield(life.tried)

    async def replace(
        self, name: str, component: Resource | minimal.Sensor | minimal.Actuator
    ) -> None:
        """Put another resource in the place of one, under the same name.

        Registrations go on if the new one is of the same kind and type; the others
        become void.

        Raises:
            UnknownNameError: No resource has the name.
            ConfigError: The new one is declared wrongly.
            StoppingError: The robot is not running.
        """
        resource: Resource = adapt_resource(component)

        until = self._deadline()

        title = f"replace {name}"

        async def fence() -> asyncio.Task[ResourceLife] | None:
            old = self._life(name).resource
            if name in self._departures:
                return None
            if isinstance(resource, Resource) and not in_use(resource):
                resource._name = check_name("resource", name)  # noqa: SLF001 - a supervisor gives names
            plan = self._plan(resource, without=old)
            self._refuse(examine_resource(plan, resource, instead_of=old))
            keep = _kind(old) is _kind(resource) and same_type(
                resource.value_type, old.value_type
            )
            self._depart(name)
            channel = self._lives[name].channel
            if not keep:
                self._fence(name)
            elif isinstance(channel, ActuatorChannel):
                channel.leaving(DeviceLostError(name, "it is being replaced"))
            work = self._exchange(name, resource, keep=keep, until=until)
            return self._apart(work, title)

        life = await self._fenced(name, fence, title)
        await asyncio.shield(life.tried)

    async def _exchange(
        self, name: str, resource: Resource, *, keep: bool, until: float
    ) -> ResourceLife:
        """Put a resource in the place of one that is fenced off."""
        life = self._lives[name]
        channel = life.channel
        try:
            await self._make_safe(name, until)
            if keep:
                error = DeviceLostError(name, "it is being replaced")
                channel.down(ResourceState.LOST, error)
            else:
                channel.removed()
            await life.stop(until)
            if keep:
                channel.attach(resource)  # type: ignore[arg-type]
                new = self._deploy(resource, channel)
            else:
                self._forget(name, ResourceState.REMOVED)
                new = self._deploy(resource)
            self.journal.publish(Kind.ADDED, name, "resource", resource, "in its place")
            return new
        finally:
            self._has_departed(name)

    # How a resource goes: fenced in one step, then closed outside the command queue.

    def _deadline(self) -> float:
        """Until when a command of the user that begins now may wait, in all."""
        return asyncio.get_running_loop().time() + self._grace

    def _depart(self, name: str) -> None:
        self._departures[name] = asyncio.get_running_loop().create_future()

    async def _departed(self, name: str) -> None:
        """Wait until what has the name now, and is going, has gone."""
        while (departure := self._departures.get(name)) is not None:
            await asyncio.shield(departure)

    async def _fenced(
        self,
        name: str,
        fence: Callable[[], Coroutine[Any, Any, asyncio.Task[T] | None]],
        title: str,
    ) -> T:
        """Fence a resource off in one step, and wait for what that has begun."""
        while True:
            await self._departed(name)
            begun = await self._command_queue.run(fence, name=title, undo=False)
            if begun is not None:  # else another command for the name was first
                return await self._join(begun)

    def _has_departed(self, name: str) -> None:
        self._leaving.discard(name)
        departure = self._departures.pop(name, None)
        if departure is not None:
            departure.set_result(None)

    def _fence(self, name: str) -> None:
        """From now on nobody has, or gets, a right to what goes."""
        self._leaving.add(name)
        for registration in self._registrations.of_resource(name):
            self._registrations.revoke(registration, lambda: ResourceRemovedError(name))

    async def _leave(self, name: str, life: ResourceLife, until: float) -> None:
        """Make a resource safe, close it, and forget it; bounded."""
        try:
            await self._make_safe(name, until)
        finally:
            try:
                if self._lives.get(name) is life:
                    await self._undeploy(name, ResourceState.REMOVED, until)
            finally:
                self._has_departed(name)
        self.journal.publish(Kind.REMOVED, name, "resource")

    def _apart(self, work: Coroutine[Any, Any, T], title: str) -> asyncio.Task[T]:
        """Do what takes a while, outside the command queue, and to its end."""
        task = spawn(asyncio.get_running_loop(), work, name=title)
        self._works.add(task)
        task.add_done_callback(self._done)
        return task

    def _done(self, task: asyncio.Task[Any]) -> None:
        self._works.discard(task)
        if not task.cancelled():
            task.exception()  # its caller may have gone

    async def _join(self, task: asyncio.Task[T]) -> T:
        try:
            return await asyncio.shield(task)
        except asyncio.CancelledError:
            if task.cancelled():
                raise StoppingError("resources", self.phase.value) from None
            raise

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
        user = behavior.name if isinstance(behavior, abc.Component) else behavior
        used = resource.name if isinstance(resource, abc.Component) else resource
        return self.grant(user, used, access, priority=priority, hold=hold)

    def grant(
        self,
        behavior: str,
        resource: str,
        access: Access,
        *,
        priority: int = 0,
        hold: float | None = None,
        instead_of: str | None = None,
    ) -> Registration:
        """Do what `register` does, in one step without an await."""
        if self._command_queue.phase is SupervisorPhase.STOPPED:
            raise StoppingError("resources", self._command_queue.phase.value)
        check_name("behavior", behavior)
        if resource not in self._lives:
            raise UnknownNameError("resource", resource, self._lives)
        if resource in self._leaving:
            raise ResourceRemovedError(resource)
        _check_terms(behavior, resource, access, priority, hold)
        self.rules.check(
            behavior,
            resource,
            access,
            priority,
            is_actuator=resource in self._actuators.channels,
            instead_of=instead_of,
        )
        known = None
        if instead_of is None:
            known = self._registrations.find(behavior, resource, access, priority, hold)
        return known or self._registrations.issue(
            behavior, resource, access, priority=priority, hold=hold
        )

    def admit(
        self, principal: str, resource: str, access: Access, *, priority: int = 0
    ) -> Registration:
        """Register somebody who is no component: people rank above the rules.

        Raises:
            UnknownNameError: No resource has the name.
            ResourceRemovedError: It is about to go.
            StoppingError: The robot is stopping.
        """
        if self._command_queue.phase is SupervisorPhase.STOPPED:
            raise StoppingError("resources", self._command_queue.phase.value)
        if resource not in self._lives:
            raise UnknownNameError("resource", resource, self._lives)
        if resource in self._leaving:
            raise ResourceRemovedError(resource)
        return self._registrations.issue(principal, resource, access, priority=priority)

    def revoke(
        self, registration: Registration, reason: Callable[[], EsairError] | None = None
    ) -> None:
        """Make a registration void in one step; its actuator is made safe."""
        if self._registrations.revoke(registration, reason):
            life = self._lives.get(registration.resource)
            if life is not None:
                life.channel.drop(registration)

    async def configure(self, registration: Registration, /, **settings: Any) -> None:
        """Change settings of a resource: all of them, or none.

        Args:
            registration: A registration with the CONFIGURE right.
            **settings: New values by name.

        Raises:
            NotRegisteredError: The registration is not valid.
            AccessDeniedError: It does not include CONFIGURE.
            BadValueError: A setting is unknown or a value is not allowed; every
                mistake is named, nothing was changed.
            DeviceLostError: The device is not there.
            DeviceFaultError: The device did not take it; it was put back.
            DriverStuckError: The device did not answer in time; it was put back.
        """
        life = self._configurable(registration)
        check_settings(life.resource, settings)
        task = spawn(
            asyncio.get_running_loop(),
            self._configure(registration, settings),
            name=f"configure {registration.resource}",
        )
        task.add_done_callback(lambda done: done.cancelled() or done.exception())
        await asyncio.shield(task)

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
            UnknownNameError: The resource has no such operation.
            BadValueError: A parameter is unknown, missing, or not allowed; every
                mistake is named.
            BusyError: Too many operations wait.
            DeviceLostError: The device is not there, or went away.
            DeviceFaultError: The device answered wrongly.
            DriverStuckError: It did not end within its deadline.
        """
        life = self._configurable(registration, operates=True)
        return await operate(life, registration, name, parameters)

    def _configurable(
        self, registration: Registration, *, operates: bool = False
    ) -> ResourceLife:
        if (
            not isinstance(registration, Registration)
            or self._registrations.live.get(registration.number) is not registration
        ):
            raise self._registrations.refusal(registration)
        if Access.CONFIGURE not in registration.access:
            raise AccessDeniedError(
                registration.behavior,
                registration.resource,
                str(Access.CONFIGURE),
                f"it is registered to {registration.access} only",
            )
        life = self._life(registration.resource)
        if operates and self._registrations.halt is not None:
            raise HaltedError(life.resource.name, self._registrations.halt.reason)
        if life.channel.state is not ResourceState.READY:
            raise life.channel.error or DeviceLostError(registration.resource)
        return life

    async def _configure(
        self, registration: Registration, settings: dict[str, Any]
    ) -> None:
        life = self._configurable(registration)
        async with life.configuring:
            if self._configurable(registration) is not life:
                raise DeviceLostError(registration.resource, "it was replaced")
            changes = check_settings(life.resource, settings)
            await life.configure(changes)
            self.journal.publish(
                Kind.CONFIGURED,
                registration.resource,
                registration.behavior,
                shown(life.resource, changes),
            )

    # What the robot does at its start and stop.

    def plan(self, behaviors: Sequence[Any]) -> Plan:
        """Return what this robot is made of now, with some behaviors."""
        return Plan(
            resources=[life.resource for life in self._lives.values()],
            behaviors=behaviors,
            policies=tuple(self.rules.policies.values()),
            writers=self.rules.writers(),
        )

    def wake(self) -> None:
        """Let commands of the user wait from now on: the robot starts."""
        self._command_queue.wake()

    async def start(self, resources: Iterable[Resource]) -> None:
        """Deploy the configuration list; returns when each device was tried once.

        Raises:
            ExceptionGroup: Devices that are required are not there.
        """
        for resource in resources:
            self._deploy(resource)
        errors: list[Exception] = []
        for life in tuple(self._lives.values()):
            try:
                await life.tried
            except Exception as error:
                errors.append(error)
        if errors:
            raise ExceptionGroup("required devices are not there", errors)
        self._command_queue.initialized()

    def latch(self) -> None:
        """Let nothing but safe commands leave from now on, and revoke all rights."""
        for registration in self._registrations:
            self._registrations.revoke(
                registration, lambda: StoppingError("robot", "stopping")
            )
        for channel in self._actuators.channels.values():
            channel.latch()

    def resumed(self, slept: float) -> None:
        """The computer slept: no reading is current, and nothing moves as before.

        Args:
            slept: For how long, in seconds.
        """
        for sensor in self._sensors.channels.values():
            sensor.forget_age()
        for actuator in self._actuators.channels.values():
            if actuator.state is ResourceState.READY:
                actuator.make_safe()

    async def rearm(self) -> None:
        """Have everything watched that is open: there is a new watchdog process."""
        for life in tuple(self._lives.values()):
            if life.watch is not None and life.channel.state is ResourceState.READY:
                await life.watch.arm()

    async def make_safe(self) -> list[LastCommand]:
        """Send every actuator its safe command, whatever was sent before.

        Returns:
            What each actuator was told, and whether it answered.
        """
        await asyncio.gather(
            *(self._make_safe(name) for name in self._actuators.channels)
        )
        return [channel.told() for channel in self._actuators.channels.values()]

    async def stop(self) -> None:
        """Close every device, all at the same time; each has a deadline."""
        await self._command_queue.close()
        until = self._deadline()
        for task in tuple(self._works):
            task.cancel()
        if self._works:
            await asyncio.wait(tuple(self._works), timeout=self._grace)
        closed = ResourceState.CLOSED
        await asyncio.gather(
            *(self._undeploy(name, closed, until) for name in tuple(self._lives))
        )

    # Inside.

    def _counted(self) -> Iterator[tuple[str, Mapping[str, int]]]:
        for name, life in self._lives.items():
            yield name, life.channel.counts()
            yield name, {"losses": life.losses, "faults": life.faults}
        for bus in self.buses:
            yield f"bus {bus.name}", bus.stats.counts()

    def _life(self, name: str) -> ResourceLife:
        life = self._lives.get(name)
        if life is None:
            raise UnknownNameError("resource", name, self._lives)
        return life

    def _plan(self, new: Any, without: Resource | None = None) -> Plan:
        there = [life.resource for life in self._lives.values()]
        return Plan(resources=[*(each for each in there if each is not without), new])

    @staticmethod
    def _refuse(found: list[Finding]) -> None:
        refuse(found, "the resource is described wrongly")

    def _deploy(
        self, resource: Resource, channel: SensorChannel | ActuatorChannel | None = None
    ) -> ResourceLife:
        loop = asyncio.get_running_loop()
        restart = getattr(resource, "restart", None)

        def on_error(error: Exception) -> None:
            current = self._lives.get(resource.name)
            if current is not None:
                current.on_error(error)

        if resource.bus is not None and resource.bus not in self.buses:
            self.buses.append(resource.bus)
        if channel is None:
            if isinstance(resource, Actuator):
                channel = ActuatorChannel(
                    resource, self._registrations, loop, on_error, self._left
                )
                self._actuators.channels[resource.name] = channel
                self._actuators.protections.appear(resource.name)
            else:
                assert isinstance(resource, Sensor)
                channel = SensorChannel(
                    resource, self._registrations, loop, on_error, self._left
                )
                self._sensors.channels[resource.name] = channel
        life = ResourceLife(
            resource,
            channel,
            restart if isinstance(restart, Restart) else Restart(),
            self.watchdog,
        )
        self._lives[resource.name] = life
        life.start()
        return life

    async def _make_safe(self, name: str, until: float = math.inf) -> None:
        channel = self._actuators.channels.get(name)
        if channel is None:
            return
        if channel.state is not ResourceState.READY:
            await self._lives[name].last_try(until)
            return
        channel.make_safe()
        await channel.safe_now(until)

    async def _undeploy(self, name: str, state: ResourceState, until: float) -> None:
        life = self._lives[name]
        if state is ResourceState.REMOVED:
            life.channel.removed()
        else:
            life.channel.down(state, StoppingError(name, "closed"))
        await life.stop(until)
        if isinstance(life.channel, ActuatorChannel):
            life.channel.closed()
        self._forget(name, state)

    def _forget(self, name: str, state: ResourceState) -> None:
        life = self._lives.pop(name)
        life.channel.state = state
        if state is ResourceState.REMOVED:
            self._sensors.channels.pop(name, None)
            self._actuators.channels.pop(name, None)


def _kind(resource: Resource) -> type:
    return Actuator if isinstance(resource, Actuator) else Sensor


def _check_terms(
    behavior: str, resource: str, access: Access, priority: int, hold: float | None
) -> None:
    if not isinstance(access, Access):
        raise ConfigError(
            behavior, resource, f"expected an esair.Access, not {access!r:.80}"
        )
    if type(priority) is not int:
        raise ConfigError(
            behavior,
            f"{resource}.priority",
            f"expected a whole number, not {priority!r:.80}",
        )
    if hold is not None and not is_positive(hold):
        raise ConfigError(
            behavior, f"{resource}.hold", f"expected seconds > 0, not {hold!r:.80}"
        )
