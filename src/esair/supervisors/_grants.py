"""What one component may use, what it protects, and the steps that it performs."""

from __future__ import annotations

import asyncio
import inspect
import logging
from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

from esair.actions import (
    ActuatorPort,
    Behavior,
    GuardRunner,
    Guards,
    Hooks,
    Need,
    PortTerms,
    ProfiledAction,
    Reaction,
    ReactionRunner,
    Reads,
    SensorPort,
    Writes,
    blocking,
    give,
    run_as_step,
    take_back,
)
from esair.connections import (
    UNDECIDED,
    ActuatorChannel,
    Protection,
    Protections,
    Registration,
    SensorChannel,
    Terms,
)
from esair.exceptions import (
    AccessDeniedError,
    BadValueError,
    EsairError,
    describe,
)
from esair.loop import Deadline, Deadlines, Owner, Portal, fail, raisable, wake
from esair.messages import Access
from esair.plan import refuse, unmet
from esair.supervisors._control_path import only_the_user
from esair.values import check_duration, printable

if TYPE_CHECKING:
    from esair.placement import Seat, StepSeat
    from esair.supervisors._behavior_deployment import BehaviorDeployment
    from esair.supervisors._member import Member


_log = logging.getLogger("esair")


class Sight:
    """Keeps the entries of one component in the table, from its acceptance on."""

    __slots__ = ("_action", "_decided", "_table", "entries", "name", "reason")

    def __init__(
        self,
        table: Protections,
        action: ProfiledAction,
        name: str,
        *,
        step_of: str = "",
    ) -> None:
        self._table = table
        self._action = action
        self.name = name
        self.entries: tuple[Protection, ...] = tuple(
            Protection(
                step_of or name,
                need.resource,
                need.priority,
                label=f"step {name} of {step_of}" if step_of else name,
                guards=isinstance(need, Guards),
                latch=isinstance(need, Guards) and need.latch,
            )
            for need in action.needs.values()
            if action.holds_when_blind(need)
        )
        self.reason: str = UNDECIDED  # why it cannot decide; empty if it can
        self._decided: asyncio.Future[None] | None = None

    @property
    def guard(self) -> Protection:
        return self.entries[0]

    def accept(self) -> None:
        """Enter the table: it is blind until its first decision."""
        self.reason, self._decided = UNDECIDED, None
        if self.entries:  # a latch has stayed while its guard rested
            self._table.blind(self.entries, UNDECIDED)
            self._table.enter(each for each in self.entries if not each.latched)

    def rest(self) -> None:
        """Leave the table for a while; a latch stays, which only the user ends."""
        self._table.leave(each for each in self.entries if not each.latched)
        self._table.blind(self.entries, "it rests")

    def stand_by(self) -> None:
        """Enter the table where the one whose place it will take has no entry."""
        there = {
            entry.actuator for entry in self._table if entry.component == self.name
        }
        self._table.enter(each for each in self.entries if each.actuator not in there)

    def take_over(self, old: Sight, *, rests: bool) -> None:
        """Take the place of another; of one that rests only a latch is in the table."""
        for each in self.entries:
            for before in old.entries:
                each.inherit(before)
        there = set(self._table)
        self._table.enter(
            each
            for each in self.entries
            if each not in there and (each.latched or not rests)
        )
        self._table.leave(old.entries)
        if rests:
            self.rest()

    def blind(self, reason: str) -> None:
        """Take note why it cannot decide; empty if it can."""
        self.reason = reason
        if self.entries:
            self._table.blind(self.entries, reason)

    def sees(self) -> None:
        self.reason = ""
        if self.entries:
            self._table.blind(self.entries, "")
        if self._decided is not None:
            wake(self._decided)

    def leave(self) -> None:
        self._table.leave(self.entries)

    def removed(self) -> None:
        """Leave the table because the user took the component away."""
        self.leave()
        for entry in self.entries:
            doing = "guards" if entry.guards else "keeps safe, when blind,"
            _log.info(
                "%s: removed; it no longer %s %s", self.name, doing, entry.actuator
            )

    def decided(self) -> asyncio.Future[None]:
        """Return a future that is done when it has decided for the first time."""
        if self._decided is None:
            self._decided = asyncio.get_running_loop().create_future()
            if not self.reason:
                self._decided.set_result(None)
        return self._decided

    # What the user may do.

    def mute(self, seconds: float, reason: str) -> None:
        """Let everything pass for a while."""
        only_the_user(self.name, "mute", "lets pass what is protected")
        self._check_protects("mute")
        check_duration(self.name, "seconds", seconds)
        limit = getattr(self._action, "mute_limit", 0.0)
        if seconds > limit:
            told = f"expected {limit:g} s at most (its mute_limit), not {seconds:g}"
            raise BadValueError(self.name, "seconds", told)
        if not isinstance(reason, str) or not reason.strip():
            raise BadValueError(self.name, "reason", "say why in a few words")
        self._table.mute(self.entries, seconds, reason)
        told = printable(reason)
        _log.warning("%s: muted for %g s by the user: %s", self.name, seconds, told)

    def reset(self) -> None:
        """End the latch of a guard."""
        only_the_user(self.name, "reset", "ends a latch")
        self._check_protects("reset")
        for entry in self.entries:
            if not entry.latch:
                told = "it has no latch: esair.guards(..., latch=True)"
                raise BadValueError(self.name, "reset", told)
            why = entry.why_latched_still()
            if why:
                raise AccessDeniedError("user", self.name, "reset", why)
        self._table.reset(self.entries)
        _log.warning("%s: reset by the user", self.name)

    def _check_protects(self, field: str) -> None:
        if not self.entries:
            raise BadValueError(self.name, field, "it protects no actuator")


Action = Behavior | Reaction
Port = SensorPort[Any] | ActuatorPort[Any]


_NO_PORTS: Mapping[str, Port] = {}


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
        self._ports: Mapping[str, Port] = _NO_PORTS
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
        port = self.port(self.of_need(need), max_age)
        self._ports = {**self._ports, attribute: port}
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
    queues = host.mail.queues

    def port_of(attribute: str, need: Need) -> Any:
        port = grants.declare(attribute, need)
        return blocking(port, portal) if portal else port

    give(
        *(behavior, host, host.mail, portal, port_of),
        (lambda _, each: queues[each.type].loop) if queues else None,
    )


class BehaviorStep:
    """A behavior that is performed now, and the `Host` that it talks to.

    It runs in the task of its performer: errors, cancellation and time limits are those
    of any coroutine. It speaks in the name of its performer; its rights are its own
    registrations in that name, which end with it.
    """

    def __init__(
        self, behavior: Behavior, member: Member, under: BehaviorStep | None
    ) -> None:
        self.behavior, self._member = behavior, member
        self.under = under  # the step that performs it, if it is not its member
        self.needs = tuple(behavior.needs.values())
        self.mail = member.mail
        self.grants = Grants(member.name, member.crew, member.action.needs)
        self.own = self.grants.registrations
        self._is_over = False
        self.runner = None
        self.detail = f"performs {behavior.name}"
        self._sight = _sight_of_step(behavior, member)
        self.portal: Portal | None = None
        if not inspect.iscoroutinefunction(behavior.run):
            self.portal = Portal(member.name, member.mail.owner)
        self.crew, self.query, self.manage = member.crew, member.query, member.manage
        self.perform = partial(member.perform, under=self)
        self.perform_behavior = partial(member.perform_behavior, under=self)
        self.halt_robot, self.stop_robot = member.halt_robot, member.stop_robot

    async def register(self, terms: PortTerms) -> SensorPort[Any] | ActuatorPort[Any]:
        return await self._member.register_for(self.grants, self.portal, terms)

    async def run(self, timeout: float | None) -> Any:
        """Set it up, run it, and clean up; returns what its run returns."""
        behavior, member = self.behavior, self._member
        late: Deadline | None = None
        if timeout is not None:  # whatever it does then, it moves nothing
            deadlines = Deadlines.of(asyncio.get_running_loop())
            late = deadlines.after(timeout + member.crew.grace, self.end)
        self._sight.accept()
        try:
            fill(behavior, self, self.grants, self.portal)
            way, owner, sees = self.portal, self.mail.owner, self._sight.sees
            return await run_as_step(behavior, member.name, way, owner, timeout, sees)
        finally:
            if late is not None:
                late.cancel()
            self.end()
            self._sight.leave()
            if self.portal is not None:
                self.portal.close()

    def end(self) -> None:
        """Let it move nothing any more, nor what it performs, whatever they do."""
        self._is_over = True
        for step in self._member.steps:
            if step.under is self:
                step.end()
        for registration in tuple(self.own):
            self._member.crew.resources.control.revoke(registration)
        take_back(self.behavior, self, self.portal)  # it gets no others, either

    def resource_changed(self, resource: str) -> None:
        """Give its ports their rights to a resource again that has come back."""
        if not self._is_over:
            self.grants.revive(self.behavior.needs, resource)


class Step:
    """A reaction that is performed now: what runs it, and whether it sees."""

    portal = None

    def __init__(
        self,
        reaction: Reaction,
        member: Member,
        until: Callable[..., bool] | None,
        blind_timeout: float | None,
        seat: Seat | StepSeat | None,
        under: BehaviorStep | None,
    ) -> None:
        self._reaction, self._member = reaction, member
        self.under = under  # as that of a behavior
        self.sight = sight = _sight_of_step(reaction, member)
        hooks = Hooks(
            state=self._state,
            crash=self.crash,
            sight=self._sees,
            end=lambda: self.end(True),
            until=until,
        )
        began, owner = member.crew.resources.began, member.mail.owner
        self.runner = runner_for(reaction, sight, hooks, began, owner, seat)
        self._loop = loop = asyncio.get_running_loop()
        self._blind_timeout = blind_timeout
        self._blind_timer = Deadlines.of(loop).idle(self._blind_for_too_long)
        self._is_blind()
        self.needs = tuple(reaction.needs.values())
        self.own: list[Registration] = []  # the registrations that end with it
        self._uses: list[Registration] = []
        self._ended: asyncio.Future[bool] = loop.create_future()

    async def run(self, timeout: float | None) -> bool:
        """Run it until its condition comes true or its time is over."""
        self.sight.accept()
        timer, began = None, self._loop.time()
        try:
            self._uses = bind(
                self.runner, self._reaction, self._member.grants, self.own
            )
            if timeout is not None:
                timer = self._loop.call_later(timeout, self.end, False)
            return await self._ended
        finally:
            if timer is not None:
                timer.cancel()
            self.runner.stop()
            self._blind_timer.cancel()
            for registration in self.own:
                self._member.crew.resources.control.revoke(registration)
            for output in self.runner.outputs.all.values():
                # One that is its behavior's, too, stays; what the step did with it ends.
                hold, right = output.channel.hold, output.registration
                gave_back = hold.holder is None and hold.writer is right
                if output.active or (gave_back and hold.begun >= began):
                    output.channel.drop(right)
            self.sight.leave()

    @property
    def detail(self) -> str:
        """Why it does nothing, in words; empty if it does what it should."""
        reason = self.sight.reason
        return f"step {self.sight.name} is blind: {reason}" if reason else ""

    def resource_changed(self, resource: str) -> None:
        """It is bound for as long as it lasts: what has gone ends it."""
        for registration in self._uses:
            if registration.reason is not None:
                self.crash(registration.reason())

    def _state(self, running: bool, why: str) -> None:
        if not running:
            self.sight.blind(why)
            self._is_blind()

    def _is_blind(self) -> None:
        if self._blind_timeout is not None:
            self._blind_timer.start_by(self._loop.time() + self._blind_timeout)

    def _sees(self) -> None:
        self.sight.sees()
        self._blind_timer.cancel()

    def _blind_for_too_long(self) -> None:
        error = self.runner.absence()
        if error is not None:
            self.crash(error)

    def end(self, result: bool = False) -> None:
        if not self._ended.done():
            self._ended.set_result(result)

    def crash(self, error: BaseException) -> None:
        fail(self._ended, raisable(error))


def _sight_of_step(action: ProfiledAction, member: Member) -> Sight:
    table = member.crew.resources.actuators.protections
    return Sight(table, action, action.name, step_of=member.name)


def runner_for(
    reaction: Reaction,
    sight: Sight,
    hooks: Hooks,
    began: float,
    owner: Owner,
    seat: Seat | StepSeat | None = None,
) -> ReactionRunner:
    """Make what runs a reaction: one that moves something, here or there, or a guard."""
    if seat is not None:
        from esair.placement import PlacedRunner

        return PlacedRunner(reaction, seat, hooks, began=began, owner=owner)
    if reaction.guarded is None:
        return ReactionRunner(reaction, hooks, began=began, owner=owner)
    port, guard = reaction.guarded[0], sight.guard
    return GuardRunner(reaction, port, guard, hooks, began=began, owner=owner)
