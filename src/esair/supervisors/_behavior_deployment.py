"""What behaviors and reactions a robot has now: how each begins, and how it ends.

And in turns, by modes. A switch has the order of ``replace``: those who enter are set up while
the old ones run. Then, in one step: the protection of those who enter counts, and those who
leave are fenced off. When they have ended and what they moved is safe, the new ones begin.
Until that step whatever interrupts a switch leaves the old mode, from then on the new one.
"""

from __future__ import annotations

import asyncio
import contextvars
import itertools
import logging
import math
from collections.abc import Awaitable, Callable, Iterable, Iterator, Mapping
from typing import Any, NamedTuple

from esair import abc
from esair.actions import Behavior, Reaction, ReactionRunner
from esair.connections import Halting, Stopped
from esair.exceptions import (
    AccessDeniedError,
    BehaviorFailedError,
    BehaviorRemovedError,
    ConfigError,
    EsairError,
    RefusedError,
    StoppingError,
    UnknownNameError,
    describe,
)
from esair.journal import Event, Journal, Kind
from esair.loop import (
    REACHED,
    ProcessWatch,
    current_owner,
    fail,
    ignore,
    look_at,
    script_context,
    spawn,
    wake,
)
from esair.messages import Access, BehaviorsPolicy, BehaviorState, Modes
from esair.plan import Finding, refuse
from esair.supervisors._command_queue import CommandQueue
from esair.supervisors._life import end, living, side_by_side
from esair.supervisors._mediator import Mediator
from esair.supervisors._member import Member
from esair.supervisors._resource_deployment import ResourceDeployment
from esair.values import printable

_log = logging.getLogger("esair")

ROUND = 0.5
"""How long after it was gone to a mode follows again at the earliest, in seconds."""


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
        self.leave: asyncio.Future[None] | None = None
        """There while those end whose turn is over, until what they moved is safe."""
        self._following: asyncio.Task[bool] | None = None
        self._begun: dict[str, float] = {}  # when each mode was gone to last
        self.round: asyncio.TimerHandle | None = None
        """There while a mode would follow again too soon."""

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
        coming = member.mail.state is BehaviorState.RESTING or (
            member.gate is not None and not member.gate.done()
        )
        if coming or self.rests(name):
            raise RefusedError(f"{self._why(member)}: switch to its mode", name)

    async def left(self) -> None:
        """Wait until those have ended whose turn is over: then others may begin."""
        while self.leave is not None:
            self._crew.commands.changed()
            await asyncio.wait({self.leave})

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
        return waits or self._coming is not None or self.round is not None

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
                if self._enters(member, mode) and (misfit := member.misfit()):
                    raise BehaviorFailedError(member.name, misfit)
            for member in entering:
                member.gate = loop.create_future()
            try:
                await crew.begin(*entering)
            finally:
                self._check_newest(number, mode)
            for member in entering:
                if member.given_up:
                    raise BehaviorRemovedError(member.name)
        except BaseException:
            left = self._still(entering)
            for member in left:
                member.rest(self._why(member))
            await crew.rested(*left)
            raise
        crew.commands.no_return()
        self.leave = leave = loop.create_future()
        try:
            await self._take_turns(mode, entering, reason)
        finally:
            self.leave = None
            wake(leave)

    def _still(self, members: list[Member]) -> list[Member]:
        """Return which of them nobody has removed or replaced, or does."""
        there = self._crew.members
        return [m for m in members if there.get(m.name) is m and not m.mail.is_leaving]

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
        self._begun[mode] = asyncio.get_running_loop().time()
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
        entering = self._still(entering)
        if crew.commands.is_closed:
            return  # the robot stops: nobody begins
        for member in entering:
            if member not in set_up:
                member.try_to_start()
        await crew.await_sight(entering)
        for member in entering:
            wake(member.gate)

    def _follow(self, mode: str, reason: str) -> None:
        loop = asyncio.get_running_loop()
        early = self._begun.get(mode, -math.inf) + ROUND - loop.time()
        if early > REACHED:  # modes that end at once, in a circle, would take the loop
            self.round = loop.call_later(early, self._round_over)
            return
        self._following = spawn(loop, self._go(mode, reason), name=f"mode {mode}")
        self._following.add_done_callback(self._look_again)

    def _round_over(self) -> None:
        self.round = None
        self._crew.ended()

    def _look_again(self, went: asyncio.Task[bool]) -> None:
        """Those of the mode that was gone to may have ended before that was over."""
        if not went.cancelled() and went.exception() is None and went.result():
            self.look()

    async def _go(self, mode: str, reason: str) -> bool:
        """Go to a mode that follows; if that fails, to the one after a failure.

        Tells whether it is there; a newer switch, the user's, is not undone.
        """
        verbs: Any = self._crew.verbs
        here = self.modes.table[self.mode or ""]
        for each in dict.fromkeys([mode, here.on_failure or mode]):
            try:
                await verbs.switch(each, reason)
            except (StoppingError, RefusedError):
                return False
            except EsairError as error:
                told = describe(error)
                _log.error("mode %s: it does not go to %s: %s", self.mode, each, told)
            else:
                return True
        return False


START_TIMEOUT = 5.0
"""How long the start waits for the ``setup`` of behaviors, in seconds."""

SETUP_TIMEOUT = 5.0
"""How long a command waits for the ``setup`` of a behavior, in seconds."""

MARGIN = 0.05
"""How long a component may take to end beside its grace period, in seconds."""

ZOMBIE_LIMIT = 256  # how many zombies are listed


class Zombie(NamedTuple):
    """Something that would not end when its component was removed.

    It is fenced off: it may run, it can move nothing.

    Attributes:
        behavior: The name of the component it belonged to.
        task: The name of the task or thread.
        at: When it was given up, in seconds of the loop's clock.
    """

    behavior: str
    task: str
    at: float


class BehaviorDeployment:
    """The behaviors of one robot: it starts and stops them, BS adds and removes some."""

    def __init__(
        self,
        resources: ResourceDeployment,
        *,
        grace: float,
        start_patience: float,
        halt: Callable[[str, str], Halting],
        stop: Callable[[str], Awaitable[Stopped]],
        policies: Iterable[object],
        modes: Modes,
    ) -> None:
        self.resources = resources
        self.journal: Journal = resources.journal
        self.commands: CommandQueue = CommandQueue("behaviors", asleep=True)
        self.members: dict[str, Member] = {}
        self.mediator: Mediator = Mediator(self.journal)
        self.performing: dict[Member, None] = {}  # those with steps of their own
        self.coming: list[Member] = []  # those whose ``setup`` a command waits for
        self.heirs: list[Member] = []  # those that stand by to take another's place
        self.ending: list[Member] = []
        self.grace = grace
        self.may_begin: asyncio.Event = asyncio.Event()
        """Set when every protection that can see has decided: ``run`` may begin."""
        self.zombies: list[Zombie] = []  # what would not end, the oldest first
        self.zombie_count: int = 0
        self.undead: set[asyncio.Task[Any]] = set()
        """Tasks of zombies: the loop itself keeps only weak references."""
        self.context: contextvars.Context | None = None
        """The context variables of the script; those of its behaviors begin so."""
        self.verbs: abc.Supervisor | None = None
        """Does what a behavior asks for that may manage others."""
        self.turns: Turns = Turns(self, modes)
        """Which mode the robot is in."""
        resources.mode = lambda: self.turns.mode
        self._managers = {
            manager
            for each in policies
            if isinstance(each, BehaviorsPolicy)
            for manager in each.allow
        }
        self._start_patience = start_patience
        self.halt_robot: Callable[[str, str], Halting] = halt
        self.stop_robot: Callable[[str], Awaitable[Stopped]] = stop
        self._all_ended: asyncio.Future[None] | None = None
        self.fatal: BehaviorFailedError | None = None
        """The failure of an essential one, which ends the robot."""
        self.ends: asyncio.Task[Stopped] | None = None
        self.journal.count("behaviors", self._counted)
        self.journal.attach(Kind.UP, self._resource_up)
        self.journal.attach(Kind.ADDED, self._resource_changed)
        self.journal.attach(Kind.REMOVED, self._resource_changed)

    def member(self, name: str) -> Member:
        member = self.members.get(name)
        if member is None:
            raise UnknownNameError("behavior", name, self.members)
        return member

    # What its members ask (`Crew`).

    async def managed_by(self, name: str, verb: str, *args: Any) -> Any:
        """Do what a behavior has asked for, if a policy gives it the right."""
        if not {name, "*"} & self._managers:
            raise AccessDeniedError(
                name,
                "behaviors",
                verb,
                f'no policy allows it: Policy.behaviors(allow={{"{name}": "manage"}})',
            )
        about = args[0] if isinstance(args[0], str) else name_of(args[0])
        self.journal.publish(Kind.OPERATOR, about, name, None, verb)
        return await getattr(self.verbs, verb)(*args)

    def ended(self) -> None:
        """One has finished, or failed for good, or has gone: are all at their end?"""
        self.turns.look()
        if self._all_ended is None or self._all_ended.done():
            return
        if self.turns.busy or self.turns.waits:
            return
        members = self.members.values()
        states = {m.mail.state for m in members if isinstance(m.action, Behavior)}
        over = {BehaviorState.FINISHED, BehaviorState.FAILED, BehaviorState.REMOVED}
        if states & over and not states - over - {BehaviorState.RESTING}:
            self._all_ended.set_result(None)

    def essential_failed(self, failed: BehaviorFailedError) -> None:
        """End the robot: one has failed that it cannot do without."""
        self.fatal = self.fatal or failed
        stop = self.stop_robot(f"{failed.behavior} is essential, and has failed")
        loop = asyncio.get_running_loop()
        self.ends = spawn(loop, stop, name="end of the robot")  # type: ignore[arg-type]

    # What is asked about them.

    def declared(self, behavior: str, resource: str) -> Access:
        access = Access(0)
        for member in (self.members.get(behavior), *self.coming):
            if member is None or member.name != behavior:
                continue
            performed = (need for each in member.steps for need in each.needs)
            for need in itertools.chain(member.action.needs.values(), performed):
                if need.resource == resource:
                    access |= need.access
        return access

    async def all_ended(self) -> None:
        """Wait until every deliberative behavior has ended, if there is one at all."""
        if self._all_ended is None or self._all_ended.done():
            self._all_ended = asyncio.get_running_loop().create_future()
            self.ended()
        await asyncio.shield(self._all_ended)

    def failures(self) -> list[BehaviorFailedError]:
        if self.fatal is not None:
            return [self.fatal]
        boxes = (member.mail for member in self.members.values())
        return [m.failure() for m in boxes if m.state is BehaviorState.FAILED]

    # How one begins, and ends.

    def take_in(self, member: Member) -> None:
        """Give a member its name, or the place of the one that has it."""
        self.members[member.name] = member
        self.mediator.boxes[member.name] = member.mail
        self.resources.plan.enter_action(member.action)

    def take_out(self, member: Member) -> None:
        del self.members[member.name]
        del self.mediator.boxes[member.name]
        self.resources.plan.leave_action(member.name)

    async def gone(self, name: str) -> None:
        """Wait until a removal of that name that runs is over; others do not wait."""
        while True:
            member = self.members.get(name)
            over = None if member is None else member.over
            if over is None or over.done():
                return
            self.commands.changed()
            await asyncio.wait({over})

    async def begin(
        self, *members: Member, start: Callable[[Member], None] = Member.start
    ) -> None:
        """Start members, and wait for their setup outside of the command queue."""
        self.coming += members
        loop = asyncio.get_running_loop()
        process = ProcessWatch(loop)
        waits: list[asyncio.Future[None]] = []
        timer = loop.call_later(SETUP_TIMEOUT, _too_late, members, waits)
        try:
            for member in members:
                start(member)
                if member.ready is not None:
                    waits.append(member.ready)
            if waits:
                self.commands.changed()
                await (waits[0] if len(waits) == 1 else asyncio.gather(*waits))
        finally:
            timer.cancel()
            for member in members:
                self.coming.remove(member)
            _warn_of(process, members)

    async def remove(self, member: Member) -> None:
        """End one for good, and give its name free; other commands do not wait."""
        member.mail.become(BehaviorState.STOPPING)
        self.mediator.peer_removed(member.mail)
        self.commands.changed()
        await self.end(member)
        self.take_out(member)

    async def end(self, *members: Member) -> None:
        """End members; what they moved is safe, or the time for both is over.

        A command that does so cannot be given up any more: it would leave half of one.
        """
        self.commands.no_return()
        loop = asyncio.get_running_loop()
        for member in members:
            self.ending.append(member)
            member.over = member.over or loop.create_future()
            member.stop()
        await self.rested(*members, then=Member.stopped)
        for member in members:
            self.ending.remove(member)
            wake(member.over)

    async def rested(
        self, *members: Member, then: Callable[[Member], object] = ignore
    ) -> None:
        """Wait until the runs of members have ended; what they moved is safe."""
        deadline = asyncio.get_running_loop().time() + self.grace + MARGIN
        left = await end([member.mail.owner for member in members], self.grace)
        used: set[str] = set()
        for member in members:
            then(member)
            used.update(member.used)
        if used:
            channels = self.resources.actuators.channels
            wrote = [channels[name] for name in sorted(used) if name in channels]
            # What is sent goes on to be sent.
            await side_by_side([each.safe.settled(deadline) for each in wrote])
        for member in members:
            if member.mail.owner in left or member.mail.owner.threads:
                self._fence_off(member)

    def _fence_off(self, member: Member) -> None:
        """List what of a member would not end."""
        undead, threads = living(member.mail.owner), member.mail.owner.threads
        self.undead.update(undead)
        for task in undead:
            task.add_done_callback(look_at)
            task.add_done_callback(self.undead.discard)
        at = asyncio.get_running_loop().time()
        for name in (*(t.get_name() for t in undead), *(t.name for t in threads)):
            self.zombie_count += 1
            self.zombies.append(Zombie(member.name, name, at))
            del self.zombies[:-ZOMBIE_LIMIT]
            _log.warning("%s: %s would not end; it is fenced off", member.name, name)

    # What the robot does at its start and stop.

    def wake(self) -> None:
        """Let commands of the user wait from now on: the robot starts."""
        self.context = script_context()
        self.commands.wake()

    def accept(self, behaviors: Iterable[Behavior | Reaction]) -> None:
        """Take the configuration list in: what it protects is protected from now on."""
        for behavior in behaviors:
            member = Member(behavior, self, behavior.name)
            self.take_in(member)
            if not self.turns.rest(member):
                member.sight.accept()

    async def start(self) -> None:
        """Deploy what was accepted; returns when all run, or have failed."""
        resting = BehaviorState.RESTING
        members = [m for m in self.members.values() if m.mail.state is not resting]
        process = ProcessWatch(asyncio.get_running_loop())
        for member in members:
            member.try_to_start()
        # All are deployed: a setup that gives a command does not wait for itself.
        self.commands.initialized()
        await self.await_sight(members)
        self.may_begin.set()
        waits = [member.ready for member in members if member.ready is not None]
        if waits:
            await asyncio.wait(waits, timeout=START_TIMEOUT)
            _warn_of(process, self.members.values())

    def is_one_that_runs(self) -> bool:
        """Whether a behavior that runs is who calls this."""
        owner, runs = current_owner(), BehaviorState.RUNNING
        return owner is not None and any(
            member.mail.owner is owner and member.mail.state is runs
            for member in self.members.values()
        )

    def forget_waiting(self) -> None:
        """Drop the commands that reactions keep for later: the robot is halted."""
        for runner in self._runners():
            runner.outputs.forget()

    def halt(self) -> None:
        """Let no reaction take another step: the robot stops."""
        for runner in self._runners():
            runner.stop()

    def _runners(self) -> list[ReactionRunner]:
        members = (*self.members.values(), *self.heirs)
        parts = [each for member in members for each in (member, *member.steps)]
        return [each.runner for each in parts if each.runner is not None]

    async def stop(self) -> None:
        """End every behavior, the last one first; all share one grace period."""
        until = asyncio.get_running_loop().time() + self.grace + MARGIN
        await self.commands.close()
        if self.turns.round is not None:
            self.turns.round.cancel()
        self.mediator.close()
        # What the user is taking away goes its own way.
        leaving = set(self.ending)
        members = [m for m in reversed(self.members.values()) if m not in leaving]
        await side_by_side([self.end(*members), *self.commands.left(until)])
        there = dict.fromkeys([*self.members.values(), *self.ending])
        rest = [m for m in there if m.mail.state is not BehaviorState.REMOVED]
        if rest:
            await self.end(*rest)
        wake(self._all_ended)

    # Inside.

    async def await_sight(self, members: Iterable[Member]) -> None:
        """Wait until each reaction and guard has decided that can; not for ever."""
        able = [
            member.sight.decided()
            for member in members
            if isinstance(member.action, Reaction)
            and all(
                self.resources.is_ready(need.provider)
                for need in member.action.inputs.values()
                if not need.optional
            )
        ]
        if not all(future.done() for future in able):
            await asyncio.wait(able, timeout=self._start_patience)

    def _counted(self) -> Iterator[tuple[str, Mapping[str, int]]]:
        for name, member in self.members.items():
            yield name, member.counts()
        yield "behaviors", self.mediator.counts()
        yield "behaviors", {"zombies": self.zombie_count}
        yield "behaviors", {"turned_away": self.commands.turned_away}

    def _resource_changed(self, event: Event) -> None:
        if event.peer == "resource":
            for member in self._concerned(event.component):
                member.resource_changed(event.component)

    def _resource_up(self, event: Event) -> None:
        for member in self._concerned(event.component):
            member.resource_up(event.component)

    def _concerned(self, resource: str) -> list[Member]:
        """Return who uses a resource, or performs a step now that may."""
        performers = (m for m in self.performing if self.members.get(m.name) is m)
        users = (self.members[name] for name in self.resources.plan.users_of(resource))
        return list(dict.fromkeys([*users, *self.heirs, *performers]))


def _too_late(members: Iterable[Member], waits: list[asyncio.Future[None]]) -> None:
    told = f"its setup did not end in {SETUP_TIMEOUT:g} s"
    for member in members:
        if member.ready in waits:
            fail(member.ready, BehaviorFailedError(member.name, told))


def refuse_all(found: list[Finding], action: Behavior | Reaction) -> None:
    """Raise what is wrong with a component, if anything is."""
    if found:
        refuse(found, f"{name_of(action)} is described wrongly")


def name_of(component: object) -> str:
    """Return how messages name a component, whatever it is."""
    try:
        return (
            component.name if isinstance(component, abc.Component) else repr(component)
        )
    except ConfigError:
        return repr(component)


def _warn_of(process: ProcessWatch, members: Iterable[Member]) -> None:
    """Say who has changed what others rely on: the stop by a signal, say."""
    changes = process.changes()
    if changes:
        _log.warning(
            "%s: changed %s, which belongs to the whole process: put it back, or the "
            "robot may neither end its tasks nor stop in order at a signal",
            " or ".join(member.name for member in members),
            ", ".join(changes),
        )
