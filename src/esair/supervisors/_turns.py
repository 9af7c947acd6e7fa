"""Behaviors in turns: which mode the robot is in, and how it goes to another one.

A switch has the order of ``replace``. Those who enter are set up while the old ones run.
Then, in one step: the protection of those who enter counts, and those who leave are
fenced off. When they have ended and what they moved is safe, the new ones begin.
Until that step whatever interrupts a switch leaves the old mode, from then on the new one.
"""

from __future__ import annotations

import asyncio
import logging
from typing import TYPE_CHECKING, Any

from esair.actions import Behavior
from esair.exceptions import (
    BehaviorFailedError,
    BehaviorRemovedError,
    EsairError,
    RefusedError,
    StoppingError,
    UnknownNameError,
    describe,
)
from esair.journal import Kind
from esair.loop import spawn, wake
from esair.messages import BehaviorState, Modes
from esair.values import printable

if TYPE_CHECKING:
    from esair.supervisors._behavior_deployment import BehaviorDeployment
    from esair.supervisors._member import Member

_log = logging.getLogger("esair")


class Turns:
    """The modes of one robot: who has the turn, and who rests.

    Attributes:
        modes: Who runs when.
        mode: The mode that the robot is in; None if it has none.
    """

    def __init__(self, crew: BehaviorDeployment, modes: Modes) -> None:
        self._crew = crew
        self.modes = modes
        self.mode = modes.first
        self._coming: str | None = None  # the mode that the newest switch goes to
        self._number = 0  # of the newest switch
        self._entering: list[Member] = []  # those that it sets up
        self._under_way: asyncio.Future[None] | None = None
        """Done when a switch has come to its end, one way or the other."""
        self._leave: asyncio.Future[None] | None = None
        """Done when those have ended whose turn is over, and what they moved is safe."""
        self._following: asyncio.Task[None] | None = None

    def rests(self, name: str) -> bool:
        """Tell whether a behavior rests in the mode that the robot is in."""
        return not self.modes.runs(name, self.mode)

    def rest(self, member: Member) -> bool:
        """Have a member that has not begun wait for its mode; tells whether it does."""
        if self.mode is not None and self.rests(member.name):
            member.detail = self._why(member)
            member.mail.become(BehaviorState.RESTING)
            return True
        return False

    def check_turn(self, name: str) -> None:
        """Pass if a behavior may be begun by the user now.

        Raises:
            RefusedError: It rests, or its mode is just coming.
        """
        member = self._crew.member(name)
        if self.rests(name) or (member.gate is not None and not member.gate.done()):
            raise RefusedError(f"{self._why(member)}: switch to its mode", name)

    async def left(self) -> None:
        """Wait until those have ended whose turn is over: then others may begin."""
        while self._leave is not None and not self._leave.done():
            self._crew.commands.changed()
            await asyncio.wait({self._leave})

    async def switch(self, mode: str, reason: str) -> None:
        """Go to a mode; see `BehaviorSupervisor.switch`."""
        if mode not in self.modes.table:
            raise UnknownNameError("mode", mode, self.modes.table)
        self._number = number = self._number + 1
        for member in self._entering:
            wake(member.ready)  # an earlier switch sees that it is none any more
        self._coming = mode
        try:
            while self._under_way is not None and not self._under_way.done():
                self._crew.commands.changed()
                await asyncio.wait({self._under_way})
            self._check_newest(number, mode)
            if mode == self.mode:
                return
            self._under_way = asyncio.get_running_loop().create_future()
            try:
                await self._set_up(number, mode, reason)
            finally:
                wake(self._under_way)
        finally:
            if number == self._number:
                self._coming = None
                self._crew.ended()

    def look(self) -> None:
        """Go to the mode that follows, if this one is at its end."""
        mode = self.modes.table.get(self.mode or "")
        if mode is None or self.busy:
            return
        found = [self._crew.members.get(name) for name in mode.behaviors]
        members = [member for member in found if member is not None]
        states = {m.name: m.mail.state for m in members}
        failed = [n for n, state in states.items() if state is BehaviorState.FAILED]
        behaviors = [m.name for m in members if isinstance(m.action, Behavior)]
        if failed and mode.on_failure:
            self._follow(mode.on_failure, f"{failed[0]} has failed")
        elif mode.then and behaviors and not failed:
            ended = (states[name] is BehaviorState.FINISHED for name in behaviors)
            if all(ended):
                self._follow(mode.then, f"{self.mode} has ended")

    @property
    def busy(self) -> bool:
        """Whether a switch is under way."""
        under_way = self._following, self._under_way
        waits = any(each is not None and not each.done() for each in under_way)
        return waits or self._coming is not None

    @property
    def waits(self) -> bool:
        """Whether the robot is in a mode that has no behavior of its own to end."""
        mode = self.modes.table.get(self.mode or "")
        members = map(self._crew.members.get, mode.behaviors if mode else ())
        return mode is not None and not any(
            member is not None and isinstance(member.action, Behavior)
            for member in members
        )

    # Inside.

    def _why(self, member: Member) -> str:
        there = " or ".join(self.modes.of_behavior(member.name))
        return f"it runs in mode {there}"

    def _check_newest(self, number: int, mode: str) -> None:
        if number != self._number:
            told = f"a newer switch to {self._coming} has come before"
            raise RefusedError(told, f"mode {mode}")

    async def _set_up(self, number: int, mode: str, reason: str) -> None:
        """Set up those who enter; the old mode goes on, and stays if that fails."""
        crew, loop = self._crew, asyncio.get_running_loop()
        entering = self._entering = [
            member
            for member in crew.members.values()
            if isinstance(member.action, Behavior) and self._enters(member, mode)
        ]
        try:
            for member in crew.members.values():
                misfit = member.misfit() if self._enters(member, mode) else ""
                if misfit:
                    raise BehaviorFailedError(member.name, misfit)
            for member in entering:
                member.gate = loop.create_future()
            try:
                await crew.begin(*entering)
            finally:
                self._check_newest(number, mode)
            for member in entering:
                if crew.members.get(member.name) is not member or member.given_up:
                    raise BehaviorRemovedError(member.name)
        except BaseException:
            left = [m for m in entering if crew.members.get(m.name) is m]
            left = [m for m in left if not m.mail.is_leaving]
            for member in left:
                member.rest(self._why(member))
            await crew.rested(*left)
            raise
        crew.commands.no_return()
        self._leave = loop.create_future()
        try:
            await self._take_turns(mode, entering, reason)
        finally:
            wake(self._leave)

    def _enters(self, member: Member, mode: str) -> bool:
        """Tell whether a member begins in a mode; one that is just removed does not."""
        begins = self.rests(member.name) and self.modes.runs(member.name, mode)
        return begins and not member.mail.is_leaving

    async def _take_turns(self, mode: str, set_up: list[Member], reason: str) -> None:
        """End the old ones, and let the new ones begin."""
        crew = self._crew
        members = [m for m in crew.members.values() if not m.mail.is_leaving]
        entering = [each for each in members if self._enters(each, mode)]
        here = [each for each in reversed(members) if not self.rests(each.name)]
        before, self.mode = self.mode, mode
        leaving = [each for each in here if self.rests(each.name)]
        for member in entering:
            member.sight.accept()
        for member in leaving:
            member.rest(self._why(member))
        crew.journal.publish(Kind.MODE, mode, "", before, reason)
        why = f": {printable(reason)}" if reason else ""
        _log.info("mode %s, after %s%s", mode, before, why)
        removed = [each.over for each in crew.ending if each.over is not None]
        await crew.rested(*leaving)
        if removed:  # the user is just taking them away: they end before, too
            await asyncio.wait(removed)
        for member in leaving:
            if member.mail.state is BehaviorState.RESTING:
                member.sight.rest()
        entering = [
            each
            for each in entering
            if crew.members.get(each.name) is each and not each.mail.is_leaving
        ]
        if crew.commands.is_closed:
            return  # the robot stops: nobody begins
        for member in entering:
            if member not in set_up:
                member.try_to_start()
        await crew.await_sight(entering)
        for member in entering:
            wake(member.gate)

    def _follow(self, mode: str, reason: str) -> None:
        self._following = spawn(
            asyncio.get_running_loop(), self._go(mode, reason), name=f"mode {mode}"
        )

    async def _go(self, mode: str, reason: str) -> None:
        """Go to a mode that follows; if that fails, to the one after a failure."""
        verbs: Any = self._crew.verbs
        here = self.modes.table[self.mode or ""]
        for each in dict.fromkeys([mode, here.on_failure or mode]):
            try:
                await verbs.switch(each, reason)
            except StoppingError:
                return
            except EsairError as error:
                told = describe(error)
                _log.error("mode %s: it does not go to %s: %s", self.mode, each, told)
            else:
                return
