"""The behavior supervisor (BS): deploys behaviors and mediates between them."""

from __future__ import annotations

import asyncio
import contextvars
import itertools
import logging
from collections.abc import Awaitable, Callable, Iterable, Iterator, Mapping
from typing import Any, NamedTuple, TypeVar

from esair import abc, minimal
from esair.actions import (
    Behavior,
    Reaction,
    Request,
    adapt_action,
)
from esair.connections import (
    ActuatorChannel,
    ActuatorConnection,
    Halting,
    SensorConnection,
    Stopped,
)
from esair.exceptions import (
    AccessDeniedError,
    BehaviorFailedError,
    BehaviorRemovedError,
    ConfigError,
    StoppingError,
    UnknownNameError,
    describe,
)
from esair.journal import Event, Kind
from esair.loop import Budget, ProcessWatch, now, script_context, spawn
from esair.messages import (
    Access,
    BehaviorState,
    BehaviorStatus,
    SupervisorPhase,
)
from esair.plan import (
    Finding,
    Plan,
    examine_action,
    examine_step,
    in_use,
    refuse,
    unmet,
)
from esair.supervisors._command_queue import CommandQueue
from esair.supervisors._mediator import Mediator
from esair.supervisors._member import Member
from esair.supervisors._requests import Record
from esair.supervisors._resource_supervisor import ResourceSupervisor

A = TypeVar("A")

START_TIMEOUT = 5.0
"""How long the start waits for the ``setup`` of behaviors, in seconds."""

TAKE_OVER = 1.0
"""How long a replaced reaction goes on until the new one has decided, in seconds."""
SETUP_TIMEOUT = 5.0
"""How long a command waits for the ``setup`` of a behavior, in seconds."""

MARGIN = 0.05
"""How long a component may take to end beside its grace period, in seconds."""

ZOMBIE_LIMIT = 256
"""How many zombies are listed."""

_log = logging.getLogger("esair")


"""What a behavior is from its removal on, until what it moved is safe."""


class Zombie(NamedTuple):
    """Something that would not end when its component was removed.

    It is fenced off: it may run, it can move nothing.

    Attributes:
        behavior: The name of the component it belonged to.
        task: The name of the task or thread.
    """

    behavior: str
    task: str


class BehaviorSupervisor(abc.Supervisor):
    """Deploys behaviors, adds and removes them, and mediates all their data."""

    def __init__(
        self,
        resources: ResourceSupervisor,
        sensors: SensorConnection,
        actuators: ActuatorConnection,
        *,
        grace: float = 1.0,
        start_patience: float = 1.0,
        halt: Callable[[str, str], Halting] | None = None,
        stop: Callable[[str], Awaitable[Stopped]] | None = None,
        command: Callable[[str], Awaitable[str]] | None = None,
    ) -> None:
        self._start_patience = start_patience
        self.may_begin = asyncio.Event()
        """Set when every protection that can see has decided: ``run`` may begin."""
        self.resources = resources
        self.sensors = sensors
        self.actuators = actuators
        self.grace = grace
        self.zombies: list[Zombie] = []
        """What would not end, the oldest first."""
        self.zombie_count = 0
        self._undead: set[asyncio.Task[Any]] = set()
        """Tasks of zombies: the loop itself keeps only weak references."""
        self.managers: frozenset[str] = frozenset()
        """Which behaviors may manage others, by the developer's policies."""
        self.began = 0.0
        """When the robot has started, on the loop's clock: the zero of ``now_ms``."""
        self.seed = 0
        """What the random numbers of its components are made from."""
        self.context: contextvars.Context | None = None
        """The context variables of the script; those of its behaviors begin so."""
        self._halt = halt
        self._stop = stop
        self._command = command
        self._command_queue = CommandQueue("behaviors", asleep=True)
        self._members: dict[str, Member] = {}
        self._coming: list[Member] = []
        """Those whose ``setup`` a command waits for."""
        self._ending: list[Member] = []
        self._mediator: Mediator | None = None
        self._all_ended: asyncio.Future[None] | None = None
        self.journal = resources.journal
        self.journal.count("behaviors", self._counted)
        self.journal.attach(Kind.UP, self._resource_up)
        self.journal.attach(Kind.ADDED, self._resource_changed)
        self.journal.attach(Kind.REMOVED, self._resource_changed)

    # What everybody may ask.

    @property
    def phase(self) -> SupervisorPhase:
        """What the supervisor is doing."""
        return self._command_queue.phase

    @property
    def mediator(self) -> Mediator:
        """The mediator of all data between behaviors."""
        if self._mediator is None:
            self._mediator = Mediator(self._members, self.journal)
        return self._mediator

    def names(self) -> list[str]:
        """Return the names of the behaviors and reactions."""
        return list(self._members)

    def action(self, name: str) -> Behavior | Reaction:
        """Return a behavior or reaction by its name.

        Raises:
            UnknownNameError: No behavior has the name.
        """
        return self._member(name).action

    def takes(self, name: str) -> tuple[type[Request[Any]], ...]:
        """Return the types of requests that a behavior takes.

        Raises:
            UnknownNameError: No behavior has the name.
        """
        return tuple(self._member(name).queues)

    def query(self, name: str) -> BehaviorStatus:
        """Tell what a behavior is doing. Answers at any time, without a wait.

        Raises:
            UnknownNameError: No behavior has the name.
        """
        return self._member(name).status()

    def outcomes(self) -> list[Record]:
        """Return how the last requests ended, the oldest first."""
        return self.mediator.outcomes()

    async def put(
        self, data: Any, *, sender: str, receiver: str, interval: float = 1.0
    ) -> None:
        """Hand data from one behavior to another.

        A receiver that cannot take it is asked again until it can, or until the
        interval has passed.

        Args:
            data: What the receiver gets, untouched.
            sender: In whose name.
            receiver: The name of the behavior that gets it.
            interval: How long to keep asking, in seconds.

        Raises:
            UnknownNameError: No behavior is named *receiver*.
            BehaviorUnavailableError: It could not receive for the interval.
            BehaviorRemovedError: It was removed meanwhile.
            BehaviorFailedError: It crashed meanwhile.
            BusyError: Too many requests wait.
            StoppingError: The robot is stopping.
        """
        await Budget.spend()
        await self.mediator.put(data, sender, receiver, interval)

    async def get(self, *, sender: str, receiver: str, interval: float = 1.0) -> Any:
        """Ask one behavior for data, in the name of another.

        Args:
            sender: The name of the behavior that gives.
            receiver: In whose name it is asked.
            interval: How long to keep asking, in seconds.

        Raises:
            UnknownNameError: No behavior is named *sender*.
            BehaviorUnavailableError: It could not send for the interval.
            CircularRequestError: It waits, itself or through others, for *receiver*.
            BehaviorRemovedError: It was removed meanwhile.
            BehaviorFailedError: It crashed meanwhile, or its ``provide`` did.
            BusyError: Too many requests wait.
            StoppingError: The robot is stopping.
        """
        await Budget.spend()
        return await self.mediator.get(sender, receiver, interval)

    async def ask(
        self,
        request: Request[A],
        *,
        sender: str,
        receiver: str,
        timeout: float | None = 10.0,
        progress: Callable[[Any], object] | None = None,
    ) -> A:
        """Ask a behavior to do something, in the name of somebody.

        Args:
            request: What it is asked; its class says what it is answered with.
            sender: In whose name.
            receiver: The name of the behavior that is asked.
            timeout: How long it may wait and work, in seconds; None for no limit.
            progress: Called with what it tells of its progress; the newest wins.

        Returns:
            The answer.

        Raises:
            EsairError: As `Behavior.ask`.
        """
        asks = self.mediator.asks
        return await asks.ask(request, sender, receiver, timeout, progress)  # type: ignore[no-any-return]

    # What the user may do.

    async def add(self, component: Behavior | Reaction | minimal.Reaction) -> None:
        """Deploy a behavior or reaction while everything else keeps running.

        Returns when its ``setup`` is done and it runs.

        Raises:
            ConfigError: It is declared wrongly.
            NameTakenError: The name is in use.
            UnknownNameError: It uses a resource that is not there.
            AccessDeniedError: It uses a resource that it may not use.
            BehaviorFailedError: Its ``setup`` failed; nothing of it is left.
            StoppingError: The robot is not running.
        """
        action: Behavior | Reaction = adapt_action(component)

        async def work() -> None:
            await self._gone(_name(action))
            self._refuse(examine_action(self._plan(action), action), action)
            member = Member(action, self, action.name)
            self._members[member.name] = member
            member.sight.accept()
            try:
                await self._begin(member)
            except BaseException:
                if self._members.get(member.name) is not member:
                    raise  # somebody has removed or replaced it meanwhile
                if member.is_leaving:
                    await self._gone(member.name)
                    raise
                member.state = BehaviorState.STOPPING
                self.mediator.peer_removed(member)
                await self._end(member)
                del self._members[member.name]
                member.sight.leave()
                raise
            self.journal.publish(Kind.ADDED, member.name, "behavior")

        await self._command_queue.run(work, name=f"add {_name(action)}", undo=True)

    async def remove(self, name: str) -> list[Any]:
        """Take a behavior away while everything else keeps running.

        Its rights end at once, what it moved is made safe, then it is cancelled.
        Returns within the grace period and 0.1 s, whatever it does, and whatever its
        actuators do; what would not end is fenced off and listed in ``zombies``. Also
        a ``setup`` that is waited for, of it or of what shall replace it, is ended.

        Returns:
            The data that lay in its inbox and was not taken, the oldest first.

        Raises:
            UnknownNameError: No behavior has the name.
            StoppingError: The robot is not running.
        """

        async def work() -> list[Any]:
            await self._gone(name)
            member = self._member(name)
            member.state = BehaviorState.STOPPING
            self.mediator.peer_removed(member)
            for coming in tuple(self._coming):
                if coming.name == name:
                    coming.give_up()
            self._command_queue.changed()
            await self._end(member)
            del self._members[name]
            member.sight.removed()
            self.journal.publish(Kind.REMOVED, name, "behavior")
            self._check_all_ended()
            return list(member.inbox)

        return await self._command_queue.run(work, name=f"remove {name}", undo=False)

    async def replace(
        self, name: str, component: Behavior | Reaction | minimal.Reaction
    ) -> list[Any]:
        """Put another behavior in the place of one, under the same name.

        The new one's ``setup`` is done before the old one ends, so an error there
        leaves the old one running. The old one's rights end before the new one's
        ``run`` begins. Requests that wait go on to the new one.

        Returns:
            The data that lay in the old one's inbox and was not taken.

        Raises:
            UnknownNameError: No behavior has the name.
            ConfigError: The new one is declared wrongly.
            BehaviorFailedError: The new one's ``setup`` failed.
            StoppingError: The robot is not running.
        """
        action: Behavior | Reaction = adapt_action(component)

        async def work() -> list[Any]:
            await self._gone(name)
            old = self._member(name)
            if isinstance(action, abc.Component) and not in_use(action):
                action._name = name  # noqa: SLF001 - a supervisor gives names
            plan = self._plan(action, without=old)
            found = examine_action(plan, action, instead_of=old.action)
            self._refuse(found, action)
            new = Member(action, self, name)
            new.gate = asyncio.get_running_loop().create_future()
            new.sight.stand_by()
            try:
                await self._begin(new)
                if isinstance(action, Reaction):
                    # Until then the old one decides: nothing moves unwatched.
                    self._command_queue.changed()
                    await asyncio.wait({new.sight.decided()}, timeout=TAKE_OVER)
                old = self._member(name)  # it may be another one by now
                if old.is_leaving:
                    raise BehaviorRemovedError(name)
            except BaseException:
                new.give_up()
                await self._end(new)
                new.sight.leave()
                raise
            self._command_queue.no_return()
            self._members[name] = new
            new.sight.take_over(old.sight)
            self.mediator.moved(old, new)
            new.gate.set_result(None)  # its run begins when the old one is fenced off
            await self._end(old)
            self._check_all_ended()
            return list(old.inbox)

        return await self._command_queue.run(work, name=f"replace {name}", undo=True)

    def mute(self, name: str, seconds: float, reason: str) -> None:
        """Let what a component protects pass for a while: its guard, its blind hold.

        Args:
            name: The reaction or behavior.
            seconds: For how long, at most the ``mute_limit`` of its class.
            reason: Why, for the log.

        Raises:
            UnknownNameError: No behavior has the name.
            BadValueError: It protects nothing, or not for so long.
        """
        self._member(name).sight.mute(seconds, reason)
        self.journal.publish(Kind.OPERATOR, name, "user", seconds, f"mute: {reason}")

    def reset(self, name: str) -> None:
        """End the latch of a guard, after its cause is gone.

        Raises:
            UnknownNameError: No behavior has the name.
            BadValueError: It is no guard with a latch.
            AccessDeniedError: Its cause lasts; nothing has changed.
        """
        self._member(name).sight.reset()
        self.journal.publish(Kind.OPERATOR, name, "user", None, "reset")

    async def restart(self, name: str) -> None:
        """End the run of a behavior or reaction and begin another, whatever its state.

        Its budget of restarts begins anew, too. What it was asked and has not taken,
        and what lies in its inbox, is for the new run. Returns when that runs.

        Raises:
            UnknownNameError: No behavior has the name.
            BehaviorFailedError: Its ``setup`` did not end in time.
            BehaviorRemovedError: It was removed meanwhile.
            StoppingError: The robot is not running.
        """

        async def work() -> None:
            await self._gone(name)
            member = self._member(name)
            ending = member.end_run(self.grace)
            self._command_queue.changed()
            await ending
            await self._begin(member)

        await self._command_queue.run(work, name=f"restart {name}", undo=False)

    async def managed_by(self, name: str, verb: str, *args: Any) -> Any:
        """Do what a behavior has asked for, if a policy gives it the right.

        Args:
            name: The behavior.
            verb: ``add``, ``remove``, ``replace`` or ``restart``.
            *args: What the method of that name takes.

        Raises:
            AccessDeniedError: It has no right to manage others.
        """
        if not {name, "*"} & self.managers:
            raise AccessDeniedError(
                name,
                "behaviors",
                verb,
                f'no policy allows it: Policy.behaviors(allow={{"{name}": "manage"}})',
            )
        about = args[0] if isinstance(args[0], str) else _name(args[0])
        self.journal.publish(Kind.OPERATOR, about, name, None, verb)
        return await getattr(self, verb)(*args)

    async def command(self, text: str) -> str:
        """Do what an operator types; it has the rights of the user.

        ``help`` lists the commands.

        Returns:
            The answer, for people.

        Raises:
            ConfigError: The command is not understood.
            EsairError: What the command itself raises.
        """
        if self._command is None:
            raise StoppingError("behaviors", "only a robot that runs takes commands")
        return await self._command(text)

    # What the robot does at its start and stop.

    def wake(self) -> None:
        """Let commands of the user wait from now on: the robot starts."""
        self.context = script_context()
        self.began = now()
        self._command_queue.wake()

    def accept(self, behaviors: Iterable[Behavior | Reaction]) -> None:
        """Take the configuration list in: what it protects is protected from now on."""
        for behavior in behaviors:
            member = Member(behavior, self, behavior.name)
            self._members[member.name] = member
            member.sight.accept()

    async def start(self) -> None:
        """Deploy what was accepted; returns when all run, or have failed."""
        members = list(self._members.values())
        process = ProcessWatch(asyncio.get_running_loop())
        for member in members:
            try:
                member.start()
            except Exception as error:
                member._crashed(error)  # noqa: SLF001 - its owner
        # All are deployed: a setup that gives a command does not wait for itself.
        self._command_queue.initialized()
        await self._await_sight()
        self.may_begin.set()
        waits = [member.ready for member in members if member.ready is not None]
        if waits:
            await asyncio.wait(waits, timeout=START_TIMEOUT)
            _warn_of(process, " or ".join(self._members))

    def forget_waiting(self) -> None:
        """Drop the commands that reactions keep for later: the robot is halted."""
        for member in self._members.values():
            member.forget_waiting()

    def halt(self) -> None:
        """Let no reaction take another step: the robot stops."""
        for member in self._members.values():
            member.halt()

    async def stop(self) -> None:
        """End every behavior, the last one first; all share one grace period."""
        await self._command_queue.close()
        if self._mediator is not None:
            self._mediator.close()
        members = list(reversed(self._members.values()))
        members += [each for each in self._ending if each not in members]
        await asyncio.gather(*(self._end(member) for member in members))
        if self._all_ended is not None and not self._all_ended.done():
            self._all_ended.set_result(None)

    async def all_ended(self) -> None:
        """Wait until every deliberative behavior has ended, if there is one at all."""
        if self._all_ended is None or self._all_ended.done():
            self._all_ended = asyncio.get_running_loop().create_future()
            self._check_all_ended()
        await asyncio.shield(self._all_ended)

    def failures(self) -> list[BehaviorFailedError]:
        """Return an error for each behavior that has failed for good."""
        failed = []
        for member in self._members.values():
            if member.state is BehaviorState.FAILED and member.error is not None:
                error = BehaviorFailedError(member.name, describe(member.error))
                error.__cause__ = member.error
                failed.append(error)
        return failed

    # Inside.

    async def _await_sight(self) -> None:
        """Wait until every reaction and guard has decided that can; not for ever."""
        able = [
            member.sight.decided()
            for member in self._members.values()
            if isinstance(member.action, Reaction)
            and all(
                self.resources.is_ready(need.resource)
                for need in member.action.inputs.values()
                if not need.optional
            )
        ]
        if not all(future.done() for future in able):
            await asyncio.wait(able, timeout=self._start_patience)

    def _counted(self) -> Iterator[tuple[str, Mapping[str, int]]]:
        for name, member in self._members.items():
            yield name, member.counts()
        if self._mediator is not None:
            yield "behaviors", self._mediator.counts()
        yield "behaviors", {"zombies": self.zombie_count}

    def declared(self, behavior: str, resource: str) -> Access:
        """Return what the class of a behavior declares to do with a resource."""
        access = Access(0)
        for member in (self._members.get(behavior), *self._coming):
            if member is None or member.name != behavior:
                continue
            performed = (need for each in member.performs for need in each.needs)
            for need in itertools.chain(member.action.needs.values(), performed):
                if need.resource == resource:
                    access |= need.access
        return access

    def halt_robot(self, reason: str, by: str) -> Halting:
        """Halt the robot in the name of a member."""
        assert self._halt is not None
        return self._halt(reason, by)

    async def stop_robot(self, reason: str) -> Stopped:
        """Stop the robot."""
        assert self._stop is not None
        return await self._stop(reason)

    def is_adding(self, member: Member) -> bool:
        """Tell whether somebody waits for the setup of a member."""
        return member in self._coming

    def ended(self, member: Member) -> None:
        """A member has finished, or failed for good."""
        self._check_all_ended()

    def refuse_step(self, reaction: Reaction, performer: str) -> None:
        """Raise what is wrong with a reaction that a behavior wants to perform."""
        found = examine_step(self._plan(), reaction, performer=performer)
        self._refuse(found, reaction)

    def _plan(self, *new: Any, without: Member | None = None) -> Plan:
        """Return this robot, with what is about to come and without what goes."""
        members = [each for each in self._members.values() if each is not without]
        return self.resources.plan([*(each.action for each in members), *new])

    def misfit(self, action: Behavior | Reaction, resource: str) -> str:
        """Say why a resource that is there now does not fit a port; empty if it does."""
        plan = self._plan()
        for attribute, need in action.needs.items():
            if need.resource == resource and resource in plan.resource_names:
                finding = unmet(plan, action, attribute, need)
                if finding is not None:
                    return finding.text
        return ""

    @staticmethod
    def _refuse(found: list[Finding], action: Behavior | Reaction) -> None:
        refuse(found, f"{_name(action)} is described wrongly")

    def _member(self, name: str) -> Member:
        member = self._members.get(name)
        if member is None:
            raise UnknownNameError("behavior", name, self._members)
        return member

    async def _gone(self, name: str) -> None:
        """Wait until a removal of that name that runs is over; others do not wait."""
        while True:
            member = self._members.get(name)
            if member is None or not member.is_leaving or member.over.done():
                return
            self._command_queue.changed()
            await asyncio.wait({member.over})

    async def _begin(self, member: Member) -> None:
        """Start a member, and wait for its setup outside of the command queue."""
        self._coming.append(member)
        process = ProcessWatch(asyncio.get_running_loop())
        try:
            member.start()
            ready = member.ready
            if ready is None:
                return
            self._command_queue.changed()
            await asyncio.wait({ready}, timeout=SETUP_TIMEOUT)
            if not ready.done():
                raise BehaviorFailedError(
                    member.name, f"its setup did not end in {SETUP_TIMEOUT:g} s"
                )
            try:
                ready.result()
            except Exception as error:
                if member.given_up:
                    raise
                raise BehaviorFailedError(member.name, describe(error)) from error
        finally:
            self._coming.remove(member)
            _warn_of(process, member.name)

    async def _end(self, member: Member) -> None:
        """End a member; what it moved is safe, or the time for both is over."""
        loop = asyncio.get_running_loop()
        deadline = loop.time() + self.grace + MARGIN
        uses = {registration.resource for registration in member.uses()}
        wrote = [c for name, c in self.actuators.channels.items() if name in uses]
        self._ending.append(member)
        await member.stop(self.grace)
        member.state = BehaviorState.REMOVED
        if wrote:
            await self._until_safe(wrote, deadline)
        self._ending.remove(member)
        if not member.over.done():  # the stop may end what a command was ending
            member.over.set_result(None)
        self._undead.update(member.undead)
        for task in member.undead:
            task.add_done_callback(self._undead.discard)
        for name in member.zombies:
            self.zombie_count += 1
            self.zombies.append(Zombie(member.name, name))
            del self.zombies[:-ZOMBIE_LIMIT]
            _log.warning("%s: %s would not end; it is fenced off", member.name, name)

    async def _until_safe(
        self, channels: Iterable[ActuatorChannel], deadline: float
    ) -> None:
        """Wait for the safe commands of actuators, until a moment."""
        loop = asyncio.get_running_loop()
        waits = [
            spawn(loop, channel.safe_now(), name=f"safe {channel.name}")
            for channel in channels
        ]
        try:
            await asyncio.wait(waits, timeout=max(0.0, deadline - loop.time()))
        finally:
            for wait in waits:
                wait.cancel()  # what is sent goes on to be sent

    def _resource_changed(self, event: Event) -> None:
        if event.peer == "resource":
            for member in tuple(self._members.values()):
                member.resource_changed(event.component)

    def _resource_up(self, event: Event) -> None:
        for member in tuple(self._members.values()):
            member.resource_up(event.component)

    def _check_all_ended(self) -> None:
        if self._all_ended is None or self._all_ended.done():
            return
        behaviors = [
            m for m in self._members.values() if isinstance(m.action, Behavior)
        ]
        over = {BehaviorState.FINISHED, BehaviorState.FAILED, BehaviorState.REMOVED}
        if behaviors and all(member.state in over for member in behaviors):
            self._all_ended.set_result(None)


def _warn_of(process: ProcessWatch, names: str) -> None:
    """Say who has changed what others rely on: the stop by a signal, say."""
    changes = process.changes()
    if changes:
        _log.warning(
            "%s: changed %s, which belongs to the whole process: put it back, or the "
            "robot may neither end its tasks nor stop in order at a signal",
            names,
            ", ".join(changes),
        )


def _name(component: object) -> str:
    try:
        return (
            component.name if isinstance(component, abc.Component) else repr(component)
        )
    except ConfigError:
        return repr(component)
