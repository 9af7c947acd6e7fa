"""A member of the behavior supervisor: one behavior or reaction and its life."""

from __future__ import annotations

import asyncio
import inspect
import logging
from collections.abc import Awaitable, Callable, Collection
from functools import partial
from typing import TYPE_CHECKING, Any

from esair.actions import (
    ActuatorPort,
    Behavior,
    Hooks,
    PortTerms,
    Reaction,
    ReactionRunner,
    SensorPort,
    blocking,
    take_back,
)
from esair.connections import UNDECIDED, Halting, Registration, Stopped, run_ended
from esair.exceptions import (
    BehaviorRemovedError,
    EsairError,
    RefusedError,
    describe,
    lookable,
)
from esair.journal import Kind
from esair.loop import (
    Budget,
    Owner,
    Portal,
    fail,
    raisable,
    spawn,
    speaks_for_nobody,
    wake,
)
from esair.messages import BehaviorState, BehaviorStatus, is_placed
from esair.plan import examine_step, refuse
from esair.supervisors._grants import (
    BehaviorStep,
    Grants,
    Sight,
    Step,
    bind,
    fill,
    runner_for,
)
from esair.supervisors._life import (
    Life,
    Silence,
    UserRemovedError,
    absent,
    absent_for,
    cancel,
    living,
    silence_for,
    until_ended,
    where,
)
from esair.supervisors._mediator import Mailbox
from esair.values import check_duration

if TYPE_CHECKING:
    from esair.placement import StepSeat
    from esair.supervisors._behavior_deployment import BehaviorDeployment

_UNBOUND = frozenset({BehaviorState.RESTARTING, BehaviorState.RESTING})

_log = logging.getLogger("esair")


class Member:
    """Owns one behavior or reaction: its registrations, its task, its restarts.

    It is also the `Host` that the behavior talks to.
    """

    __slots__ = (
        "_lives",
        "_timer",
        "action",
        "crew",
        "detail",
        "gate",
        "given_up",
        "grants",
        "life",
        "mail",
        "name",
        "over",
        "portal",
        "ready",
        "runner",
        "sight",
        "steps",
        "task",
        "used",
    )

    def __init__(
        self, action: Behavior | Reaction, crew: BehaviorDeployment, name: str
    ) -> None:
        self.action: Behavior | Reaction = action
        self.name: str = name
        self.mail: Mailbox = Mailbox(action, crew.mediator, name, Owner(crew.context))
        """What others see of it: its state, and what they put there."""
        self.life: Life = Life(name, action.restart, crew.journal)
        self.detail: str = ""
        self.grants: Grants = Grants(name, crew)
        self.runner: ReactionRunner | None = None
        self.steps: tuple[Step | BehaviorStep, ...] = ()
        """What it performs now."""
        self.task: asyncio.Task[BaseException | None] | None = None
        self.ready: asyncio.Future[None] | None = None
        self.gate: asyncio.Future[None] | None = None
        """If there is one, ``run`` begins only when it is done."""
        self.over: asyncio.Future[None] | None = None
        """Done when it has been ended; there from when that begins."""
        self.given_up: bool = False
        """Nobody wants it any more: it is removed, or its place is."""
        self.crew: BehaviorDeployment = crew
        self._lives = 0
        self._timer: asyncio.TimerHandle | Silence | None = None
        """What begins it anew: a moment, or the next reading of a silent sensor."""
        self.portal: Portal | None = None
        self.sight: Sight = Sight(crew.resources.actuators.protections, action, name)
        """What it protects, and whether it sees."""
        if is_placed(action):
            self.mail.seat = crew.resources.seat_for(action)
        self.used: Collection[str] = ()
        """Which resources its last run has used; what it moved may not be safe yet."""

    # What the behavior asks (`Host`).

    def query(self, name: str) -> BehaviorStatus:
        return self.crew.member(name).status()

    async def manage(self, verb: str, *args: Any) -> Any:
        """Add, remove, replace or restart a behavior, if a policy allows it."""
        await Budget.spend()
        if speaks_for_nobody() or not self.mail.alive:
            raise BehaviorRemovedError(self.name)
        return await self.crew.managed_by(self.name, verb, *args)

    async def register(self, terms: PortTerms) -> SensorPort[Any] | ActuatorPort[Any]:
        return await self.register_for(self.grants, self.portal, terms)

    async def register_for(
        self, grants: Grants, portal: Portal | None, terms: PortTerms
    ) -> SensorPort[Any] | ActuatorPort[Any]:
        """Register it, or a step of it, for a resource."""
        await Budget.spend()
        self.mail.check_speaker()
        resource, access, wanted, priority, hold, max_age = terms
        if max_age is not None:
            check_duration(self.name, f"{resource}.max_age", max_age)
        grants.check_type(self.action, resource, access, wanted)
        right = grants.grant(resource, access, priority, hold)
        port = grants.port(right, max_age)
        return port if portal is None else blocking(port, portal)

    async def perform(
        self,
        reaction: Reaction,
        until: Callable[..., bool] | None,
        timeout: float | None,
        blind_timeout: float | None,
        seat: StepSeat | None = None,
        under: BehaviorStep | None = None,
    ) -> bool:
        """Run a reaction until its condition comes true or its time is over."""
        self._check_step(reaction)
        step = Step(reaction, self, until, blind_timeout, seat, under)
        return bool(await self._perform(step, timeout))

    async def perform_behavior(
        self,
        behavior: Behavior,
        timeout: float | None,
        under: BehaviorStep | None = None,
    ) -> Any:
        """Run a behavior to its end, in the task of its performer."""
        self._check_step(behavior)
        return await self._perform(BehaviorStep(behavior, self, under), timeout)

    def _check_step(self, action: Behavior | Reaction) -> None:
        self.mail.check_speaker()
        found = examine_step(self.crew.resources.plan, action, performer=self.name)
        refuse(found, f"what {self.name} performs is described wrongly")

    async def _perform(self, step: Step | BehaviorStep, timeout: float | None) -> Any:
        self.crew.performing[self] = None
        self.steps = (*self.steps, step)
        try:
            return await step.run(timeout)
        finally:
            self.steps = tuple(each for each in self.steps if each is not step)
            if not self.steps:
                self.crew.performing.pop(self, None)

    def halt_robot(self, reason: str) -> Halting:
        """Make every actuator safe, and keep it so."""
        return self.crew.halt_robot(reason, self.name)

    async def stop_robot(self, reason: str) -> Stopped:
        """Stop the robot in order, this behavior too."""
        return await self.crew.stop_robot(f"{self.name}: {reason}")

    # Life.

    def start(self) -> None:
        self.mail.become(BehaviorState.STARTING)
        self._lives += 1
        life = f"/{self._lives}" if self._lives > 1 else ""
        # Random numbers of its own for each life.
        self.mail.owner.stream = f"{self.crew.resources.seed}/{self.name}{life}"
        if self.mail.owner.over and (misfit := self.misfit()):
            self._runs(False, misfit)  # another device has come in the place of one
            return
        if isinstance(self.action, Reaction):
            self.sight.blind(UNDECIDED)
            sees = self.sight.sees
            hooks = Hooks(state=self._runs, crash=self._crashed, sight=sees)
            began, owner = self.crew.resources.began, self.mail.owner
            self.runner = runner_for(
                self.action, self.sight, hooks, began, owner, self.mail.seat
            )
            missing = [
                need.resource
                for need in self.action.needs.values()
                if not (need.optional or self.grants.is_there(need))
            ]
            if missing:
                self._runs(False, f"{', '.join(missing)} was removed")
            else:
                bind(self.runner, self.action, self.grants)
            return
        if self.mail.owner.over:
            self._take_owner()
        if self.mail.seat is not None:
            self.mail.seat.sit(self.mail.owner)
        if not inspect.iscoroutinefunction(self.action.run):
            self.portal = Portal(self.name, self.mail.owner)
        try:
            fill(self.action, self, self.grants, self.portal)
        except BaseException:
            self.fence()
            raise
        loop = asyncio.get_running_loop()
        self.ready = loop.create_future()
        self.task = spawn(
            loop, self._live(self.action), name=self.name, owner=self.mail.owner
        )
        if self.portal is not None:
            self.mail.carriers = (self.task,)
        self.task.add_done_callback(self._ended, context=self.crew.context)

    def _take_owner(self) -> None:
        """Have an owner for a new run, who also owns what outlives the one before."""
        survivors = self.mail.owner.living()
        stream, self.mail.owner = self.mail.owner.stream, Owner(self.crew.context)
        self.mail.owner.stream = stream
        for task in survivors:  # they would not end with the run before
            self.mail.owner.adopt(task)
        self.mail.outlived = bool(survivors)

    def try_to_start(self) -> None:
        """Start it; an error is a crash of its own."""
        try:
            self.start()
        except Exception as error:
            self._crashed(error)

    async def _live(self, behavior: Behavior) -> BaseException | None:
        """Run one incarnation; returns its error, so that nothing escapes a task."""
        error: BaseException | None = None
        owner = self.mail.owner
        try:
            await self._run(behavior.setup)
            if owner.over or self.given_up:  # its end came, and it went on
                raise asyncio.CancelledError
            if self.gate is not None:
                self._is_ready()
                await self.gate
            else:
                await self.crew.may_begin.wait()
            self._runs(True, "")
            await self._run(behavior.run)
        except asyncio.CancelledError as raised:
            # Its frames go: the task keeps it where the collector cannot see it.
            error = raised.with_traceback(None)
        except BaseException as raised:  # contained: one component's failure
            error = raised
        # Else it is another run's by now, or was done when its end was asked for.
        if asyncio.current_task() is self.task and self.mail.alive:
            self.mail.run_over(error)
        try:
            await self._run(behavior.teardown)
        except BaseException as raised:  # contained: one component's failure
            if error is None:
                error = raised
            else:
                _log.warning("%s: teardown failed too: %s", self.name, describe(raised))
        return error

    def _run(self, method: Callable[[], Any]) -> Awaitable[object]:
        if inspect.iscoroutinefunction(method):
            return method()  # type: ignore[no-any-return]
        return (self.portal or Portal(self.name, self.mail.owner)).run(method)

    def _runs(self, running: bool, why: str) -> None:
        self.detail = why
        if self.mail.is_leaving:
            return
        before = self.mail.state
        now = BehaviorState.RUNNING if running else BehaviorState.PARKED
        self.mail.become(now)
        self._is_ready()
        if not running:
            self.sight.blind(why)
        elif isinstance(self.action, Behavior):
            self.sight.sees()
        if running:
            if self.mail.senders.count:
                self.mail.admit()
            for queue in (self.mail.askers, *self.mail.queues.values()):
                if queue.count:
                    queue.roused()
        if before is not self.mail.state:
            self.life.tell(
                Kind.RUNNING if running else Kind.PARKED, self.mail.error, why
            )
        if before is BehaviorState.RUNNING and not running:
            _log.info("%s: parked: %s", self.name, why)
        elif before is BehaviorState.PARKED and running:
            _log.info("%s: runs", self.name)

    def _is_ready(self) -> None:
        wake(self.ready)
        self.ready = None

    def _ended(self, task: asyncio.Task[BaseException | None]) -> None:
        if task is not self.task or self.mail.is_leaving:
            return
        error = asyncio.CancelledError() if task.cancelled() else task.result()
        if error is None:
            self.mail.become(BehaviorState.FINISHED)
            self.life.tell(Kind.FINISHED)
            self.fence()
            self.crew.mediator.asker_ended(self.mail)
            self.crew.mediator.peer_finished(self.mail)
            cancel(self.mail.owner)
            self.crew.ended()
        else:
            self._crashed(error)

    def _crashed(self, error: BaseException) -> None:
        """Make safe what it held, and start it again unless its budget is spent."""
        error = lookable(error)
        self.mail.error = error
        self.life.tell(Kind.CRASHED, error, describe(error))
        self.sight.blind(f"it failed: {describe(error)}")
        self._cut_off(error)
        ready = self.ready
        if ready is not None and not ready.done() and self in self.crew.coming:
            self.mail.become(BehaviorState.FAILED)
            fail(ready, self.mail.failure(raisable(error)))
            return
        self._is_ready()
        resources = self.crew.resources
        missing = absent_for(error, self.action, resources.is_ready)
        channels = resources.sensors.channels
        silence = silence_for(error, self.action, channels, self._resource_heard)
        if missing or silence:
            # Not its own fault: it begins anew when everything it uses is there.
            self.mail.become(BehaviorState.PARKED)
            if silence:
                self._timer = silence
                silence.channel.follow(silence)
                self.detail = f"{silence.channel.name} is silent"
            else:
                verb = "is" if len(missing) == 1 else "are"
                self.detail = f"{', '.join(missing)} {verb} not there"
            self.sight.blind(self.detail)
            self.life.tell(Kind.PARKED, error, self.detail)
            _log.info("%s: parked: %s", self.name, self.detail)
            self.crew.mediator.peer_failed(self.mail, error)
            return
        self.begin_again(error)

    def begin_again(self, error: BaseException) -> None:
        """Begin anew after a crash, when its budget says so; else it has failed."""
        loop = asyncio.get_running_loop()
        pause = self.life.pause_after(error, loop.time())
        if pause is None:
            self.mail.become(BehaviorState.FAILED)
        else:
            self.mail.become(BehaviorState.RESTARTING)
            if not self.life.retries:
                _log.warning(
                    "%s: failed: %s; restart %d in %g s",
                    self.name,
                    describe(error),
                    self.life.restarts,
                    pause,
                    exc_info=raisable(error),
                )
            self._timer = loop.call_later(pause, self._restart)
        self.crew.mediator.peer_failed(self.mail, error)
        if pause is None:
            if self.action.essential:
                self.crew.essential_failed(self.mail.failure())
            self.crew.ended()

    def resource_up(self, resource: str) -> None:
        """Begin anew if this was the last resource that was not there."""
        awaited = self._timer
        if (
            (self.runner is None or self.runner.stopped)
            and self.mail.state is BehaviorState.PARKED
            and not absent(self.action, self.crew.resources.is_ready)
            and not (isinstance(awaited, Silence) and awaited.channel.name != resource)
        ):
            self._no_restart()
            _log.info("%s: goes on: %s is back", self.name, resource)
            self._restart()

    def _resource_heard(self, resource: str) -> None:
        """Begin anew: a sensor has spoken that was silent; if nothing else is missing."""
        self._no_restart()
        self.resource_up(resource)

    def _no_restart(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _restart(self) -> None:
        self.life.tell(Kind.RESTARTED, self.mail.error)
        self.try_to_start()

    def uses(self) -> list[Registration]:
        found = list(self.grants.registrations)
        for step in self.steps:
            found += step.own
        return found

    def fence(self, reason: Callable[[], EsairError] | None = None) -> None:
        """Revoke all its registrations in one step; what it moved is made safe."""
        if self.runner is not None:
            self.runner.stop()
        uses = self.uses()
        if uses:
            self.used = {each.resource for each in uses}
        for registration in uses:
            if registration.reason is None:  # else the robot stops
                ended = partial(run_ended, self.name, registration.resource)
                self.crew.resources.control.revoke(registration, reason or ended)
        self.grants.registrations.clear()
        if self.portal is not None:
            self.portal.close()
        for step in self.steps:
            if step.portal is not None:
                step.portal.close()

    def stop(self) -> None:
        """Cut it off, whatever it does; its tasks are the caller's to end."""
        self.mail.become(BehaviorState.STOPPING)
        if self._timer is not None:
            self._no_restart()
        self.fence(lambda: UserRemovedError(self.name))
        self.give_up()
        self.crew.mediator.asker_ended(self.mail)
        self.mail.run_over(None)
        if self.mail.takers:
            wake(*self.mail.takers)

    def stopped(self) -> None:
        """Its tasks have ended, or would not: it is gone."""
        self.task = None
        if self.mail.seat is not None:
            self.mail.seat.rise()
        take_back(self.action, self, self.portal)
        self.mail.become(BehaviorState.REMOVED)

    def end_run(self) -> None:
        """End the run, so that another may begin."""
        self.mail.error = None
        self.sight.blind("it is restarted by the user")
        self._no_more(BehaviorState.RESTARTING)

    async def run_ended(self, grace: float) -> None:
        """Wait until the run has ended, and may begin anew."""
        await until_ended(living(self.mail.owner), grace)
        if self.mail.is_leaving:
            raise BehaviorRemovedError(self.name)
        if self.mail.state is not BehaviorState.RESTARTING:
            raise RefusedError("a newer command has begun it, or ended it", self.name)

    def rest(self, why: str) -> None:
        """End the run: it waits for a mode in which it runs."""
        self.detail = why
        self._no_more(BehaviorState.RESTING)

    def _no_more(self, state: BehaviorState) -> None:
        self.mail.become(state)
        self._no_restart()
        self._is_ready()
        self.task = self.gate = None
        self.life.fill()
        self._cut_off(None)

    def _cut_off(self, error: BaseException | None) -> None:
        """Let nothing of this run reach anything any more."""
        self.fence()
        self.mail.run_over(error)
        self.crew.mediator.asker_ended(self.mail)
        self.mail.owner.over = self.mail.outlived = True
        cancel(self.mail.owner)

    def give_up(self) -> None:
        """End whoever waits for its setup, and what would wait for its turn to run."""
        self.given_up = True
        for future in (self.ready, self.gate):
            if future is not None:
                fail(future, BehaviorRemovedError(self.name))

    def misfit(self) -> str:
        """Say why it cannot begin anew with what is there now; empty if it can."""
        needs = self.action.needs.values()
        found = (self.grants.misfit(self.action, need.provider) for need in needs)
        return next(filter(None, found), "")

    def resource_changed(self, resource: str) -> None:
        """Bind an action anew when one of its resources was added or removed."""
        for step in self.steps:
            step.resource_changed(resource)
        if not self.mail.alive or self.mail.state in _UNBOUND:
            return  # it will be bound anew in any case
        is_gone = resource not in self.crew.resources.lives
        needs = (n for n in self.action.needs.values() if n.provider == resource)
        if all(is_gone and need.optional for need in needs):
            return  # it does not use it, or has had None for it since it went
        misfit = self.grants.misfit(self.action, resource)
        if not isinstance(self.action, Reaction):
            if not misfit:
                self.grants.revive(self.action.needs, resource)
            return
        self.fence()
        if misfit:
            self._runs(False, misfit)
        else:
            self.try_to_start()

    def counts(self) -> dict[str, int]:
        mail, runner = self.mail, self.runner
        return {
            "restarts": self.life.restarts,
            "inbox": len(mail.inbox),
            "waiting": mail.senders.count,
            "dropped": mail.dropped,
            "turned_away": mail.turned_away,
            **(runner.counts() if runner is not None else {}),
        }

    def status(self) -> BehaviorStatus:
        mail, counts = self.mail, self.counts()
        return BehaviorStatus(
            self.name,
            mail.state,
            mail.can_receive,
            mail.can_send,
            counts["restarts"],
            mail.error,
            next(filter(None, (each.detail for each in self.steps)), self.detail),
            counts.get("steps", 0),
            counts.get("late", 0),
            counts["waiting"],
            counts.get("overruns", 0),
            sum(queue.count for queue in mail.queues.values()),
            sum(len(queue.working) for queue in mail.queues.values()),
            mail.dropped,
            *where(self.mail.seat),
        )
