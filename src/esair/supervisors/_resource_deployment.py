"""What resources a robot has now: how each comes, goes, and is replaced; and their buses."""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from esair.actions import Derived
from esair.connections import (
    ActuatorChannel,
    ActuatorConnection,
    BeingReplacedError,
    Call,
    Control,
    DerivedChannel,
    LastCommand,
    OfRobot,
    Registrations,
    SensorChannel,
    SensorConnection,
)
from esair.exceptions import (
    DeviceLostError,
    ResourceRemovedError,
    StoppingError,
    UnknownNameError,
    describe,
)
from esair.journal import Journal, Kind
from esair.loop import outside, spawn, wake
from esair.messages import (
    Modes,
    Policy,
    ResourceState,
    is_placed,
)
from esair.plan import UNWATCHED, Plan, depths, when_alone, when_dead
from esair.resources import APPLIED, Actuator, Resource, Sensor
from esair.supervisors._command_queue import CommandQueue
from esair.supervisors._control_path import ControlPath, Declared
from esair.supervisors._life import side_by_side
from esair.supervisors._resource_life import DerivedOpener, Opener, ResourceLife

if TYPE_CHECKING:
    from esair.buses import Bus
    from esair.placement import Seat, Seats
    from esair.supervisors._watching import Armory, Watch


BUS_TIMEOUT = 2.0  # how long a bus may take to open or to close, in seconds
AT_LEAST = 0.02  # how long it takes to tell one that goes, however late, in seconds

_log = logging.getLogger("esair")


async def on_buses(
    buses: Iterable[Bus],
    verb: str,
    *,
    within: float = BUS_TIMEOUT,
    unless: Callable[[Bus], bool] = lambda _: False,
) -> None:
    """Open or close buses, whatever state they are in; each has so many seconds.

    One that cannot be opened is tried again by the devices on it. Whether one is to be
    left alone is asked in the very step in which it would be opened or closed.
    """
    level = logging.DEBUG if verb == "open" else logging.WARNING

    async def one(bus: Bus) -> None:
        async def work() -> None:
            if not unless(bus):
                await getattr(bus, verb)()

        try:
            async with asyncio.timeout(within):
                await outside((bus.name, f"{verb} the bus"), work)
        except Exception as error:
            _log.log(level, "bus %s: %s: %s", bus.name, verb, describe(error))

    # Whatever factory of tasks the loop has.
    loop, in_order = asyncio.get_running_loop(), sorted(buses, key=lambda b: b.name)
    tasks = (spawn(loop, one(bus), name="esair bus") for bus in in_order)
    await asyncio.gather(*tasks, return_exceptions=True)


STOP_WITHIN = 1.8
"""How long a stop may take beside the grace period until all is closed, in seconds:
less than `run` has, for what cannot be hurried."""

SAFE_WITHIN = 1.5
"""How long it may take of that until each actuator has answered, in seconds: then it is
told which have not, whatever their deadlines."""


class ResourceDeployment:
    """The resources of one robot: it starts and stops them, RS adds and removes some."""

    def __init__(
        self,
        sensors: SensorConnection,
        actuators: ActuatorConnection,
        registrations: Registrations,
        *,
        policies: Iterable[Policy],
        declared: Declared,
        modes: Modes,
        grace: float,
    ) -> None:
        self.sensors = sensors
        self.actuators = actuators
        self.registrations = registrations
        self.commands: CommandQueue = CommandQueue("resources", asleep=True)
        self.lives: dict[str, ResourceLife] = {}
        self._derived: dict[str, DerivedOpener] = {}
        self.leaving: set[str] = set()
        """What is being taken away: nobody gets a right to it."""
        self.control: ControlPath = ControlPath(self, policies, declared)
        self.plan: Plan = Plan(
            policies=tuple(self.control.policies.values()),
            modes=modes,
            writers=self.control.writers_of,
        )
        """This robot as the rulebook sees it, with its actions: always as it is now."""
        path = Control(self.control.configure, self.control.operate)
        sensors.control = actuators.control = path
        self._grace = grace
        self._stops_since = math.inf
        self._latched = False  # the robot stops: nothing but safe commands leaves
        self._departures: dict[str, asyncio.Future[None]] = {}
        self.left: set[Call] = set()
        """The driver calls that were given up, and whose code still runs."""
        self.mode: Callable[[], str | None] = lambda: None
        """Tells in which mode the robot is; set by its behaviors."""
        self.seed = 0
        """What the random numbers of its components begin with; set by the robot."""
        self.began: float = 0.0
        """When the robot has started, in seconds of the loop's clock."""
        self.armory: Armory | None = None
        """The second process that makes safe what this one cannot; the robot's."""
        self.buses: list[Bus] = []
        """Every bus that a resource of this robot is or was on."""
        self.journal: Journal = registrations.journal
        self._seats: Seats | None = None
        """The places of those that live in processes of their own, if there are any."""
        self.journal.count("resources", self._counted)

    def life(self, name: str) -> ResourceLife:
        life = self.lives.get(name)
        if life is None:
            raise UnknownNameError("resource", name, self.lives)
        return life

    def is_ready(self, name: str) -> bool:
        """Tell whether a resource is there, and its device is ready."""
        life = self.lives.get(name)
        return (
            life is not None
            and life.channel.state is ResourceState.READY
            and name not in self.leaving
        )

    def dies(self, name: str) -> str:
        """Say what becomes of an actuator when this process dies, or this computer."""
        life = self.life(name)
        assert isinstance(life.resource, Actuator)
        watch = life.device.watch
        why = "the robot has no watchdog" if watch is None else watch.why
        process = when_dead(life.resource, why and f"{UNWATCHED}, {why}")
        alone = when_alone(life.resource)
        return f"when this process dies: {process}; when this computer dies: {alone}"

    def resting_writers(self, name: str) -> tuple[str, ...]:
        """Say who would write an actuator in another mode than this one."""
        modes, now_in = self.plan.modes, self.mode()
        return tuple(
            f"{writer} rests in mode {now_in}: it runs in "
            f"{', '.join(modes.of_behavior(writer))}"
            for writer in (self.plan.writes_of(name) if modes.table else ())
            if not modes.runs(writer, now_in)
        )

    # How one comes.

    def deploy(
        self, resource: Resource, channel: SensorChannel | ActuatorChannel | None = None
    ) -> ResourceLife:
        """Begin to open a device; with a channel: in the place of another one."""
        name = resource.name

        def on_error(error: Exception) -> None:
            current = self.lives.get(name)
            if current is not None:
                current.on_error(error)

        if resource.bus is not None and resource.bus not in self.buses:
            self.buses.append(resource.bus)
        seat = self.seat_for(resource) if is_placed(resource) else None
        if seat is not None:
            seat.sit()  # before anybody asks for its methods
        robot = OfRobot(self.registrations, on_error, self.left)
        if channel is not None:
            channel.attach(resource)  # type: ignore[arg-type]
        elif isinstance(resource, Actuator):
            channel = self.actuators.channels[name] = ActuatorChannel(resource, robot)
            self.actuators.protections.appear(name)
        else:
            assert isinstance(resource, Sensor)
            kind = DerivedChannel if resource.is_computed else SensorChannel
            channel = self.sensors.channels[name] = kind(resource, robot)
        opener = Opener(resource, channel, self.armory, seat)
        if isinstance(channel, DerivedChannel) and isinstance(resource, Derived):
            opener = self._derived[name] = DerivedOpener(resource, channel, self)
        life = self.lives[name] = ResourceLife(resource, channel, opener, seat)
        self.plan.enter_resource(resource)
        life.start()
        return life

    def came(self, name: str, resource: Resource | None = None, text: str = "") -> None:
        """Tell that a resource has come into the running robot, and let others find it."""
        self.journal.publish(Kind.ADDED, name, "resource", resource, text)
        for each in tuple(self._derived.values()):
            if each.reads(name):
                each.bind()

    # How one goes: fenced in one step, then closed while other commands go on.

    def deadline(self) -> float:
        """Until when a command of the user that begins now may wait, in all."""
        return asyncio.get_running_loop().time() + self._grace

    async def gone(self, name: str) -> None:
        """Wait until what has the name now, and is going, has gone; others do not wait."""
        while (departure := self._departures.get(name)) is not None:
            self.commands.changed()
            await asyncio.wait({departure})

    async def undo(self, life: ResourceLife) -> None:
        """Take away what was added in vain, unless somebody does so, or has done so.

        Nobody was told that it is there.
        """
        name = life.name
        if self.lives.get(name) is life and name not in self._departures:
            await self.remove(name, self.deadline())

    async def remove(self, name: str, until: float) -> None:
        """Fence a resource off in one step, make it safe, close it, and forget it."""
        self._depart(name)
        self._fence(name)
        life = self.lives[name]
        self.commands.changed()
        try:
            await self._make_safe_to_leave(name, until)
        finally:
            try:
                if self.lives.get(name) is life:
                    await self._undeploy(life, ResourceState.REMOVED, until)
                    await self._let_go(life, until)
            finally:
                self._has_departed(name)
        self.journal.publish(Kind.REMOVED, name, "resource")

    async def replace(
        self, name: str, resource: Resource, *, keep: bool, until: float
    ) -> ResourceLife:
        """Fence a resource off in one step, and put another one in its place."""
        self._depart(name)
        life = self.lives[name]
        channel = life.channel
        if not keep:
            self._fence(name)
        elif isinstance(channel, ActuatorChannel):
            channel.leaving(BeingReplacedError(name, "it is being replaced"))
        self.commands.changed()
        try:
            await self._make_safe_to_leave(name, until)
            if self.commands.is_closed:  # the stop makes it safe, for as long as it has
                raise StoppingError("resources", self.commands.phase.value)
            if keep:
                error = BeingReplacedError(name, "it is being replaced")
                channel.down(ResourceState.LOST, error)
            else:
                channel.removed()
            await life.stop(until)
            if life.seat is not None:
                life.seat.rise()
            await self._let_go(life, until, resource)
            if self.commands.is_closed:
                raise StoppingError("resources", self.commands.phase.value)
            if keep:
                new = self.deploy(resource, channel)
            else:
                self._forget(name, ResourceState.REMOVED)
                self.leaving.discard(name)  # ports that fit live again with it
                new = self.deploy(resource)
            self.came(name, resource, "in its place")
            return new
        finally:
            if self.lives.get(name) is life:
                channel.error = DeviceLostError(name, "nothing took its place")
            self._has_departed(name)

    def _depart(self, name: str) -> None:
        self._departures[name] = asyncio.get_running_loop().create_future()

    def _has_departed(self, name: str) -> None:
        self.leaving.discard(name)
        wake(self._departures.pop(name))

    def _fence(self, name: str) -> None:
        """From now on nobody has, or gets, a right to what goes."""
        self.leaving.add(name)
        for part in (name, name + APPLIED):
            for each in self.registrations.of_resource(part):
                self.registrations.revoke(each, lambda: ResourceRemovedError(name))

    async def _let_go(
        self, life: ResourceLife, until: float, new: Resource | None = None
    ) -> None:
        """Close the bus of a device that goes, unless others are on it.

        What comes next, here or in another program, may want its port.
        """
        bus = life.resource.bus

        def is_used(bus: Bus) -> bool:
            stay = [each.resource for each in self.lives.values() if each is not life]
            return any(each.bus is bus for each in (*stay, new) if each is not None)

        if bus is None or is_used(bus):
            return
        left = until - asyncio.get_running_loop().time()
        within = max(0.1, min(left, BUS_TIMEOUT))
        await on_buses([bus], "close", within=within, unless=is_used)

    async def _make_safe_to_leave(self, name: str, until: float) -> None:
        channel = self.actuators.channels.get(name)
        if channel is None:
            return
        until = max(until, channel.time() + AT_LEAST)
        channel.safe.latch(until)
        await self._make_safe(channel, until)
        if not channel.is_safe:
            _log.error("%s; it goes, and may move on", channel.told())

    async def _make_safe(self, channel: ActuatorChannel, until: float) -> None:
        if channel.state is ResourceState.READY:
            channel.make_safe()
            await channel.safe.settled(until)
        life = self.lives.get(channel.name)
        if life is not None and channel.state is not ResourceState.READY:
            await life.last_try(until)

    async def _undeploy(
        self, life: ResourceLife, state: ResourceState, until: float
    ) -> None:
        name = life.name
        if self.lives.get(name) is not life:
            return  # a command has closed it before the stop came to that
        if state is ResourceState.REMOVED:
            life.channel.removed()
        else:
            life.channel.down(state, StoppingError(name, "closed"))
        await life.stop(until)
        if self.lives.get(name) is not life:
            return  # the stop and a command have closed it at the same time
        if isinstance(life.channel, ActuatorChannel):
            life.channel.safe.close()
        self._forget(name, state)

    def _forget(self, name: str, state: ResourceState) -> None:
        life = self.lives.pop(name)
        if life.seat is not None:
            life.seat.rise()
        self.plan.leave_resource(name)
        self._derived.pop(name, None)
        life.channel.state = state
        if state is ResourceState.REMOVED:
            self.sensors.channels.pop(name, None)
            self.sensors.channels.pop(name + APPLIED, None)
            self.actuators.channels.pop(name, None)

    # What the robot does at its start and stop.

    async def start(self, resources: Sequence[Resource]) -> None:
        """Deploy the configuration list; returns when each device was tried once."""
        there = (each.bus for each in resources)
        self.buses = list(dict.fromkeys(bus for bus in there if bus is not None))
        await on_buses(self.buses, "open")
        if any(is_placed(each) for each in resources):
            self._all_seats()
        if self._seats is not None:
            await self._seats.ready()
        # What is computed of others comes when they are there.
        depth = depths(resources)
        for resource in sorted(resources, key=lambda each: depth[each.name]):
            self.deploy(resource)
        errors: list[Exception] = []
        for life in tuple(self.lives.values()):
            try:
                await life.tried
            except Exception as error:
                errors.append(error)
        if errors:
            raise ExceptionGroup("required devices are not there", errors)
        self.commands.initialized()

    def latch(self) -> None:
        """The robot stops: let nothing but safe commands leave, and revoke all rights."""
        self.commands.refuse()
        self._stops_since = asyncio.get_running_loop().time()
        for registration in self.registrations:
            self.registrations.revoke(
                registration, lambda: StoppingError("robot", "stopping")
            )
        for channel in self.actuators.channels.values():
            channel.latch()
        self._latched = True

    def is_made_safe(self) -> bool:
        """Tell, in any thread, whether the stop has told every actuator to be safe."""
        return self._latched and all(
            channel.is_safe or channel.state is not ResourceState.READY
            for channel in tuple(self.actuators.channels.values())
        )

    def resumed(self, slept: float) -> None:
        """The computer slept: no reading is current, and nothing moves as before."""
        for sensor in self.sensors.channels.values():
            sensor.forget_age()
        for actuator in self.actuators.channels.values():
            actuator.withdraw()
            if actuator.state is ResourceState.READY:
                actuator.make_safe()

    async def rearm(self) -> None:
        """Have everything watched that is open: there is a new watchdog process."""
        for life in tuple(self.lives.values()):
            watch = life.device.watch
            if watch is not None and life.channel.state is ResourceState.READY:
                await watch.arm()

    def watches(self) -> list[Watch]:
        """Return the eyes of the watchdog, one on each actuator."""
        lives = self.lives.values()
        return [life.device.watch for life in lives if life.device.watch is not None]

    async def make_safe(self) -> list[LastCommand]:
        """Send every actuator its safe command, whatever was sent before."""
        channels = tuple(self.actuators.channels.values())
        until = self._stops_since + self._grace + SAFE_WITHIN
        await side_by_side([self._make_safe(each, until) for each in channels])
        return [each.told() for each in channels]

    async def stop(self) -> None:
        """Close every device, all at the same time; each has a deadline; then the buses."""
        self.control.closed = True
        self.actuators.protections.close()
        # Deadlines do not add up: what comes last has what is left.
        until = min(self.deadline(), self._stops_since + self._grace + STOP_WITHIN)
        await self.commands.close()
        # What the user is taking away goes its own way.
        lives, closed = self.lives, ResourceState.CLOSED
        stay = [life for name, life in lives.items() if name not in self._departures]
        ends = [self._undeploy(life, closed, until) for life in stay]
        await side_by_side([*ends, *self.commands.left(until)])
        ends = [self._undeploy(life, closed, until) for life in lives.values()]
        await side_by_side(ends)
        if self.buses:
            await on_buses(self.buses, "close")
        if self._seats is not None:
            self._seats.close()
            self._seats = None

    # Processes of their own.

    def seat_for(self, component: Any) -> Seat:
        """Return the place of a component that is to live in a process of its own."""
        return self._all_seats().seat(component)

    def _all_seats(self) -> Seats:
        if self._seats is None:
            from esair.placement import Seats

            self._seats = Seats(self._everybody, self._command_timeout)
        return self._seats

    def _everybody(self) -> Iterator[Any]:
        yield from self.plan.resource_of.values()
        yield from self.plan.action_of.values()

    def _command_timeout(self, resource: str) -> float | None:
        channel = self.actuators.channels.get(resource)
        return None if channel is None else channel.actuator.command_timeout

    # Inside.

    def _counted(self) -> Iterator[tuple[str, Mapping[str, int]]]:
        for name, life in self.lives.items():
            yield name, life.channel.counts()
            counts = {"losses": life.losses, "faults": life.faults}
            yield name, {**counts, "no_turns": life.no_turns}
            yield name, _own_counts(life.resource)
        for bound in (self.commands, self.control):
            yield "resources", {"turned_away": bound.turned_away}
        for bus in self.buses:
            yield f"bus {bus.name}", bus.stats.counts()


def _own_counts(resource: Resource) -> Mapping[str, int]:
    """Return what a driver counts, whatever its code does."""
    try:
        return {str(name): int(count) for name, count in resource.counts().items()}
    except Exception:
        return {"uncountable": 1}
