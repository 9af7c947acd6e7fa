"""The behavior supervisor (BS): deploys behaviors and mediates between them."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from functools import partial
from typing import Any, TypeVar

from esair import abc, minimal
from esair.actions import Behavior, Reaction, Request, adapt_action
from esair.exceptions import BehaviorFailedError, BehaviorRemovedError
from esair.journal import Kind
from esair.loop import VERB_COST, Budget, wake
from esair.messages import BehaviorState, BehaviorStatus, Modes, SupervisorPhase
from esair.plan import examine_action, in_use
from esair.supervisors._behavior_deployment import (
    BehaviorDeployment,
    Zombie,
    name_of,
    refuse_all,
)
from esair.supervisors._member import Member
from esair.supervisors._requests import Record

A = TypeVar("A")

TAKE_OVER = 1.0
"""How long a replaced reaction goes on until the new one has decided, in seconds."""


class BehaviorSupervisor(abc.Supervisor):
    """Deploys behaviors, adds and removes them, and mediates all their data.

    Args:
        deployment: The behaviors of the robot.
        command: Does what an operator types.
    """

    def __init__(
        self, deployment: BehaviorDeployment, command: Callable[[str], Awaitable[str]]
    ) -> None:
        self._deployment = deployment
        self._commands = deployment.commands
        self._journal = deployment.journal
        self._command = command
        deployment.verbs = self

    # What everybody may ask.

    @property
    def phase(self) -> SupervisorPhase:
        """What the supervisor is doing."""
        return self._commands.phase

    @property
    def zombies(self) -> tuple[Zombie, ...]:
        """What would not end when it was removed, the oldest first."""
        return tuple(self._deployment.zombies)

    @property
    def mode(self) -> str | None:
        """The mode that the robot is in; None if it has none."""
        return self._deployment.turns.mode

    @property
    def modes(self) -> Modes:
        """The modes of the robot: who runs when."""
        return self._deployment.turns.modes

    def names(self) -> list[str]:
        """Return the names of the behaviors and reactions."""
        return list(self._deployment.members)

    def action(self, name: str) -> Behavior | Reaction:
        """Return a behavior or reaction by its name.

        Raises:
            UnknownNameError: No behavior has the name.
        """
        return self._deployment.member(name).action

    def takes(self, name: str) -> tuple[type[Request[Any]], ...]:
        """Return the types of requests that a behavior takes.

        Raises:
            UnknownNameError: No behavior has the name.
        """
        return tuple(self._deployment.member(name).mail.queues)

    def query(self, name: str) -> BehaviorStatus:
        """Tell what a behavior is doing. Answers at any time, without a wait.

        Raises:
            UnknownNameError: No behavior has the name.
        """
        return self._deployment.member(name).status()

    def outcomes(self) -> list[Record]:
        """Return how the last requests ended, the oldest first."""
        return [Record(*line) for line in self._deployment.mediator.ledger]

    async def put(
        self, data: Any, *, sender: str, receiver: str, interval: float = 1.0
    ) -> None:
        """Hand data from one behavior to another, as `Behavior.put` does.

        Args:
            data: What the receiver gets, untouched.
            sender: In whose name: a component's, ``"user"`` or ``"operator"``.
            receiver: The name of the behavior that gets it.
            interval: How long to keep asking, in seconds.

        Raises:
            UnknownNameError: No behavior is named *receiver*, nobody *sender*.
            StoppingError: The robot is stopping.
            EsairError: As `Behavior.put`.
        """
        await Budget.spend()
        self._deployment.mediator.check_principal("sender", sender)
        await self._deployment.mediator.put(data, sender, receiver, interval)

    async def get(self, *, sender: str, receiver: str, interval: float = 1.0) -> Any:
        """Ask one behavior for data, in the name of another, as `Behavior.get` does.

        Args:
            sender: The name of the behavior that gives.
            receiver: In whose name: a component's, ``"user"`` or ``"operator"``.
            interval: How long to keep asking, in seconds.

        Raises:
            UnknownNameError: No behavior is named *sender*, nobody *receiver*.
            StoppingError: The robot is stopping.
            EsairError: As `Behavior.get`.
        """
        await Budget.spend()
        self._deployment.mediator.check_principal("receiver", receiver)
        return await self._deployment.mediator.get(sender, receiver, interval)

    async def ask(
        self,
        request: Request[A],
        *,
        sender: str,
        receiver: str,
        timeout: float | None = 10.0,
        progress: Callable[[Any], object] | None = None,
    ) -> A:
        """Ask a behavior to do something, in the name of somebody; see `Behavior.ask`.

        Args:
            request: What it is asked; its class says what it is answered with.
            sender: In whose name: a component's, ``"user"`` or ``"operator"``.
            receiver: The name of the behavior that is asked.
            timeout: How long it may wait and work, in seconds; None for no limit.
            progress: Called with what it tells of its progress; the newest wins.
        """
        mediator = self._deployment.mediator
        mediator.check_principal("sender", sender)
        return await mediator.ask(request, sender, receiver, timeout, progress)  # type: ignore[no-any-return]

    # What the user may do.

    async def add(self, behavior: Behavior | Reaction | minimal.Reaction) -> None:
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
        action: Behavior | Reaction = adapt_action(behavior)
        name = name_of(action)

        async def work() -> None:
            crew = self._deployment
            await crew.gone(name)
            if crew.turns.leave is not None:
                await crew.turns.left()
            refuse_all(examine_action(crew.resources.plan, action), action)
            member = Member(action, crew, name)
            crew.take_in(member)
            if not crew.turns.rest(member):
                member.sight.accept()
                try:
                    await crew.begin(member)
                except BaseException:
                    if crew.members.get(name) is not member:
                        raise  # somebody has removed or replaced it meanwhile
                    if member.mail.is_leaving:
                        await crew.gone(name)
                        raise
                    await crew.remove(member)
                    member.sight.leave()
                    raise
            self._journal.publish(Kind.ADDED, name, "behavior")

        await self._commands.run(work, name=f"add {name}", undo=True)

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
            crew = self._deployment
            await crew.gone(name)
            member = crew.member(name)
            for coming in tuple(crew.coming):
                if coming.name == name:
                    coming.give_up()
            await crew.remove(member)
            member.sight.removed()
            self._journal.publish(Kind.REMOVED, name, "behavior")
            crew.ended()
            return [data for _, data in member.mail.inbox]

        return await self._commands.run(
            work, name=f"remove {name}", undo=False, lasts=True
        )

    async def replace(
        self, name: str, behavior: Behavior | Reaction | minimal.Reaction
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
        action: Behavior | Reaction = adapt_action(behavior)

        async def work() -> list[Any]:
            crew = self._deployment
            await crew.gone(name)
            old = crew.member(name)
            if isinstance(action, abc.Component) and not in_use(action):
                action._name = name  # noqa: SLF001 - a supervisor gives names
            plan = crew.resources.plan
            refuse_all(examine_action(plan, action, instead_of=old.action), action)
            new = Member(action, crew, name)
            if not (rests := crew.turns.rest(new)):
                new.gate = asyncio.get_running_loop().create_future()
                new.sight.stand_by()
                crew.heirs.append(new)
                try:
                    await crew.begin(new)
                    if isinstance(action, Reaction):
                        # Until then the old one decides: nothing moves unwatched.
                        self._commands.changed()
                        await asyncio.wait({new.sight.decided()}, timeout=TAKE_OVER)
                    await crew.turns.left()
                    old = crew.member(name)  # it may be another one by now
                    if old.mail.is_leaving or crew.turns.rests(name):
                        raise BehaviorRemovedError(name)
                except BaseException:
                    await crew.end(new)
                    new.sight.leave()
                    raise
                finally:
                    crew.heirs.remove(new)
            new.sight.take_over(old.sight, rests=rests)
            self._commands.no_return()
            crew.take_in(new)
            crew.mediator.moved(old.mail, new.mail)
            wake(new.gate)  # its run begins when the old one is fenced off
            await crew.end(old)
            crew.ended()
            return [data for _, data in old.mail.inbox]

        return await self._commands.run(work, name=f"replace {name}", undo=True)

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
        self._deployment.member(name).sight.mute(seconds, reason)
        self._journal.publish(Kind.OPERATOR, name, "user", seconds, f"mute: {reason}")

    def reset(self, name: str) -> None:
        """End the latch of a guard, after its cause is gone.

        Raises:
            UnknownNameError: No behavior has the name.
            BadValueError: It is no guard with a latch.
            AccessDeniedError: Its cause lasts; nothing has changed.
        """
        self._deployment.member(name).sight.reset()
        self._journal.publish(Kind.OPERATOR, name, "user", None, "reset")

    async def restart(self, name: str) -> None:
        """End the run of a behavior or reaction and begin another, whatever its state.

        Its budget of restarts begins anew, too. What it was asked and has not taken,
        and what lies in its inbox, is for the new run. Returns when that runs.

        Raises:
            UnknownNameError: No behavior has the name.
            RefusedError: It rests in this mode, or a newer command has come before.
            BehaviorFailedError: Its ``setup`` failed, which is a crash like another, or did
                not end in time.
            BehaviorRemovedError: It was removed meanwhile.
            StoppingError: The robot is not running.
        """

        async def work() -> None:
            await self._deployment.gone(name)
            self._deployment.turns.check_turn(name)
            member = self._deployment.member(name)
            member.end_run()
            self._commands.changed()
            await member.run_ended(self._deployment.grace)
            try:
                await self._deployment.begin(member, start=Member.try_to_start)
            except BehaviorFailedError:
                if member.mail.state is BehaviorState.FAILED and member.mail.error:
                    member.begin_again(member.mail.error)
                raise

        await self._commands.run(work, name=f"restart {name}", undo=False)

    async def switch(self, mode: str, reason: str = "") -> None:
        """Go to another mode: its behaviors begin, those of this one rest.

        Those who enter are set up while the old ones run; an error there leaves the mode
        as it is. Then the old ones end, what they moved is safe, and the new ones begin:
        what runs in both modes goes on. Returns when they run. A newer switch ends one
        that waits for a ``setup``.

        Args:
            mode: The name of the mode; nothing happens if the robot is in it.
            reason: Why, for the log.

        Raises:
            UnknownNameError: No mode has the name.
            BehaviorFailedError: A ``setup`` failed; the robot stays in its mode.
            RefusedError: A newer switch has come before.
            StoppingError: The robot is not running.
        """
        work = partial(self._deployment.turns.switch, mode, reason)
        await self._commands.run(work, name=f"switch {mode}", undo=True)

    async def command(self, text: str) -> str:
        """Do what an operator types; it has the rights of the user.

        ``help`` lists the commands. ``add module:Class name=left speed=0.2`` adds an
        instance of a class, ``replace NAME module:Class ...`` puts one in a component's
        place; keys and values are those of a ``robot.toml``.

        Returns:
            The answer, for people.

        Raises:
            ConfigError: The command is not understood.
            EsairError: What the command itself raises.
        """
        await Budget.spend(VERB_COST)
        return await self._command(text)
