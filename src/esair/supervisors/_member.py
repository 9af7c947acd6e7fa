"""A member of the behavior supervisor: one behavior or reaction and its life."""

from __future__ import annotations

import asyncio
import inspect
import logging
import types
from collections.abc import Awaitable, Callable
from typing import TYPE_CHECKING, Any

from esair.actions import (
    ActuatorPort,
    Behavior,
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
from esair.connections import (
    UNDECIDED,
    ActuatorChannel,
    Halting,
    Registration,
    SensorChannel,
    Stopped,
)
from esair.exceptions import (
    BadValueError,
    BehaviorRemovedError,
    ConfigError,
    DeviceFaultError,
    DeviceLostError,
    DriverStuckError,
    EsairError,
    NotRegisteredError,
    ResourceRemovedError,
    UnknownNameError,
    describe,
)
from esair.journal import Kind
from esair.loop import Owner, Portal, Stream, spawn, speaks_for_nobody
from esair.messages import Access, BehaviorState, BehaviorStatus
from esair.supervisors._mailbox import Mailbox
from esair.supervisors._restart_budget import RestartBudget
from esair.supervisors._sight import Sight
from esair.values import is_positive

if TYPE_CHECKING:
    from esair.supervisors._behavior_supervisor import BehaviorSupervisor

_log = logging.getLogger("esair")

_BOUND = (
    "put",
    "get",
    "ask",
    "receive",
    "receive_from",
    "offer",
    "perform",
    "register",
    "stop_robot",
)


class Member(Mailbox):
    """Owns one behavior or reaction: its registrations, its task, its restarts.

    It is also the `Host` that the behavior talks to.
    """

    __slots__ = (
        "_budget",
        "_portal",
        "_ports",
        "_supervisor",
        "_timer",
        "detail",
        "gate",
        "given_up",
        "over",
        "performs",
        "ready",
        "registrations",
        "runner",
        "sight",
        "stream",
        "task",
        "undead",
        "zombies",
    )

    def __init__(
        self, action: Behavior | Reaction, supervisor: BehaviorSupervisor, name: str
    ) -> None:
        super().__init__(action, supervisor.mediator, name)
        self.detail = ""
        self.registrations: list[Registration] = []
        self.runner: ReactionRunner | None = None
        self.performs: list[_Perform] = []
        """The reactions that it performs now."""
        self.task: asyncio.Task[BaseException | None] | None = None
        self.ready: asyncio.Future[None] | None = None
        self.gate: asyncio.Future[None] | None = None
        """If there is one, ``run`` begins only when it is done."""
        self.over: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        """Done when it has been ended."""
        self.given_up = False
        """Nobody wants it any more: it is removed, or its place is."""
        self.zombies: list[str] = []
        """The names of its tasks and threads that would not end."""
        self.undead: list[asyncio.Task[Any]] = []
        self._supervisor = supervisor
        self.stream = Stream(f"{supervisor.seed}/{name}")
        """Its random numbers, made from the robot's seed and its name."""
        self._ports: dict[str, SensorPort[Any] | ActuatorPort[Any]] = {}
        """The declared ports of a behavior, by their attributes."""
        self.owner.stream = self.stream
        self._budget: RestartBudget | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._portal: Portal | None = None
        self.sight = Sight(supervisor.actuators.protections, action, name)
        """What it protects, and whether it sees."""

    # What the behavior asks (`Host`).

    def query(self, name: str) -> BehaviorStatus:
        """Tell what a behavior is doing."""
        return self._supervisor.query(name)

    async def manage(self, verb: str, *args: Any) -> Any:
        """Add, remove, replace or restart a behavior, if a policy allows it."""
        if speaks_for_nobody() or not self.alive:
            raise BehaviorRemovedError(self.name)
        return await self._supervisor.managed_by(self.name, verb, *args)

    async def register(
        self,
        resource: str,
        access: Access,
        priority: int,
        hold: float | None,
        max_age: float | None,
    ) -> SensorPort[Any] | ActuatorPort[Any]:
        """Register for a resource at run time."""
        self.check_speaker()
        if max_age is not None:
            _check_seconds(self.name, f"{resource}.max_age", max_age)
        registration = self._grant(resource, access, priority, hold)
        port = self._port(registration, max_age)
        return port if self._portal is None else blocking(port, self._portal)

    async def perform(
        self,
        reaction: Reaction,
        until: Callable[..., bool] | None,
        timeout: float | None,
        blind_timeout: float | None,
    ) -> bool:
        """Run a reaction until its condition comes true or its time is over."""
        self.check_speaker()
        if timeout is not None:
            _check_seconds(self.name, "timeout", timeout)
        if blind_timeout is not None:
            _check_seconds(self.name, "blind_timeout", blind_timeout)
        if not isinstance(reaction, Reaction):
            raise ConfigError(
                self.name,
                "perform",
                f"expected an esair.Reaction, not {reaction!r:.80}",
            )
        self._supervisor.refuse_step(reaction, self.name)
        loop = asyncio.get_running_loop()
        table = self._supervisor.actuators.protections
        sight = Sight(table, reaction, reaction.name, step_of=self.name)
        perform = _Perform(
            reaction,
            until,
            loop,
            sight,
            blind_timeout,
            self._supervisor.began,
            self.owner,
        )
        self.performs.append(perform)
        sight.accept()
        timer = None
        try:
            self._start_runner(perform.runner, reaction, perform)
            if timeout is not None:
                timer = loop.call_later(timeout, perform.end, False)
            return await perform.ended
        finally:
            if timer is not None:
                timer.cancel()
            perform.stop()
            self.performs.remove(perform)
            for registration in perform.own:
                self._supervisor.resources.revoke(registration)
            sight.leave()

    def halt_robot(self, reason: str) -> Halting:
        """Make every actuator safe, and keep it so."""
        return self._supervisor.halt_robot(reason, self.name)

    async def stop_robot(self, reason: str) -> Stopped:
        """Stop the robot in order, this behavior too."""
        return await self._supervisor.stop_robot(f"{self.name}: {reason}")

    # Life.

    def forget_waiting(self) -> None:
        """Drop the commands that its reactions keep until a driver is done."""
        for runner in (self.runner, *(perform.runner for perform in self.performs)):
            if runner is not None:
                runner.forget_waiting()

    def halt(self) -> None:
        """Let its reactions take no further step: the robot stops."""
        for runner in (self.runner, *(perform.runner for perform in self.performs)):
            if runner is not None:
                runner.stop()

    def start(self) -> None:
        """Register what it declares, and begin.

        Raises:
            EsairError: It may not, or a resource is not there.
        """
        self.state = BehaviorState.STARTING
        loop = asyncio.get_running_loop()
        if isinstance(self.action, Reaction):
            self.sight.blind(UNDECIDED)
            self.runner = _runner_for(
                self.action,
                self.sight,
                on_state=self._runs,
                on_crash=self._crashed,
                on_sight=self.sight.sees,
                began=self._supervisor.began,
                owner=self.owner,
            )
            self._start_runner(self.runner, self.action)
            return
        survivors = self.owner.living()
        self.owner = Owner(self._supervisor.context)
        self.owner.stream = self.stream
        for task in survivors:  # they would not end with the run before
            self.owner.adopt(task)
        self.outlived = bool(survivors)
        self.action._host = self  # noqa: SLF001 - the behavior's own supervisor
        if not inspect.iscoroutinefunction(self.action.run):
            self._portal = Portal(self.name, self.owner)
            self._bind_methods()
        try:
            for attribute, need in self.action.needs.items():
                port: Any = self._port(self._grant_need(need), _max_age(need))
                self._ports[attribute] = port
                if self._portal is not None:
                    port = blocking(port, self._portal)
                self.action.__dict__[attribute] = port
            for attribute, each in self.action.takes.items():
                if isinstance(each, Takes):
                    requests: Any = RequestPort(self.queues[each.type])
                    if self._portal is not None:
                        requests = requests.blocking(self._portal)
                    self.action.__dict__[attribute] = requests
        except BaseException:
            self.fence()
            raise
        self.ready = loop.create_future()
        self.task = spawn(
            loop, self._live(self.action), name=self.name, owner=self.owner
        )
        self.task.add_done_callback(self._ended)

    async def _live(self, behavior: Behavior) -> BaseException | None:
        """Run one incarnation; returns its error, so that nothing escapes a task."""
        error: BaseException | None = None
        try:
            await self._run(behavior.setup)
            if self.gate is not None:
                self._is_ready()
                await self.gate
            else:
                await self._supervisor.may_begin.wait()
            self._runs(True, "")
            await self._run(behavior.run)
        except asyncio.CancelledError as raised:
            # Its frames go: the task keeps it where the collector cannot see it.
            error = raised.with_traceback(None)
        except BaseException as raised:  # contained: one component's failure
            error = raised
        if asyncio.current_task() is self.task:  # else it is another run's by now
            self.run_over(error)
        try:
            await self._run(behavior.teardown)
        except BaseException as raised:  # contained: one component's failure
            if error is None:
                error = raised
            else:
                _log.warning("%s: teardown failed too: %s", self.name, describe(raised))
        return error

    async def _run(self, method: Callable[[], Any]) -> None:
        if inspect.iscoroutinefunction(method):
            await method()
        elif self._portal is not None:
            await self._portal.run(method)
        else:
            await Portal(self.name, self.owner).run(method)

    def _runs(self, running: bool, why: str) -> None:
        self.detail = why
        if self.state in {BehaviorState.STOPPING, BehaviorState.REMOVED}:
            return
        before, self.state = (
            self.state,
            BehaviorState.RUNNING if running else BehaviorState.PARKED,
        )
        self._is_ready()
        if not running:
            self.sight.blind(why)
        elif isinstance(self.action, Behavior):
            self.sight.sees()
        if running:
            self._mediator.admit(self)
            self._mediator.serve(self)
            for queue in self.queues.values():
                queue.roused()
        if before is not self.state:
            self._tell(Kind.RUNNING if running else Kind.PARKED, why)
        if before is BehaviorState.RUNNING and not running:
            _log.info("%s: parked: %s", self.name, why)
        elif before is BehaviorState.PARKED and running:
            _log.info("%s: goes on", self.name)

    def _tell(self, kind: Kind, text: str = "") -> None:
        journal = self._supervisor.journal
        if journal.heard:
            journal.publish(kind, self.name, "", self.error, text)

    def _is_ready(self) -> None:
        if self.ready is not None and not self.ready.done():
            self.ready.set_result(None)

    def _ended(self, task: asyncio.Task[BaseException | None]) -> None:
        if task is not self.task or self.state in {
            BehaviorState.STOPPING,
            BehaviorState.REMOVED,
        }:
            return
        error = asyncio.CancelledError() if task.cancelled() else task.result()
        if error is None:
            self.state = BehaviorState.FINISHED
            self._tell(Kind.FINISHED)
            self.sight.sees()  # it has nothing more to say: that is no blindness
            self.fence()
            self._end_requests()
            self._mediator.peer_finished(self)
            self._cancel_tasks()
            self._supervisor.ended(self)
        else:
            self._crashed(error)

    def _crashed(self, error: BaseException) -> None:
        """Make safe what it held, and start it again unless its budget is spent."""
        self.error = error
        self._tell(Kind.CRASHED, describe(error))
        self.sight.blind(f"it failed: {describe(error)}")
        self.fence()
        self.run_over(error)
        self._end_requests()
        self.owner.over = self.outlived = True
        self._cancel_tasks()
        ready = self.ready
        if ready is not None and not ready.done() and self._supervisor.is_adding(self):
            self.state = BehaviorState.FAILED
            ready.set_exception(_as_exception(error))
            ready.exception()  # whoever adds it may be cancelled in this moment
            return
        self._is_ready()
        absent = self._absent_for(error)
        if absent:
            # Not its own fault: it begins anew when everything it uses is there.
            self.state = BehaviorState.PARKED
            self.detail = f"{', '.join(absent)} is not there"
            self.sight.blind(self.detail)
            self._tell(Kind.PARKED, self.detail)
            _log.info("%s: parked: %s", self.name, self.detail)
            self._mediator.peer_failed(self, error)
            return
        if self._budget is None:
            self._budget = RestartBudget(self.action.restart)
        loop = asyncio.get_running_loop()
        pause = self._budget.spend(loop.time())
        if pause is None:
            self.state = BehaviorState.FAILED
            self._tell(Kind.FAILED, describe(error))
            _log.error(
                "%s: failed for good: %s",
                self.name,
                describe(error),
                exc_info=_as_exception(error),
            )
        else:
            self.state = BehaviorState.RESTARTING
            _log.warning(
                "%s: failed: %s; restart %d in %g s",
                self.name,
                describe(error),
                self._budget.restarts,
                pause,
                exc_info=_as_exception(error),
            )
            self._timer = loop.call_later(pause, self._restart)
        self._mediator.peer_failed(self, error)
        if pause is None:
            self._supervisor.ended(self)

    def _absent_for(self, error: BaseException) -> list[str]:
        """Return what is not there, if the error may come from that."""
        if not isinstance(error, _ABSENCE):
            return []
        absent = self._absent()
        named = error.name if isinstance(error, UnknownNameError) else error.resource
        is_there = named in {need.resource for need in self.action.needs.values()}
        return [] if is_there and named not in absent else absent

    def _absent(self) -> list[str]:
        """Return what it declares to use, and is not there or not ready."""
        if not isinstance(self.action, Behavior):
            return []
        return [
            need.resource
            for need in self.action.needs.values()
            if not self._supervisor.resources.is_ready(need.resource)
        ]

    def resource_up(self, resource: str) -> None:
        """Begin anew if this was the last resource that was not there."""
        if (
            isinstance(self.action, Behavior)
            and self.state is BehaviorState.PARKED
            and not self._absent()
        ):
            _log.info("%s: goes on: %s is back", self.name, resource)
            self._restart()

    def _restart(self) -> None:
        self._timer = None
        self._tell(Kind.RESTARTED)
        try:
            self.start()
        except Exception as error:
            self._crashed(error)

    def uses(self) -> list[Registration]:
        """Return every registration that it has now."""
        performed = (r for perform in self.performs for r in perform.own)
        return [*self.registrations, *performed]

    def fence(self, reason: Callable[[], EsairError] | None = None) -> None:
        """Revoke all its registrations in one step; what it moved is made safe."""
        if self.runner is not None:
            self.runner.stop()
        if reason is None:
            name = self.name

            def reason() -> EsairError:
                return NotRegisteredError(name, "resource", "this run of it has ended")

        for registration in self.uses():
            self._supervisor.resources.revoke(registration, reason)
        self.registrations.clear()
        if self._portal is not None:
            self._portal.close()

    async def stop(self, grace: float) -> None:
        """End it, whatever it does; what would not die is in ``zombies``."""
        self.state = BehaviorState.STOPPING
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        self.fence(lambda: _UserRemovedError(self.name))
        self.give_up()
        self._end_requests()
        self.run_over(None)
        for taker in self.takers or ():
            if not taker.done():
                taker.set_result(None)
        living = self._living()
        for _ in range(2):
            if not living:
                break
            for task in living:
                task.cancel()
            await asyncio.wait(living, timeout=grace if grace > 0 else 0.001)
            living = self._living()
            grace = 0.04
        self.zombies = [
            *(task.get_name() for task in living),
            *(thread.name for thread in self.owner.threads),
        ]
        self.undead = living
        for task in living:
            task.add_done_callback(_look_at)
        self.task = None
        if isinstance(self.action, Behavior) and self.action._host is self:  # noqa: SLF001
            self._unbind(self.action)

    def end_run(self, grace: float) -> Awaitable[None]:
        """End the run, so that another may begin; awaiting waits until it has ended.

        Raises:
            BehaviorRemovedError: It was removed meanwhile.
        """
        self.state = BehaviorState.RESTARTING
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        self._is_ready()
        self.task = self._budget = self.error = None
        self.sight.blind("it is restarted by the user")
        self.fence()
        self.run_over(None)
        self._end_requests()
        self.owner.over = self.outlived = True
        self._cancel_tasks()
        return self._run_ended(grace)

    async def _run_ended(self, grace: float) -> None:
        living = self._living()
        if living:
            await asyncio.wait(living, timeout=grace if grace > 0 else 0.001)
        if self.state is not BehaviorState.RESTARTING:
            raise BehaviorRemovedError(self.name)

    def give_up(self) -> None:
        """End whoever waits for its setup, and what would wait for its turn to run."""
        self.given_up = True
        for future in (self.ready, self.gate):
            if future is not None and not future.done():
                future.set_exception(BehaviorRemovedError(self.name))
                future.exception()  # there may be nobody who waits

    def _end_requests(self) -> None:
        if self.asked:
            removed = self.state is BehaviorState.STOPPING
            self._mediator.asker_ended(self, removed=removed)

    def run_tasks(self) -> list[asyncio.Task[Any]]:
        """Return the tasks that only wait for its threads."""
        return [] if self.task is None or self._portal is None else [self.task]

    def _living(self) -> list[asyncio.Task[Any]]:
        me = asyncio.current_task()
        return [task for task in self.owner.living() if task is not me]

    def _cancel_tasks(self) -> None:
        for task in self.owner.living():
            task.cancel()

    def _unbind(self, behavior: Behavior) -> None:
        behavior._host = None  # noqa: SLF001 - the behavior's own supervisor
        if self._portal is not None:
            for method in _BOUND:
                behavior.__dict__.pop(method, None)

    def _bind_methods(self) -> None:
        """Let a plain behavior call, in its thread, what others await."""
        behavior = self.action
        if not isinstance(behavior, ThreadBehavior):
            for name in _BOUND:
                method = getattr(ThreadBehavior, name)
                behavior.__dict__[name] = types.MethodType(method, behavior)

    @property
    def portal(self) -> Portal | None:
        """The way of its thread into the loop, if it has a thread."""
        return self._portal

    # Registrations.

    def _grant(
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
        terms = (resource, access, priority, hold)
        for known in tuple(self.registrations):
            if terms == (known.resource, known.access, known.priority, known.hold):
                if known.usable:
                    return known
                self.registrations.remove(known)  # void: its resource was removed
        registration = self._supervisor.resources.grant(
            self.name,
            resource,
            access,
            priority=priority,
            hold=hold,
            instead_of=self.name,
        )
        (self.registrations if owned is None else owned).append(registration)
        return registration

    def _grant_need(
        self, need: Need, owned: list[Registration] | None = None
    ) -> Registration:
        return self._grant(
            need.resource,
            need.access,
            0 if isinstance(need, Reads) else need.priority,
            need.hold if isinstance(need, Writes) else None,
            owned,
        )

    def _channel(self, resource: str) -> SensorChannel | ActuatorChannel:
        supervisor = self._supervisor
        sensor = supervisor.sensors.channels.get(resource)
        return sensor or supervisor.actuators.channels[resource]

    def _port(
        self, registration: Registration, max_age: float | None
    ) -> SensorPort[Any] | ActuatorPort[Any]:
        channel = self._channel(registration.resource)
        control = self._supervisor.resources
        if isinstance(channel, SensorChannel):
            return SensorPort(channel, registration, max_age, control)
        return ActuatorPort(channel, registration, control)

    def _start_runner(
        self,
        runner: ReactionRunner,
        reaction: Reaction,
        perform: _Perform | None = None,
    ) -> None:
        inputs: dict[str, tuple[SensorChannel, Registration, float | None]] = {}
        outputs: dict[str, tuple[ActuatorChannel, Registration]] = {}
        guarded: ActuatorChannel | None = None
        missing = [
            need.resource
            for need in reaction.needs.values()
            if need.resource not in self._supervisor.resources.names()
        ]
        if missing and runner is self.runner:
            self._runs(False, f"{', '.join(missing)} was removed")
            return
        for attribute, need in reaction.needs.items():
            registration = self._grant_need(need, perform.own if perform else None)
            if perform is not None:
                perform.uses.append(registration)
            channel = self._channel(need.resource)
            if isinstance(channel, SensorChannel):
                inputs[attribute] = (channel, registration, _max_age(need))
                reaction.__dict__[attribute] = self._port(registration, _max_age(need))
            elif isinstance(need, Guards):
                guarded = channel
            else:
                outputs[attribute] = (channel, registration)
        if isinstance(runner, GuardRunner):
            assert guarded is not None
            runner.guard(guarded, inputs)
        else:
            runner.start(inputs, outputs)

    def resource_changed(self, resource: str) -> None:
        """Bind an action anew when one of its resources was added or removed."""
        for perform in self.performs:
            for registration in perform.uses:
                if registration.reason is not None:
                    perform.crash(registration.reason())
        if not self.alive or self.state is BehaviorState.RESTARTING:
            return  # it will be bound anew in any case
        if all(need.resource != resource for need in self.action.needs.values()):
            return
        misfit = self._supervisor.misfit(self.action, resource)
        if not isinstance(self.action, Reaction):
            if not misfit:
                self._revive(resource)
            return
        self.fence()
        if misfit:
            self._runs(False, misfit)
            return
        try:
            self.start()
        except Exception as error:
            self._crashed(error)

    def _revive(self, resource: str) -> None:
        """Give the declared ports of a behavior their rights to a resource again."""
        names = self._supervisor.resources.names()
        for attribute, need in self.action.needs.items():
            port = self._ports.get(attribute)
            if port is None or need.resource != resource or resource not in names:
                continue
            if port.registration.reason is None:
                continue  # it was never revoked
            try:
                registration = self._grant_need(need)
            except EsairError as error:
                _log.warning("%s: %s: %s", self.name, attribute, describe(error))
            else:
                port.revive(self._channel(resource), registration)

    def counts(self) -> dict[str, int]:
        """Return the counters, by name."""
        found = {
            "restarts": self._budget.restarts if self._budget is not None else 0,
            "inbox": len(self.inbox),
            "waiting": self.senders.count,
        }
        if self.runner is not None:
            found |= self.runner.counts()
        return found

    def status(self) -> BehaviorStatus:
        """Tell what it is doing."""
        runner = self.runner
        return BehaviorStatus(
            self.name,
            self.state,
            self.can_receive,
            self.can_send,
            self._budget.restarts if self._budget is not None else 0,
            self.error,
            next(filter(None, (each.detail for each in self.performs)), self.detail),
            runner.steps if runner is not None else 0,
            runner.late if runner is not None else 0,
            self.senders.count,
            runner.overruns if runner is not None else 0,
            sum(len(queue.waiting) for queue in self.queues.values()),
            sum(len(queue.working) for queue in self.queues.values()),
            self.dropped,
        )


class _UserRemovedError(BehaviorRemovedError, NotRegisteredError):
    """A behavior that was removed uses a port of its: both is true."""

    def __init__(self, behavior: str) -> None:
        EsairError.__init__(
            self, f"behavior {behavior!r} was removed: it is registered for nothing"
        )
        self.behavior = behavior
        self.resource = ""
        self.data = None


class _Perform:
    """A reaction that a behavior performs as a step of its own."""

    def __init__(
        self,
        reaction: Reaction,
        until: Callable[..., bool] | None,
        loop: asyncio.AbstractEventLoop,
        sight: Sight,
        blind_timeout: float | None,
        began: float,
        owner: Owner,
    ) -> None:
        self.sight = sight
        self.runner = _runner_for(
            reaction,
            sight,
            on_state=self._state,
            on_crash=self.crash,
            on_sight=self._sees,
            until=until,
            on_end=lambda: self.end(True),
            began=began,
            owner=owner,
        )
        self._loop = loop
        self._blind_timeout = blind_timeout
        self._blind_timer: asyncio.TimerHandle | None = None
        self._is_blind()
        self.needs = tuple(reaction.needs.values())
        self.own: list[Registration] = []
        """The registrations that end with it."""
        self.uses: list[Registration] = []
        self.ended: asyncio.Future[bool] = loop.create_future()

    @property
    def detail(self) -> str:
        """Why it does nothing, in words; empty if it does what it should."""
        reason = self.sight.reason
        return f"step {self.sight.name} is blind: {reason}" if reason else ""

    def stop(self) -> None:
        """Take no further step."""
        self.runner.stop()
        self._sees_again()

    def _state(self, running: bool, why: str) -> None:
        if not running:
            self.sight.blind(why)
            self._is_blind()

    def _is_blind(self) -> None:
        if self._blind_timeout is not None and self._blind_timer is None:
            self._blind_timer = self._loop.call_later(
                self._blind_timeout, self._blind_for_too_long
            )

    def _sees(self) -> None:
        self.sight.sees()
        self._sees_again()

    def _sees_again(self) -> None:
        if self._blind_timer is not None:
            self._blind_timer.cancel()
            self._blind_timer = None

    def _blind_for_too_long(self) -> None:
        self._blind_timer = None
        error = self.runner.absence()
        if error is not None:
            self.crash(error)

    def end(self, result: bool) -> None:
        if not self.ended.done():
            self.ended.set_result(result)

    def crash(self, error: BaseException) -> None:
        if not self.ended.done():
            self.ended.set_exception(_as_exception(error))
            self.ended.exception()  # the behavior may be cancelled in this moment


def _runner_for(
    reaction: Reaction,
    sight: Sight,
    *,
    on_state: Callable[[bool, str], None],
    on_crash: Callable[[BaseException], None],
    on_sight: Callable[[], None],
    until: Callable[..., bool] | None = None,
    on_end: Callable[[], None] | None = None,
    began: float = 0.0,
    owner: Owner | None = None,
) -> ReactionRunner:
    """Make what runs a reaction: one that moves something, or a guard."""
    if reaction.guarded is None:
        return ReactionRunner(
            reaction,
            on_state=on_state,
            on_crash=on_crash,
            on_sight=on_sight,
            until=until,
            on_end=on_end,
            began=began,
            owner=owner,
        )
    return GuardRunner(
        reaction,
        reaction.guarded[0],
        sight.guard,
        on_state=on_state,
        on_crash=on_crash,
        on_sight=on_sight,
        until=until,
        on_end=on_end,
        began=began,
        owner=owner,
    )


_ABSENCE = (
    DeviceFaultError,
    DeviceLostError,
    DriverStuckError,
    ResourceRemovedError,
    UnknownNameError,
)
"""What a behavior meets where a resource that it uses is not there, or not ready."""


def _check_seconds(component: str, field: str, value: object) -> None:
    if not is_positive(value):
        raise BadValueError(
            component, field, f"expected seconds > 0, not {value!r:.80}"
        )


def _max_age(need: Need) -> float | None:
    return need.max_age if isinstance(need, Reads) else None


def _as_exception(error: BaseException) -> Exception:
    """Make an error that is safe to raise in a task of somebody else."""
    if isinstance(error, Exception) and not isinstance(error, StopIteration):
        return error  # a future takes everything but a StopIteration
    wrapped = RuntimeError(f"it raised {describe(error)}")
    wrapped.__cause__ = error
    return wrapped


def _look_at(task: asyncio.Task[Any]) -> None:
    if not task.cancelled():
        task.exception()
