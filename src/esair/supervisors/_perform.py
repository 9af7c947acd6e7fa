"""A reaction that a behavior performs as a step of its own."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import TYPE_CHECKING

from esair.actions import GuardRunner, Hooks, Reaction, ReactionRunner
from esair.connections import Registration
from esair.exceptions import ConfigError
from esair.loop import Owner, fail, raisable
from esair.plan import examine_step, refuse
from esair.supervisors._grants import Grants, bind
from esair.supervisors._sight import Sight
from esair.values import check_duration

if TYPE_CHECKING:
    from esair.placement import Seat
    from esair.supervisors._behavior_deployment import BehaviorDeployment


class Steps:
    """The reactions that one behavior performs now."""

    __slots__ = ("_crew", "_grants", "_name", "now")

    def __init__(self, name: str, crew: BehaviorDeployment, grants: Grants) -> None:
        self._name = name
        self._crew = crew
        self._grants = grants
        self.now: tuple[Step, ...] = ()

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
            raise ConfigError(
                self._name,
                "perform",
                f"expected an esair.Reaction, not {reaction!r:.80}",
            )
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


class Step:
    """A reaction that is performed now: what runs it, and whether it sees."""

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
