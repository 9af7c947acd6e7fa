"""ESAIR STD: the robot, its four resident objects, and their order of start and stop.

With it stand its parts: what it needs of its loop and process while it runs (`LoopCare`),
its operator's seat (`Seating`), and that none starts while a program is only looked at.
"""

from __future__ import annotations

import asyncio
import contextlib
import contextvars
import logging
import os
import signal
import time
from collections.abc import (
    Callable,
    Coroutine,
    Iterable,
    Iterator,
    Mapping,
    Sequence,
)
from typing import TYPE_CHECKING, Any, Literal, Self

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
from esair.exceptions import ConfigError, StoppingError, describe
from esair.journal import Journal, LogLines
from esair.loop import (
    GLANCE,
    Budget,
    Gaps,
    News,
    OwnedTasks,
    RealTime,
    Scheduler,
    SignalWatch,
    StallWatch,
    check_priority,
    collector,
    leave_behind,
    now,
    outside,
    spawn,
    turn_of,
)
from esair.messages import (
    BehaviorsPolicy,
    Mode,
    Modes,
    Operator,
    Page,
    Policy,
    Recording,
)
from esair.plan import Plan, errors_in, examine
from esair.resources import Resource, adapt_resource
from esair.standard._recording import Keeping, repeats
from esair.standard._service import ServiceManager
from esair.standard._told import class_of
from esair.supervisors import (
    BehaviorDeployment,
    BehaviorSupervisor,
    Halts,
    Keeper,
    ResourceDeployment,
    ResourceSupervisor,
)
from esair.values import check_choice, check_name, check_seconds, printable
from esair.watchdog import LIMIT

if TYPE_CHECKING:
    from pathlib import Path

    from esair.seat import Seat


STALL_WARNING = 0.1
"""How long code may hold the event loop before it is named, in seconds."""


class LoopCare:
    """Owns tasks, looks for stalls and sleep, and collects garbage in gaps."""

    def __init__(
        self,
        title: str,
        stall_warning: float | None,
        realtime: object,
        resumed: Callable[[float], None],
    ) -> None:
        if stall_warning is not None:
            check_seconds(title, "stall_warning", stall_warning)
        self.stall_warning = stall_warning
        self.realtime = check_priority(title, realtime)
        self._title = title
        self._resumed = resumed
        self._undo = contextlib.ExitStack()
        self._gaps: Gaps | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._service: ServiceManager | None = None

    def start(self, loop: asyncio.AbstractEventLoop, *crowds: int) -> None:
        """Begin, for so many components of each kind; nothing is deployed yet."""
        self._loop = loop
        owned = OwnedTasks.of(loop)
        owned.install()
        self._undo.callback(owned.uninstall)
        collector.start()
        self._undo.callback(collector.stop)
        scheduler = Scheduler.of(loop)
        suspends = turn_of(loop).suspends
        suspends.listen(self._resumed)
        self._undo.callback(suspends.forget, self._resumed)
        for components in crowds:
            scheduler.expect(components)
        if turn_of(loop).virtual:  # there it would hide a deadlock
            return
        real_time, priority = RealTime.of(loop), self.realtime
        if priority is not None:
            if told := real_time.start(priority):
                _log.warning("%s: not in real time: %s", self._title, told)
            else:
                self._undo.callback(real_time.stop, priority)
        seconds = self.stall_warning
        if seconds is not None:
            stalls = StallWatch.of(loop)
            stalls.start(seconds)
            self._undo.callback(stalls.stop, seconds)
        self._service = ServiceManager()
        self._undo.callback(scheduler.every(GLANCE, self._service.beat).stop)
        real_time.lead()

    def refuse_elsewhere(self, verb: str) -> None:
        """Refuse what is asked in another event loop while the robot has its own."""
        if self._loop not in {None, asyncio.get_running_loop()}:
            told = "it runs in another event loop: what is for threads is halt"
            raise ConfigError(self._title, verb, told)

    @property
    def is_for_all(self) -> bool:
        """Whether everything runs: it is neither starting nor stopping."""
        return self._gaps is not None

    def is_up(self, loop: asyncio.AbstractEventLoop) -> None:
        """Everything runs: garbage is collected in the gaps from now on."""
        if self._service is not None:
            self._service.tell("READY=1")
        self._gaps = Gaps.of(loop)
        self._gaps.start()

    def counts(self) -> Iterator[tuple[str, Mapping[str, int]]]:
        """Return what the collector counts; on a virtual clock it has no gaps."""
        if (
            self._gaps is not None
            and self._loop is not None
            and not turn_of(self._loop).virtual
        ):
            yield "collector", collector.counts()

    def is_down(self) -> None:
        """The stop has begun: it is no time for garbage."""
        if self._service is not None:
            self._service.tell("STOPPING=1")
        if self._gaps is not None:
            self._gaps.stop()
            self._gaps = None

    def stop(self) -> None:
        """Leave everything as it was found."""
        self._loop = None
        self._undo.close()


_looking: contextvars.ContextVar[bool] = contextvars.ContextVar(
    "esair.standard.looking", default=False
)


class RunWanted(BaseException):
    """A program has come to where it runs its robot; it is wanted, not its run.

    Attributes:
        robot: The robot, an `esair.Robot`.
    """

    def __init__(self, robot: Any) -> None:
        super().__init__(robot.name)
        self.robot = robot


@contextlib.contextmanager
def only_looking() -> Iterator[None]:
    """Have a robot raise `RunWanted` instead of its start meanwhile."""
    token = _looking.set(True)
    try:
        yield
    finally:
        _looking.reset(token)


def not_while_looking(robot: Any) -> None:
    """Raise `RunWanted` if robots are only looked at."""
    if _looking.get():
        raise RunWanted(robot)


class Seating:
    """The seat of a robot: there if somebody may sit in it, or once somebody types."""

    def __init__(
        self, name: str, *, socket: bool, page: Page | None, rights: Operator | None
    ) -> None:
        given = (("operator", rights, Operator), ("page", page, Page))
        for field, value, kind in given:
            if value is not None and not isinstance(value, kind):
                told = f"expected an esair.{kind.__name__}, not {value!r:.80}"
                raise ConfigError(f"robot {name!r}", field, told)
        self._name = name
        self.socket = socket
        self.page = page
        self.seat: Seat | None = None

    @property
    def is_wanted(self) -> bool:
        """Whether it is there from the start of the robot to its end."""
        return self.socket or self.page is not None

    def take(self, *, closed: bool) -> Seat:
        """Take its place, which nobody else may have, or none if it is closed."""
        from esair.seat import Seat

        socket, page = (False, None) if closed else (self.socket, self.page)
        self.seat = Seat(self._name, socket=socket, page=page)
        return self.seat

    async def start(self, robot: Robot) -> None:
        if self.seat is not None:
            self.seat.begin(robot)
            await outside(("seat", "start"), self.seat.start)

    async def typed(self, robot: Robot, text: str) -> str:
        if self.seat is None:
            self.take(closed=True).begin(robot)
        assert self.seat is not None
        return await self.seat.typed(text)

    def leave(self) -> None:
        if self.seat is not None:
            self.seat.leave()

    async def close(self) -> None:
        """Take no more acts, and let its place go."""
        if self.seat is not None:
            await self.seat.close()


LAST_WAIT = 2.0  # how long `run` may take to end beside the grace period, in seconds

_log = logging.getLogger("esair")


class Stopping:
    """The stop of a robot: why it takes place, and that it does so once.

    Args:
        name: The name of the robot.
        work: Stops it in order.
        hurry: Called when somebody is impatient.
        is_safe: Tells, in any thread, whether every actuator was made safe.
    """

    def __init__(
        self,
        name: str,
        work: Callable[[], Coroutine[Any, Any, None]],
        hurry: Callable[[], None],
        is_safe: Callable[[], bool],
    ) -> None:
        self._name = name
        self._work = work
        self._hurry = hurry
        self.reason = ""  # why it stops; the first one counts
        self.signal: int | None = None
        self.watch = SignalWatch(lambda n: self._signals.tell(n), hurry, is_safe)
        self.interrupts = False
        """Whether SIGINT interrupts code that holds the loop."""
        self.host: asyncio.Task[Any]
        """The task that has entered the robot."""
        self.task: asyncio.Task[None] | None = None
        self._begun = asyncio.Event()
        self._signals: News

    def enter(self) -> None:
        """This task enters the robot."""
        host = asyncio.current_task()
        assert host is not None
        self.host = host

    def listen(self, loop: asyncio.AbstractEventLoop) -> None:
        """Stop at a signal from now on: the robot starts."""
        self._signals = News(loop, ("robot", "signal"), self._end_by_signal)
        if not repeats(loop) and not self.watch.start(interrupts=self.interrupts):
            told = "it was not entered in the main thread, nor is another robot there"
            _log.warning("robot %s: no signal stops it: %s", self._name, told)

    def _end_by_signal(self, number: int) -> None:
        self.signal = number
        self.because(signal.Signals(number).name)
        self.host.cancel()

    def because(self, reason: str) -> None:
        self.reason = self.reason or reason

    def once(self) -> asyncio.Task[None]:
        """Begin to stop, once; again only if a stranger has cancelled it."""
        if self.task is None or self.task.cancelled():
            loop = asyncio.get_running_loop()
            self.task = spawn(loop, self._work(), name=f"stop {self._name}")
            self._begun.set()
        return self.task

    async def done(self) -> None:
        """Wait until the stop has begun, and has ended."""
        await self._begun.wait()
        while not (stopping := self.once()).done():
            await asyncio.wait({stopping})

    async def for_sure(self, reason: str) -> bool:
        """Stop, whoever cancels meanwhile; tells whether somebody did."""
        self.because(reason)
        cancelled = False
        # A cancel scope of anyio would cancel in every turn until the stop is done.
        with anyio.CancelScope(shield=True):
            while not (stopping := self.once()).done():
                try:
                    await asyncio.shield(stopping)
                except asyncio.CancelledError:
                    # The stop itself, if the event loop ends and cancels every task.
                    cancelled = True
                    self._hurry()
                except Exception:
                    _log.exception("robot %s: the stop met an error", self._name)
        return cancelled


class Robot:
    """A robot: its resources, its behaviors, and the four objects between them.

    It is an async context manager. Entering it runs the initialization phase;
    leaving it stops everything in the reverse order, and every actuator reaches
    its safe command, whatever the reason for leaving is: the end of the block, an
    exception, a cancellation, SIGINT, SIGTERM or SIGHUP (where it, or another robot,
    was entered in the main thread: Python tells signals nowhere else).

    Args:
        name: The name of the robot.
        resources: The sensors and actuators to deploy.
        behaviors: The behaviors and reactions to deploy.
        policies: Who may do what with which resource.
        modes: Who takes turns: for each mode an `esair.Mode`, or the names of the
            behaviors that run in it. What is in no mode always runs.
        mode: The mode that it begins in.
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
        realtime: Whether the thread of the event loop goes before what else the computer
            does, with its memory locked: true, or the priority in ``SCHED_FIFO``, from 1
            to 98. Where it may not a warning says what to do, and the robot runs all the
            same. Not on a virtual clock.
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
        modes: Mapping[str, Mode | Sequence[str]] | None = None,
        mode: str | None = None,
        grace: float = 1.0,
        record: Recording | None = None,
        start_patience: float = 1.0,
        watchdog: bool = False,
        watchdog_limit: float = LIMIT,
        watchdog_policy: Literal["kill", "freeze"] = "kill",
        watchdog_death: Literal["stop", "alarm"] = "stop",
        stall_warning: float | None = STALL_WARNING,
        realtime: bool | int = False,
        seed: int | None = None,
        socket: bool = False,
        operator: Operator | None = None,
        page: Page | None = None,
    ) -> None:
        self.name: str = check_name("robot", name)
        self._title = f"robot {name!r}"
        self.operator: Operator = Operator() if operator is None else operator
        """What an operator may do from outside."""
        self.source: tuple[Path, bool] | None = None
        """The file it was made from, and whether simulated; None if from none."""
        self._seat = Seating(name, socket=socket, page=page, rights=operator)
        self._keeping = Keeping(record)
        self._grace = check_seconds(self._title, "grace", grace)
        # What was written for a microcontroller runs here as well, in an adapter.
        self._list_of_resources: list[Any] = self._given(
            "resources", resources, adapt_resource
        )
        self._list_of_behaviors: list[Any] = self._given(
            "behaviors", behaviors, adapt_action
        )
        given: list[Any] = list(policies)
        self._rules: dict[str, Any] = {
            "name": name,
            "policies": given,
            "modes": modes,
            "mode": mode,
            "grace": grace,
            "start_patience": start_patience,
            "seed": seed,
            "operator": operator,
        }
        turns = Modes.of({} if modes is None else modes, mode)
        self.sensors: SensorConnection = SensorConnection()
        self.actuators: ActuatorConnection = ActuatorConnection()
        self.journal: Journal = Journal()
        registrations = Registrations(self.journal)
        self._resources = ResourceDeployment(
            self.sensors,
            self.actuators,
            registrations,
            policies=given,
            declared=lambda *names: self._behaviors.declared(*names),
            grace=self._grace,
            modes=turns,
        )
        self.resources: ResourceSupervisor = ResourceSupervisor(
            self._resources, self._typed
        )
        self._halts = Halts(
            name,
            self.actuators,
            registrations,
            self.journal,
            lambda: self._behaviors.forget_waiting(),
        )
        self._behaviors = BehaviorDeployment(
            self._resources,
            grace=self._grace,
            start_patience=check_seconds(self._title, "start_patience", start_patience),
            halt=self._halts.halt,
            stop=self.stop,
            policies=given,
            modes=turns,
        )
        self.behaviors: BehaviorSupervisor = BehaviorSupervisor(
            self._behaviors, self._typed
        )
        check_seconds(self._title, "watchdog_limit", watchdog_limit)
        check_choice(
            self._title, "watchdog_policy", watchdog_policy, ("kill", "freeze")
        )
        check_choice(self._title, "watchdog_death", watchdog_death, ("stop", "alarm"))
        self._keeper: Keeper | None = None
        if watchdog:
            self._keeper = Keeper(
                self._resources,
                robot=name,
                limit=watchdog_limit,
                policy=watchdog_policy,
                on_death=watchdog_death,
                halt=self._halts.halt,
            )
            self._halts.keeps_still = self._keeper.keeps_still
        if seed is not None and type(seed) is not int:
            told = f"expected a whole number, not {seed!r:.80}"
            raise ConfigError(self._title, "seed", told)
        self.seed = seed
        """What `esair.random` begins with; known when the robot has started."""
        self.stopped: Stopped = Stopped()
        """What each actuator was told last, if it answered, and why the robot stopped."""
        self._entered = False
        self._care = LoopCare(
            self._title, stall_warning, realtime, self._resources.resumed
        )
        self.journal.count("collector", self._care.counts)
        self._stopping = Stopping(
            name, self._stop, self._hurry, self._resources.is_made_safe
        )

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
    def grace(self) -> float:
        """How long a component may take to end when it is removed, in seconds."""
        return self._grace

    def alike(self, resources: Iterable[Any], behaviors: Iterable[Any]) -> Robot:
        """Make a robot of other parts by the same rules, and with nothing around it.

        It has no watchdog, no recording, no control socket and no page: it is for
        trials on the virtual clock.

        Args:
            resources: Its resources.
            behaviors: Its behaviors and reactions.
        """
        return Robot(resources=resources, behaviors=behaviors, **self._rules)

    @property
    def plan(self) -> Plan:
        """What this robot starts with, as the rulebook sees it."""
        return Plan(
            name=self.name,
            resources=self._list_of_resources,
            behaviors=self._list_of_behaviors,
            policies=self._rules["policies"],
            modes=self._behaviors.turns.modes,
            watchdog=self._keeper is not None,
        )

    async def __aenter__(self) -> Self:
        if self._entered:
            raise StoppingError(self._title, "used already: make another one")
        if asked := self._stopping.reason:
            raise StoppingError(self._title, f"stopped before its start: {asked}")
        not_while_looking(self)
        found = [each for each in examine(self.plan) if each.is_error]
        if mistakes := errors_in(found):
            for error, finding in zip(mistakes, found, strict=True):
                if place := class_of(finding.subject):
                    error.add_note(place)
            raise ExceptionGroup(f"{self._title} cannot start", mistakes)
        anyio.CancelScope()  # what the stop needs is imported before there can be one
        loop = asyncio.get_running_loop()
        self._keeping.has_seat = self._seat.is_wanted
        if self._seat.is_wanted:
            self._seat.take(closed=repeats(loop))
        self._entered = True
        self._resources.commands.wake()
        self._behaviors.wake()
        if self.seed is None:
            virtual = turn_of(loop).virtual
            self.seed = 0 if virtual else int.from_bytes(os.urandom(8))
        self._resources.seed = self.seed
        self._stopping.enter()
        try:
            self._keeping.begin(self)
        except BaseException:
            await self._seat.close()  # its name is free again
            raise
        self._resources.began = now()  # in a replay it is then only
        self.journal.start(loop)
        self._halts.start(loop)
        self._log_lines = LogLines(self.journal)
        self._log_lines.start()
        self._stopping.listen(loop)
        lists = self._list_of_resources, self._list_of_behaviors
        for components in lists:
            # Nothing depends on the order in which they were given.
            components.sort(key=lambda component: component.name)
        self._care.start(loop, *map(len, lists))
        try:
            await self._seat.start(self)
            self._behaviors.accept(self._list_of_behaviors)
            if self._keeper is not None:
                await self._keeper.start()
            await self._resources.start(self._list_of_resources)
            await self._behaviors.start()
        except BaseException as error:
            asked = self._stopping.reason
            await self._stopping.for_sure(describe(error))
            if self._stopping.signal is not None:
                raise SystemExit(128 + self._stopping.signal) from None
            if asked and isinstance(error, asyncio.CancelledError):
                self._stopping.host.uncancel()
                raise StoppingError(self._title, f"stopped: {asked}") from None
            raise
        if self._stopping.task is None:  # else it was up for a moment
            self._care.is_up(loop)
        return self

    async def __aexit__(
        self, _: object, error: BaseException | None, *__: object
    ) -> None:
        stopping = self._stopping
        cancelled = await stopping.for_sure(_reason_of(error))
        if stopping.signal is not None:
            await stopping.watch.others_stopped(self._grace + LAST_WAIT)
            raise SystemExit(128 + stopping.signal)
        if cancelled and error is None:
            raise asyncio.CancelledError

    async def ended(self) -> None:
        """Wait until every deliberative behavior has ended.

        A robot with reactions alone never ends by itself.

        Raises:
            BehaviorFailedError: One has failed for good (the first one, if several).
        """
        await Budget.spend()
        await self._behaviors.all_ended()
        for failed in self._behaviors.failures():
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
        self._care.refuse_elsewhere("stop")
        stopping = self._stopping
        stopping.because(reason)
        if not self._entered:
            self.stopped = Stopped((), stopping.reason)
            return self.stopped
        if self._care.is_for_all or self._behaviors.is_one_that_runs():
            stopping.once()
        elif stopping.task is None:  # it starts: whoever enters it stops it
            stopping.host.cancel()
        await stopping.done()
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
        """End all halts: the next write moves. For the user alone.

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

    def _given(
        self, field: str, parts: object, adapt: Callable[[Any], Any]
    ) -> list[Any]:
        if not isinstance(parts, Iterable):
            told = f"expected a list of components: write [{parts!r:.80}]"
            raise ConfigError(self._title, field, told)
        return [adapt(each) for each in parts]

    async def _typed(self, text: str) -> str:
        if self._seat.seat is None and (not self._entered or self._stopping.task):
            told = "stopping" if self._entered else "not started yet"
            raise StoppingError(self._title, told)
        return await self._seat.typed(self, text)

    async def _stop(self) -> None:
        reason, ending = self._stopping.reason, self._stopping.watch.last
        if self.halted is not None:
            reason = f"{reason}; halted: {self.halted}"
        _log.info("robot %s: stops: %s", self.name, printable(str(reason)))
        self._care.is_down()
        self._behaviors.halt()
        self._resources.latch()
        if ending is not None:
            ending.because(time.monotonic())
        self._seat.leave()
        try:
            await self._behaviors.stop()
            self.stopped = Stopped(await self._resources.make_safe(), reason)
            for told in self.stopped:
                good = told.safe and told.answered
                _log.log(logging.INFO if good else logging.ERROR, "stop: %s", told)
        finally:
            await self._halts.close()
            await self._resources.stop()
            if self._keeper is not None:
                await self._keeper.close()
            self._care.stop()
            self._stopping.watch.stop()
            self._log_lines.stop()
            self.journal.close()
            leave_behind(self._behaviors.undead)
            await self._seat.close()
            self.stopped.recording = await self._keeping.end()
            await self._log_lines.be_shown()

    def _hurry(self) -> None:
        """Somebody is impatient: no more grace for components; safe comes first still."""
        self._behaviors.grace = 0.0


def _reason_of(error: BaseException | None) -> str:
    if error is None:
        return "its program has left it"
    cancelled = isinstance(error, asyncio.CancelledError)
    return "it was cancelled" if cancelled else describe(error)
