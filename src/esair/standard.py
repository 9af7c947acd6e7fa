"""ESAIR STD: the robot, its four resident objects, and their order of start and stop."""

from __future__ import annotations

import asyncio
import gc
import logging
from collections.abc import Callable, Iterable
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

import anyio

from esair import minimal
from esair.actions import Behavior, Reaction, adapt_action
from esair.connections import (
    ActuatorConnection,
    LastCommand,
    Registrations,
    SensorConnection,
)
from esair.exceptions import (
    ConfigError,
    EsairError,
    NameTakenError,
    StoppingError,
)
from esair.journal import Journal, LogLines
from esair.loop import (
    GLANCE,
    Job,
    OwnedTasks,
    Scheduler,
    SignalWatch,
    freeze_garbage,
    spawn,
    unfreeze_garbage,
)
from esair.messages import Policy
from esair.resources import Resource, adapt_resource
from esair.supervisors import BehaviorSupervisor, ResourceSupervisor
from esair.values import check_name, check_seconds

if TYPE_CHECKING:
    from pathlib import Path

    from esair.buses import Bus

BUS_TIMEOUT = 2.0
"""How long a bus may take to open or to close, in seconds."""

_log = logging.getLogger("esair")


class Robot:
    """A robot: its resources, its behaviors, and the four objects between them.

    It is an async context manager. Entering it runs the initialization phase;
    leaving it stops everything in the reverse order, and every actuator reaches
    its safe command, whatever the reason for leaving is: the end of the block, an
    exception, a cancellation, SIGINT, SIGTERM or SIGHUP.

    Args:
        name: The name of the robot.
        resources: The sensors and actuators to deploy.
        behaviors: The behaviors and reactions to deploy.
        policies: Who may do what with which resource.
        grace: How long a component may take to end when it is removed, in seconds.

    Attributes:
        resources: The resource supervisor (RS).
        behaviors: The behavior supervisor (BS).
        sensors: The sensor connection (SC).
        actuators: The actuator connection (AC).
        journal: What happens, event by event, and all counters.

    Example:
        >>> async with esair.Robot(resources=[sonar, wheels], behaviors=[Wander()]):
        ...     await asyncio.sleep(60.0)
    """

    def __init__(
        self,
        *,
        name: str = "robot",
        resources: Iterable[Resource | minimal.Sensor | minimal.Actuator] = (),
        behaviors: Iterable[Behavior | Reaction | minimal.Reaction] = (),
        policies: Iterable[Policy] = (),
        grace: float = 1.0,
    ) -> None:
        self.name = check_name("robot", name)
        self._grace = check_seconds(f"robot {name!r}", "grace", grace)
        # What was written for a microcontroller runs here as well, in an adapter.
        self._list_of_resources: list[Any] = [adapt_resource(r) for r in resources]
        self._list_of_behaviors: list[Any] = [adapt_action(b) for b in behaviors]
        self.sensors = SensorConnection()
        self.actuators = ActuatorConnection()
        self.journal = Journal()
        registrations = Registrations(self.journal)
        self.resources = ResourceSupervisor(
            self.sensors,
            self.actuators,
            registrations,
            policies=policies,
            declared=lambda behavior, resource: self.behaviors.declared(
                behavior, resource
            ),
            grace=self._grace,
        )
        self.behaviors = BehaviorSupervisor(
            self.resources, self.sensors, self.actuators, grace=self._grace
        )
        self.stopped: tuple[LastCommand, ...] = ()
        """After the stop: what each actuator was told last, and whether it answered."""
        self._buses: list[Bus] = []
        self._entered = False
        self._signal: int | None = None
        self._host: asyncio.Task[Any] | None = None
        self._interrupts = False
        self._watch = SignalWatch(self._end_by_signal, self._hurry)
        self._owned: OwnedTasks | None = None
        self._glances: Job | None = None
        self._log_lines: LogLines | None = None

    @classmethod
    def from_config(cls, path: str | Path, *, simulated: bool = False) -> Self:
        """Make a robot from a configuration file; nothing is opened yet.

        Args:
            path: A TOML file.
            simulated: Take the ``sim`` table of each device instead of the device.

        Raises:
            ExceptionGroup: A `ConfigError` for each mistake in the file, with the
                key and what was expected.
        """
        from esair.config import load_robot

        return load_robot(path, cls, simulated=simulated)

    async def __aenter__(self) -> Self:
        if self._entered:
            raise StoppingError(
                f"robot {self.name!r}", "used already: make another one"
            )
        self._refuse_mistakes()
        self._entered = True
        self.resources.wake()
        self.behaviors.wake()
        loop = asyncio.get_running_loop()
        self._host = asyncio.current_task()
        self.journal.start(loop)
        self._log_lines = LogLines(self.journal)
        self._log_lines.start()
        self._watch.start(interrupts=self._interrupts)
        self._owned = OwnedTasks(loop)
        self._owned.install()
        Scheduler.of(loop).suspends.listen(self.resources.resumed)
        if not getattr(loop, "virtual", False):  # there it would hide a deadlock
            self._glances = Scheduler.of(loop).every(GLANCE, lambda _now: None)
        try:
            await self._open_buses()
            await self.resources.start(self._list_of_resources)
            await self.behaviors.start(self._list_of_behaviors)
        except BaseException:
            await self._stop_for_sure()
            if self._signal is not None:
                raise SystemExit(128 + self._signal) from None
            raise
        freeze_garbage()
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        unfreeze_garbage()
        cancelled = await self._stop_for_sure()
        if self._signal is not None:
            raise SystemExit(128 + self._signal)
        if cancelled and error is None:
            raise asyncio.CancelledError

    async def ended(self) -> None:
        """Wait until every deliberative behavior has ended.

        A robot with reactions alone never ends by itself.

        Raises:
            BehaviorFailedError: One has failed for good (the first one, if several).
        """
        await self.behaviors.all_ended()
        for failed in self.behaviors.failures():
            raise failed

    # Inside.

    def _refuse_mistakes(self) -> None:
        """Raise every mistake of the developer at once, before anything is opened."""
        found: list[EsairError] = []
        found.extend(self.resources.mistakes(self._list_of_resources))
        found.extend(_repeated("resource", self._list_of_resources))
        found.extend(_repeated("behavior", self._list_of_behaviors))
        resources: dict[str, Resource] = {}
        for resource in self._list_of_resources:
            try:
                resources[resource.name] = resource
            except (EsairError, AttributeError):
                continue  # reported above
        found.extend(self.behaviors.mistakes(self._list_of_behaviors, resources))
        names = [name for each in self._list_of_behaviors if (name := _name_of(each))]
        found.extend(self.resources.rules.mistakes(resources, names))
        if found:
            raise ExceptionGroup(f"robot {self.name!r} cannot start", found)

    async def _open_buses(self) -> None:
        for resource in self._list_of_resources:
            if resource.bus is not None and resource.bus not in self._buses:
                self._buses.append(resource.bus)

        async def open_bus(bus: Bus) -> None:
            # One that is not there is tried again by the devices on it.
            try:
                with anyio.fail_after(BUS_TIMEOUT):
                    await bus.open()
            except Exception as error:
                _log.debug("bus %s: %s", bus.name, error)

        async with anyio.create_task_group() as group:
            for bus in self._buses:
                group.start_soon(open_bus, bus)

    async def _stop_for_sure(self) -> bool:
        """Stop, whoever cancels meanwhile; tells whether somebody did."""
        stopping = spawn(
            asyncio.get_running_loop(), self._stop(), name=f"stop {self.name}"
        )
        cancelled = False
        while not stopping.done():
            try:
                await asyncio.shield(stopping)
            except asyncio.CancelledError:
                cancelled = True
                self._hurry()
            except Exception:
                _log.exception("robot %s: the stop met an error", self.name)
        return cancelled

    async def _stop(self) -> None:
        self.behaviors.halt()
        self.resources.latch()
        try:
            await self.behaviors.stop()
            self.stopped = tuple(await self.resources.make_safe())
            for told in self.stopped:
                good = told.safe and told.answered
                _log.log(logging.INFO if good else logging.ERROR, "stop: %s", told)
        finally:
            await self.resources.stop()
            await self._close_buses()
            Scheduler.of(asyncio.get_running_loop()).suspends.forget(
                self.resources.resumed
            )
            if self._glances is not None:
                self._glances.stop()
            if self._owned is not None:
                self._owned.uninstall()
            self._watch.stop()
            if self._log_lines is not None:
                self._log_lines.stop()
            self.journal.close()

    async def _close_buses(self) -> None:
        buses = {*self._buses, *self.resources.buses}

        async def close_bus(bus: Bus) -> None:
            with anyio.move_on_after(BUS_TIMEOUT):
                try:
                    await bus.close()
                except Exception as error:
                    _log.warning("bus %s: close: %s", bus.name, error)

        async with anyio.create_task_group() as group:
            for bus in sorted(buses, key=lambda bus: bus.name):
                group.start_soon(close_bus, bus)

    def _end_by_signal(self, number: int) -> None:
        self._signal = number
        if self._host is not None:
            self._host.cancel()

    def _hurry(self) -> None:
        """Somebody is impatient: no more grace for components; safe comes first still."""
        self.behaviors.grace = 0.0


def run(
    robot: Robot,
    *,
    duration: float | None = None,
    loop_factory: Callable[[], asyncio.AbstractEventLoop] | None = None,
) -> None:
    """Run a robot until its behaviors have ended, or until a signal.

    SIGINT (Ctrl-C), SIGTERM and SIGHUP stop it in order, with every actuator safe;
    the program then exits with 128 plus the number of the signal. A second signal
    shortens the stop, a third one ends the program at once.

    Args:
        robot: What to run.
        duration: Stop after this many seconds.
        loop_factory: Makes the event loop, such as ``uvloop.new_event_loop``;
            asyncio's own unless given.

    Raises:
        ConfigError: It is no robot, or an event loop is running already.
        ExceptionGroup: The robot cannot start; every mistake is named.
        BehaviorFailedError: A behavior has failed for good.
        SystemExit: A signal came.
    """
    if not isinstance(robot, Robot):
        raise ConfigError("run", "robot", f"expected an esair.Robot, not {robot!r:.80}")
    if asyncio._get_running_loop() is not None:  # noqa: SLF001 - it does not raise
        raise ConfigError(
            "run", "", "an event loop is running: write 'async with robot:' in it"
        )
    if duration is not None:
        check_seconds(f"robot {robot.name!r}", "duration", duration)
    gc.collect()

    async def main() -> None:
        robot._interrupts = True  # noqa: SLF001 - run is the robot's own entry
        async with robot:
            with anyio.move_on_after(duration):
                await robot.ended()

    with asyncio.Runner(loop_factory=loop_factory) as runner:
        runner.run(main())


def _repeated(
    kind: str, components: Iterable[Resource | Behavior | Reaction]
) -> list[EsairError]:
    seen: set[str] = set()
    found: list[EsairError] = []
    for component in components:
        name = _name_of(component)
        if name is None:
            continue
        if name in seen:
            found.append(NameTakenError(kind, name))
        seen.add(name)
    return found


def _name_of(component: Resource | Behavior | Reaction) -> str | None:
    try:
        return component.name
    except (EsairError, AttributeError):
        return None  # reported elsewhere
