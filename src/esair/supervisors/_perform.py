"""What a behavior performs as a step of its own: a reaction, or another behavior."""

from __future__ import annotations

import asyncio
import inspect
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from esair.actions import (
    ActuatorPort,
    Behavior,
    GuardRunner,
    Hooks,
    Reaction,
    ReactionRunner,
    SensorPort,
    Terms,
)
from esair.connections import Registration
from esair.exceptions import BehaviorUnavailableError, ConfigError
from esair.loop import Owner, Portal, fail, raisable
from esair.plan import examine_step, refuse
from esair.supervisors._grants import Grants, bind, empty, fill
from esair.supervisors._sight import Sight
from esair.values import check_duration

if TYPE_CHECKING:
    from esair.placement import Seat
    from esair.supervisors._behavior_deployment import BehaviorDeployment
    from esair.supervisors._member import Member


class Steps:
    """What one behavior performs now."""

    __slots__ = ("_crew", "_grants", "_name", "now")

    def __init__(self, name: str, crew: BehaviorDeployment, grants: Grants) -> None:
        self._name = name
        self._crew = crew
        self._grants = grants
        self.now: tuple[Step | BehaviorStep, ...] = ()

    async def perform(
        self,
        reaction: Reaction,
        owner: Owner,
        until: Callable[..., bool] | None,
        timeout: float | None,
        blind_timeout: float | None,
    ) -> bool:
        """Run a reaction until its condition comes true or its time is over."""
        for field, seconds in (("timeout", timeout), ("blind_timeout", blind_timeout)):
            if seconds is not None:
                check_duration(self._name, field, seconds)
        if not isinstance(reaction, Reaction):
            told = f"expected a Reaction or a Behavior, not {reaction!r:.80}"
            raise ConfigError(self._name, "perform", told)
        found = examine_step(self._crew.resources.plan, reaction, performer=self._name)
        refuse(found, f"what {self._name} performs is described wrongly")
        resources = self._crew.resources
        table = resources.actuators.protections
        sight = Sight(table, reaction, reaction.name, step_of=self._name)
        step = Step(reaction, sight, blind_timeout, until, resources.began, owner)
        self.now = (*self.now, step)
        sight.accept()
        timer = None
        try:
            step.uses = bind(step.runner, reaction, self._grants, step.own)
            if timeout is not None:
                loop = asyncio.get_running_loop()
                timer = loop.call_later(timeout, step.end, False)
            return await step.ended
        finally:
            if timer is not None:
                timer.cancel()
            step.stop()
            self.now = tuple(each for each in self.now if each is not step)
            for registration in step.own:
                resources.control.revoke(registration)
            sight.leave()

    async def perform_behavior(
        self, behavior: Behavior, member: Member, timeout: float | None
    ) -> Any:
        """Run a behavior to its end, in the task of its performer."""
        if timeout is not None:
            check_duration(self._name, "timeout", timeout)
        plan = self._crew.resources.plan
        found = examine_step(plan, behavior, performer=self._name)
        refuse(found, f"what {self._name} performs is described wrongly")
        step = BehaviorStep(behavior, member)
        self.now = (*self.now, step)
        try:
            return await step.run(timeout)
        finally:
            self.now = tuple(each for each in self.now if each is not step)


class BehaviorStep:
    """A behavior that is performed now, and the `Host` that it talks to.

    It runs in the task of its performer: errors, cancellation and time limits are those
    of any coroutine. It speaks in the name of its performer; its rights are its own
    registrations in that name, which end with it.
    """

    def __init__(self, behavior: Behavior, member: Member) -> None:
        self.behavior, self._member = behavior, member
        self.needs = tuple(behavior.needs.values())
        self.mail = member.mail
        self.grants = Grants(member.name, member.crew, member.action.needs)
        self.own = self.grants.registrations
        self.uses: tuple[Registration, ...] = ()  # its ports tell it what has gone
        self.runner = None
        self.detail = f"performs {behavior.name}"
        table = member.crew.resources.actuators.protections
        self._sight = Sight(table, behavior, behavior.name, step_of=member.name)
        self.portal: Portal | None = None
        if not inspect.iscoroutinefunction(behavior.run):
            self.portal = Portal(member.name, member.mail.owner)
        self.query, self.manage = member.query, member.manage
        self.perform, self.perform_behavior = member.perform, member.perform_behavior
        self.halt_robot, self.stop_robot = member.halt_robot, member.stop_robot

    async def register(self, terms: Terms) -> SensorPort[Any] | ActuatorPort[Any]:
        return await self._member.register_for(self.grants, self.portal, terms)

    async def run(self, timeout: float | None) -> Any:
        """Set it up, run it, and clean up; returns what its run returns."""
        behavior, member = self.behavior, self._member
        control = member.crew.resources.control
        self._sight.accept()
        try:
            fill(behavior, self, self.grants, self.portal)
            try:
                async with asyncio.timeout(timeout) as limit:
                    await self._call(behavior.setup)
                    self._sight.sees()
                    return await self._call(behavior.run)
            except TimeoutError:
                if timeout is None or not limit.expired():
                    raise
                told = "come to its end"
                state = f"a step of {member.name}"
                raise BehaviorUnavailableError(
                    behavior.name, told, timeout, state
                ) from None
            finally:
                await self._call(behavior.teardown)
        finally:
            for registration in tuple(self.own):
                control.revoke(registration)
            self._sight.leave()
            empty(behavior, self, self.portal)
            if self.portal is not None:
                self.portal.close()

    def revive(self, resource: str) -> None:
        """Give its ports their rights to a resource again that has come back."""
        self.grants.revive(self.behavior.needs, resource)

    async def _call(self, method: Callable[[], Any]) -> Any:
        if inspect.iscoroutinefunction(method):
            return await method()
        found: list[Any] = [None]
        way = self.portal
        if way is None or way.closed:
            way = Portal(self._member.name, self.mail.owner)
        await way.run(lambda: found.append(method()))
        return found[-1]


class Step:
    """A reaction that is performed now: what runs it, and whether it sees."""

    portal = None

    def __init__(
        self,
        reaction: Reaction,
        sight: Sight,
        blind_timeout: float | None,
        until: Callable[..., bool] | None,
        began: float,
        owner: Owner,
    ) -> None:
        self.sight = sight
        hooks = Hooks(
            state=self._state,
            crash=self.crash,
            sight=self._sees,
            end=lambda: self.end(True),
            until=until,
        )
        self.runner = runner_for(reaction, sight, hooks, began, owner)
        self._loop = loop = asyncio.get_running_loop()
        self._blind_timeout = blind_timeout
        self._blind_timer: asyncio.TimerHandle | None = None
        self._is_blind()
        self.needs = tuple(reaction.needs.values())
        self.own: list[Registration] = []  # the registrations that end with it
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

    def revive(self, resource: str) -> None:
        """It is bound for as long as it lasts: what has gone ends it."""

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
        fail(self.ended, raisable(error))


def runner_for(
    reaction: Reaction,
    sight: Sight,
    hooks: Hooks,
    began: float,
    owner: Owner,
    seat: Seat | None = None,
) -> ReactionRunner:
    """Make what runs a reaction: one that moves something, here or there, or a guard."""
    if seat is not None:
        from esair.placement import PlacedRunner

        return PlacedRunner(reaction, seat, hooks, began=began, owner=owner)
    if reaction.guarded is None:
        return ReactionRunner(reaction, hooks, began=began, owner=owner)
    port, guard = reaction.guarded[0], sight.guard
    return GuardRunner(reaction, port, guard, hooks, began=began, owner=owner)
