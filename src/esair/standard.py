"""ESAIR STD: the robot, its four resident objects, and their order of start and stop."""

from __future__ import annotations

import asyncio
import gc
import logging
import os
import secrets
import signal
import sys
import threading
import time
from collections.abc import Callable, Coroutine, Iterable
from types import TracebackType
from typing import TYPE_CHECKING, Any, Literal, Self, TypeVar

import anyio

from esair import minimal
from esair.actions import Behavior, Reaction, adapt_action
from esair.connections import (
    ActuatorConnection,
    Halting,
    Registrations,
    SensorConnection,
    Stopped,
)
from esair.exceptions import (
    ConfigError,
    RecordingError,
    StoppingError,
    describe,
)
from esair.journal import Journal, LogLines
from esair.loop import (
    GLANCE,
    Ending,
    Gaps,
    Job,
    OwnedTasks,
    Scheduler,
    SignalWatch,
    StallWatch,
    run_and_end,
    spawn,
    threads_that_keep_the_process,
)
from esair.messages import (
    BehaviorsPolicy,
    Operator,
    Page,
    Policy,
    Recording,
    ResourceState,
)
from esair.plan import Plan, errors_in, examine, refuse_while_looking
from esair.resources import Resource, adapt_resource
from esair.supervisors import BehaviorSupervisor, Halts, Keeper, ResourceSupervisor
from esair.values import check_name, check_seconds
from esair.watchdog import LIMIT

if TYPE_CHECKING:
    from pathlib import Path

    from esair.buses import Bus
    from esair.recording import Recorder
    from esair.seat import Seat

BUS_TIMEOUT = 2.0
"""How long a bus may take to open or to close, in seconds."""

LAST_WAIT = 2.0
"""How long `run` may take to end beside the grace period, in seconds."""

STALL_WARNING = 0.1
"""How long code may hold the event loop before it is named, in seconds."""

_log = logging.getLogger("esair")

T = TypeVar("T", bound=str)


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
        record: Where to keep what happens; needs ``esair[record]``.
        start_patience: How long ``run`` of the behaviors waits at the start for the
            first decision of each reaction and guard that can see, in seconds.
        watchdog: Whether a second process makes the actuators safe when this one is
            killed, stopped or stuck. ``esair check`` names those that it cannot reach.
        watchdog_limit: How long this process may be stuck while something moves, in s.
        watchdog_policy: What becomes of this process then: ``"kill"`` ends it,
            ``"freeze"`` leaves it stopped.
        watchdog_death: What happens when the watchdog itself dies: ``"stop"`` halts the
            robot until it is resumed, ``"alarm"`` only says so. It is started anew.
        stall_warning: Code that holds the event loop longer than this is named in the
            log while it does, in seconds; None for never. Not on a virtual clock.
        seed: What `esair.random` begins with. Unless given it is 0 on a virtual clock,
            and another one at each start elsewhere; the recording has it.
        socket: Whether it has a control socket, for ``esair top``, ``esair stop`` and
            the like; ``esair run`` and ``sim`` give it one.
        operator: What an operator may do from outside; everything unless given.
        page: Where the same is served to a browser; nowhere unless given.

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
        policies: Iterable[Policy | BehaviorsPolicy] = (),
        grace: float = 1.0,
        record: Recording | None = None,
        start_patience: float = 1.0,
        watchdog: bool = False,
        watchdog_limit: float = LIMIT,
        watchdog_policy: Literal["kill", "freeze"] = "kill",
        watchdog_death: Literal["stop", "alarm"] = "stop",
        stall_warning: float | None = STALL_WARNING,
        seed: int | None = None,
        socket: bool = False,
        operator: Operator | None = None,
        page: Page | None = None,
    ) -> None:
        self.name = check_name("robot", name)
        self.operator = Operator() if operator is None else operator
        """What an operator may do from outside."""
        self.source: tuple[Path, bool] | None = None
        """The file it was made from, and whether simulated; None if from none."""
        self._has_socket = socket
        self._page = page
        self._seat: Seat | None = None
        self._recording = record
        self._recorder: Recorder | None = None
        self._grace = check_seconds(f"robot {name!r}", "grace", grace)
        # What was written for a microcontroller runs here as well, in an adapter.
        self._list_of_resources: list[Any] = [adapt_resource(r) for r in resources]
        self._list_of_behaviors: list[Any] = [adapt_action(b) for b in behaviors]
        given: list[Any] = list(policies)
        self._list_of_policies: list[Any] = [
            each for each in given if not isinstance(each, BehaviorsPolicy)
        ]
        self.sensors = SensorConnection()
        self.actuators = ActuatorConnection()
        self.journal = Journal()
        registrations = Registrations(self.journal)
        self.resources = ResourceSupervisor(
            self.sensors,
            self.actuators,
            registrations,
            policies=self._list_of_policies,
            declared=lambda behavior, resource: self.behaviors.declared(
                behavior, resource
            ),
            grace=self._grace,
        )
        self._halts = Halts(
            name,
            self.actuators,
            registrations,
            self.journal,
            lambda: self.behaviors.forget_waiting(),
        )
        self.behaviors = BehaviorSupervisor(
            self.resources,
            self.sensors,
            self.actuators,
            grace=self._grace,
            start_patience=check_seconds(
                f"robot {name!r}", "start_patience", start_patience
            ),
            halt=self._halts.halt,
            stop=self.stop,
            command=self._typed,
        )
        self.behaviors.managers = frozenset(
            manager
            for each in given
            if isinstance(each, BehaviorsPolicy)
            for manager in each.allow
        )
        self._keeper: Keeper | None = None
        if watchdog:
            self._keeper = Keeper(
                self.resources,
                limit=check_seconds(
                    f"robot {name!r}", "watchdog_limit", watchdog_limit
                ),
                policy=_one_of(
                    name, "watchdog_policy", watchdog_policy, "kill", "freeze"
                ),
                on_death=_one_of(
                    name, "watchdog_death", watchdog_death, "stop", "alarm"
                ),
                halt=self._halts.halt,
            )
        if seed is not None and type(seed) is not int:
            raise ConfigError(
                f"robot {name!r}", "seed", f"expected a whole number, not {seed!r:.80}"
            )
        self.seed = seed
        """What `esair.random` begins with; known when the robot has started."""
        self.stopped = Stopped()
        """After the stop: what each actuator was told last, whether it answered, and
        in ``reason`` why the robot stopped."""
        self._buses: list[Bus] = []
        self._entered = False
        self._signal: int | None = None
        self._host: asyncio.Task[Any] | None = None
        self._interrupts = False
        if stall_warning is not None:
            check_seconds(f"robot {name!r}", "stall_warning", stall_warning)
        self._stall_warning = stall_warning
        self._watch = SignalWatch(self._end_by_signal, self._hurry, self._is_safe)
        self._owned: OwnedTasks | None = None
        self._stalls: tuple[StallWatch, float] | None = None
        self._glances: Job | None = None
        self._log_lines: LogLines | None = None
        self._stopping: asyncio.Task[None] | None = None
        self._reason = ""
        """Why it stops; empty until somebody says so."""
        self._is_up = False
        self._latched = False
        self._stops = asyncio.Event()

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

    @property
    def plan(self) -> Plan:
        """What this robot starts with, as the rulebook sees it."""
        return Plan(
            name=self.name,
            resources=self._list_of_resources,
            behaviors=self._list_of_behaviors,
            policies=self._list_of_policies,
        )

    async def __aenter__(self) -> Self:
        if self._entered:
            raise StoppingError(
                f"robot {self.name!r}", "used already: make another one"
            )
        if self._reason:
            raise StoppingError(
                f"robot {self.name!r}", f"stopped before its start: {self._reason}"
            )
        refuse_while_looking(self.name)
        if mistakes := errors_in(examine(self.plan)):
            raise ExceptionGroup(f"robot {self.name!r} cannot start", mistakes)
        seat = self._take_seat() if self._has_socket or self._page else None
        self._entered = True
        self.behaviors.seed = self._take_seed()
        self.resources.wake()
        self.behaviors.wake()
        loop = asyncio.get_running_loop()
        self._host = asyncio.current_task()
        if self._recording is not None:
            self._recorder = self._start_recorder(self._recording, loop)
        self.journal.start(loop)
        self._halts.start(loop)
        self._log_lines = LogLines(self.journal)
        self._log_lines.start()
        self._watch.start(interrupts=self._interrupts)
        self._owned = OwnedTasks.of(loop)
        self._owned.install()
        Scheduler.of(loop).suspends.listen(self.resources.resumed)
        for components in (self._list_of_resources, self._list_of_behaviors):
            components.sort(key=_by_name)
            Scheduler.of(loop).expect(len(components))
        if not getattr(loop, "virtual", False):  # there it would hide a deadlock
            if self._stall_warning is not None:
                self._stalls = StallWatch.of(loop), self._stall_warning
                self._stalls[0].start(self._stall_warning)
            self._glances = Scheduler.of(loop).every(GLANCE, lambda _now: None)
        try:
            if seat is not None:
                self._seat = seat
                await seat.start(self)
            self.behaviors.accept(self._list_of_behaviors)
            if self._keeper is not None:
                await self._keeper.start()
            await self._open_buses()
            await self.resources.start(self._list_of_resources)
            await self.behaviors.start()
        except BaseException as error:
            asked = self._reason
            await self._stop_for_sure(describe(error))
            if self._signal is not None:
                raise SystemExit(128 + self._signal) from None
            if asked and isinstance(error, asyncio.CancelledError):
                assert self._host is not None
                self._host.uncancel()
                raise StoppingError(
                    f"robot {self.name!r}", f"stopped: {asked}"
                ) from None
            raise
        self._is_up = True
        Gaps.of(loop).start()
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        cancelled = await self._stop_for_sure(_reason_of(error))
        if self._signal is not None:
            await self._watch.others_stopped(self._grace + LAST_WAIT)
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

    # What ends it, and what keeps it still.

    async def stop(self, reason: str = "its stop was asked for") -> Stopped:
        """Stop everything in order; every actuator reaches its safe command.

        It returns when all is done. `ended` returns then too, and so does `run`; a
        block of ``async with`` that waits for something else goes on to its own end.
        A behavior that stops the robot is itself cancelled by that. Stopped before
        its start, a robot refuses to start.

        Args:
            reason: Why, for `stopped` and the log; the first one counts.

        Returns:
            What each actuator was told last, and whether it answered.
        """
        self._reason = self._reason or reason
        if not self._entered:
            self.stopped = Stopped((), self._reason)
            return self.stopped
        if self._is_up:
            self._stop_once()
        elif self._stopping is None:  # it starts: whoever enters it stops it
            assert self._host is not None
            self._host.cancel()
        await self._stops.wait()
        while not self._stop_once().done():
            await asyncio.wait({self._stop_once()})
        return self.stopped

    def halt(self, reason: str, *, by: str = "the user") -> Halting:
        """Make every actuator safe, and keep it so until `resume`.

        A plain call, from any thread, in every state, as often as you like. When it
        returns no command but the safe one leaves any more; writes are answered with
        a `Refused` whose ``holder`` is ``"halt"`` and whose ``rule`` is the reason.
        Before the start: the robot starts halted.

        Args:
            reason: Why, for the log and for whoever writes meanwhile.
            by: Who halts, for the log.

        Returns:
            What each actuator is told and answers: await it, or, in a thread, call
            its ``result``.
        """
        return self._halts.halt(reason, by)

    def resume(self) -> None:
        """End all halts: who writes next moves. For the user alone.

        Nothing from before leaves, nobody holds anything, and each actuator starts
        from its safe command.

        Raises:
            AccessDeniedError: A behavior asks.
        """
        self._halts.resume()

    @property
    def halted(self) -> str | None:
        """Why it is halted; None if it is not."""
        return self._halts.reason

    # Inside.

    def _take_seed(self) -> int:
        if self.seed is None:
            virtual = getattr(asyncio.get_running_loop(), "virtual", False)
            self.seed = 0 if virtual else secrets.randbits(64)
        return self.seed

    def _take_seat(self) -> Seat:
        from esair.seat import Seat

        return Seat(self.name, socket=self._has_socket, page=self._page)

    async def _typed(self, text: str) -> str:
        if self._seat is None:
            if not self._is_up:
                raise StoppingError(f"robot {self.name!r}", "it does not run")
            self._seat = self._take_seat()
            await self._seat.start(self)
        return await self._seat.typed(text)

    def _start_recorder(
        self, recording: Recording, loop: asyncio.AbstractEventLoop
    ) -> Recorder | None:
        from esair.recording import Recorder, facts_about

        components = [*self._list_of_resources, *self._list_of_behaviors]
        try:
            recorder = Recorder(
                recording,
                self.journal,
                name=self.name,
                facts=facts_about(self.name, components, seed=str(self.seed)),
            )
        except RecordingError as error:
            _log.error("%s; the robot starts without it", describe(error))
            return None
        self.journal.count("recording", lambda: [("recording", recorder.counts())])
        recorder.start(loop.time())
        return recorder

    async def _open_buses(self) -> None:
        for resource in self._list_of_resources:
            if resource.bus is not None and resource.bus not in self._buses:
                self._buses.append(resource.bus)

        async def open_bus(bus: Bus) -> None:
            # One that is not there is tried again by the devices on it.
            try:
                async with asyncio.timeout(BUS_TIMEOUT):
                    await bus.open()
            except Exception as error:
                _log.debug("bus %s: %s", bus.name, describe(error))

        await _all(open_bus(bus) for bus in self._buses)

    def _stop_once(self) -> asyncio.Task[None]:
        """Begin to stop, once; again only if a stranger has cancelled it."""
        if self._stopping is None or self._stopping.cancelled():
            self._stopping = spawn(
                asyncio.get_running_loop(), self._stop(), name=f"stop {self.name}"
            )
            self._stops.set()
        return self._stopping

    async def _stop_for_sure(self, reason: str) -> bool:
        """Stop, whoever cancels meanwhile; tells whether somebody did."""
        self._reason = self._reason or reason
        cancelled = False
        # A cancel scope of anyio would cancel in every turn until the stop is done.
        with anyio.CancelScope(shield=True):
            while not (stopping := self._stop_once()).done():
                try:
                    await asyncio.shield(stopping)
                except asyncio.CancelledError:
                    # The stop itself, if the event loop ends and cancels every task.
                    cancelled = True
                    self._hurry()
                except Exception:
                    _log.exception("robot %s: the stop met an error", self.name)
        return cancelled

    async def _stop(self) -> None:
        reason = self._reason
        if self.halted is not None:
            reason = f"{reason}; halted: {self.halted}"
        _log.info("robot %s: stops: %s", self.name, reason)
        if self._is_up:
            self._is_up = False
            Gaps.of(asyncio.get_running_loop()).stop()
        self.behaviors.halt()
        self.resources.latch()
        self._latched = True
        if self._watch.last is not None:
            self._watch.last.because(time.monotonic())
        if self._seat is not None:
            self._seat.leave()
        try:
            await self.behaviors.stop()
            self.stopped = Stopped(await self.resources.make_safe(), reason)
            for told in self.stopped:
                good = told.safe and told.answered
                _log.log(logging.INFO if good else logging.ERROR, "stop: %s", told)
        finally:
            await self._halts.close()
            await self.resources.stop()
            await self._close_buses()
            if self._keeper is not None:
                await self._keeper.close()
            Scheduler.of(asyncio.get_running_loop()).suspends.forget(
                self.resources.resumed
            )
            if self._glances is not None:
                self._glances.stop()
            if self._stalls is not None:
                self._stalls[0].stop(self._stalls[1])
                self._stalls = None
            if self._owned is not None:
                self._owned.uninstall()
                self._owned = None
            self._watch.stop()
            if self._log_lines is not None:
                self._log_lines.stop()
            self.journal.close()
            if self._seat is not None:
                await self._seat.close()
            if self._recorder is not None:
                await asyncio.to_thread(self._recorder.close)

    async def _close_buses(self) -> None:
        buses = {*self._buses, *self.resources.buses}

        async def close_bus(bus: Bus) -> None:
            try:
                async with asyncio.timeout(BUS_TIMEOUT):
                    await bus.close()
            except Exception as error:
                _log.warning("bus %s: close: %s", bus.name, describe(error))

        await _all(close_bus(bus) for bus in sorted(buses, key=lambda bus: bus.name))

    def _end_by_signal(self, number: int) -> None:
        self._signal = number
        self._reason = self._reason or signal.Signals(number).name
        if self._host is not None:
            self._host.cancel()

    def _is_safe(self) -> bool:
        """Tell, in any thread, whether every actuator was told its safe command."""
        return self._latched and all(
            channel.is_safe or channel.state is not ResourceState.READY
            for channel in tuple(self.actuators.channels.values())
        )

    def _hurry(self) -> None:
        """Somebody is impatient: no more grace for components; safe comes first still."""
        self.behaviors.grace = 0.0


def run(
    robot: Robot,
    *,
    duration: float | None = None,
    loop_factory: Callable[[], asyncio.AbstractEventLoop] | None = None,
    stall_warning: float | None = STALL_WARNING,
) -> None:
    """Run a robot until its behaviors have ended, or until a signal.

    SIGINT (Ctrl-C), SIGTERM and SIGHUP stop it in order, with every actuator safe;
    the program then exits with 128 plus the number of the signal. A second signal
    shortens the stop, a third one ends the program within a second, also while code
    holds the event loop. It returns, or ends the process, at most `grace` and two
    seconds after the reason to end, whatever behaviors and threads do.

    Args:
        robot: What to run.
        duration: Stop after this many seconds.
        loop_factory: Makes the event loop, such as ``uvloop.new_event_loop``;
            asyncio's own unless given.
        stall_warning: As for `Robot`; what was said there counts unless given.

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

    if stall_warning != STALL_WARNING:
        robot._stall_warning = stall_warning  # noqa: SLF001 - run is the robot's own entry
    before = set(threading.enumerate())
    ending: Ending | None = None

    async def main() -> None:
        nonlocal ending
        loop = asyncio.get_running_loop()
        ending = Ending(loop, patience=robot._grace + LAST_WAIT)  # noqa: SLF001 - as above
        ending.start()
        robot._watch.last = ending  # noqa: SLF001 - as above
        robot._interrupts = True  # noqa: SLF001 - as above
        async with robot:
            if duration is not None:
                ending.because(time.monotonic() + duration)
            with anyio.move_on_after(duration) as scope:
                await robot.ended()
            reason = "its behaviors have ended"
            if scope.cancelled_caught:
                reason = f"it has run for {duration} s"
            robot._reason = robot._reason or reason  # noqa: SLF001 - as above

    try:
        run_and_end(main(), loop_factory)
    except SystemExit:
        if robot._signal is not None:  # noqa: SLF001 - as above
            _leave_threads(before, 128 + robot._signal)  # noqa: SLF001 - as above
        raise
    finally:
        if ending is not None:
            ending.stop()


def _leave_threads(before: set[threading.Thread], code: int) -> None:
    """End the process here if threads of the robot would keep it from ending."""
    names = threads_that_keep_the_process(before)
    if names:
        _log.warning("threads are left behind: %s", ", ".join(names))
        logging.shutdown()
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


async def _all(work: Iterable[Coroutine[Any, Any, None]]) -> None:
    """Do several things at a time, whatever factory of tasks the loop has."""
    loop = asyncio.get_running_loop()
    tasks = [spawn(loop, each, name="esair bus") for each in work]
    if not tasks:
        return
    try:
        await asyncio.wait(tasks)
    except asyncio.CancelledError:
        for task in tasks:
            task.cancel()
        await asyncio.wait(tasks)
        raise


def _reason_of(error: BaseException | None) -> str:
    if error is None:
        return "its program has left it"
    if isinstance(error, asyncio.CancelledError):
        return "it was cancelled"
    return describe(error)


def _by_name(component: Any) -> str:
    """Order components: nothing depends on the order in which they were given."""
    return str(component.name)


def _one_of(robot: str, field: str, value: T, *choices: T) -> T:
    if value in choices:
        return value
    expected = " or ".join(repr(choice) for choice in choices)
    raise ConfigError(
        f"robot {robot!r}", field, f"expected {expected}, not {value!r:.80}"
    )
