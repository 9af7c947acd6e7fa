"""One story: a robot on the virtual clock, and what is done to it."""

from __future__ import annotations

import asyncio
import contextlib
from collections import Counter
from collections.abc import Callable, Coroutine
from typing import Any

import attrs

import esair
from esair.actions import Behavior, Reaction
from esair.buses.peer import PeerBus
from esair.exceptions import describe
from esair.messages import is_placed
from esair.resources import Resource
from esair.testing import DeadlockError, Leaks, LivelockError, VirtualLoop
from esair.torture._gate import Gate, Lever
from esair.torture._judge import SLACK, Boxes, Judge, Violation, protected_in
from esair.torture._kinds import KINDS, NotNowError, Step, Story
from esair.torture._life import (
    OF_LIFE,
    UNTOLD,
    Deeds,
    calm_stories,
    habits_in,
    is_judged,
    lasting_in,
    look_after,
)
from esair.torture._patience import HeldError, Patience, abandon, virtual_sleep
from esair.torture._target import Target

END_WITHIN = 120.0
"""How long the end of a robot may take at all, in seconds of the virtual clock."""

CARE = (5.0, 10.0)
"""How long after the last fault the user looks after the robot, in seconds.

Twice: a guard cannot be reset while its device waits to be opened once more.
"""

LEAVES = 5.0  # How long a thread that ends may take to do so, in real seconds
RETOLD = 3  # How often a story is told again that shows that its robot is lifeless
DRAIN = 6.0  # How long what is late may still come after the end, in seconds


@attrs.frozen
class Outcome:
    """What came of a story.

    Attributes:
        violations: What must not be, and was.
        done: How many times each kind of step was taken; not those that had no place.
        slowest: For each kind, how long an actuator took to be safe at most, in s.
        speechless: The sensors whose stand-ins had nothing to say, and why.
    """

    violations: tuple[Violation, ...]
    done: Counter[str]
    slowest: dict[str, float]
    speechless: dict[str, str]

    @property
    def keys(self) -> frozenset[tuple[str, str]]:
        """The rules that were broken, and where."""
        return frozenset(each.key for each in self.violations)


class World:
    """A robot that a story happens to.

    Args:
        target: Whose robot.
        story: What is done to it.

    Attributes:
        robot: The robot.
        gates: What lies before each device, those that were removed too.
        levers: What each action obeys, by the identity of the action.
        halted: Since when nothing may move, by the user's will; None if it may.
        ends: When its end has begun, in seconds; None before.
        muted: Until when a protection lets everything pass, by name.
        protected: The actuators that somebody guards, or keeps safe while blind, at
            first: what the user takes away from them is the user's.
        deeds: What its actions have done.
        lasting: The actions that had not come to an end shortly before the robot did.
    """

    def __init__(self, target: Target, story: Story) -> None:
        self.target = target
        self.story = story
        self.loop: VirtualLoop = VirtualLoop(seed=story.seed)
        self.judge: Judge = Judge(self)
        self.gates: list[Gate] = []
        self.levers: dict[int, Lever] = {}
        self.halted: float | None = None
        self.is_up: bool = False
        self.ends: float | None = None
        self.muted: dict[str, float] = {}
        self.protected: frozenset[str] = frozenset()
        self.done: Counter[str] = Counter()
        self.robot: esair.Robot
        self.grace: float = 1.0
        self.boxes: Boxes = Boxes()
        self.deeds: Deeds
        self.lasting: set[str] = set()
        self._spares: dict[str, list[Any]] = {}
        self._jumps: list[tuple[float, float]] = []
        self._orders: list[tuple[str, str, asyncio.Task[Any]]] = []
        self._over: asyncio.Future[str]

    # What steps use.

    @property
    def now(self) -> float:
        return self.loop.time()

    def jump(self, seconds: float) -> None:
        """Let time pass at once: the computer was busy."""
        self.loop.advance(seconds)
        self._jumps.append((self.now, seconds))

    def jumped(self, since: float) -> float:
        """Return how much time has passed at once since a moment."""
        steps = sum(each for when, each in self._jumps if when > since)
        slow = (each for lever in self.levers.values() for each in lever.slow)
        return steps + 4 * sum(seconds for until, seconds in slow if until > since)

    def gate(self, name: str) -> Gate:
        """Return the gate of a device that the robot has now.

        Raises:
            NotNowError: It has none of this name.
        """
        try:
            found = self.gate_of(self.robot.resources.get(name))
        except esair.UnknownNameError:
            found = None
        if found is None:
            raise NotNowError
        return found

    def gate_of(self, resource: Resource) -> Gate | None:
        return next((each for each in self.gates if each.resource is resource), None)

    def lever(self, name: str) -> Lever:
        """Return the lever of an action that the robot has now.

        Raises:
            NotNowError: It has none of this name.
        """
        try:
            return self.levers[id(self.robot.behaviors.action(name))]
        except (esair.UnknownNameError, KeyError):
            raise NotNowError from None

    def actions(self) -> list[Behavior | Reaction]:
        behaviors = self.robot.behaviors
        return [behaviors.action(name) for name in behaviors.names()]

    def spare(self, name: str) -> Any:
        """Return a new component of a name, as the robot had one at first."""
        if not self._spares.get(name):
            plan = self.target.make().plan
            for component in [*plan.resources, *plan.behaviors]:
                self._spares.setdefault(component.name, []).append(component)
        if name not in self._spares:
            raise NotNowError
        spare = self._spares[name].pop()
        self._reach(spare)
        return spare

    def order(
        self, title: str, component: str, work: Coroutine[Any, Any, Any]
    ) -> asyncio.Task[Any]:
        """Have something asked for; it must have one outcome."""
        task = self.loop.create_task(work, name=f"torture {title}")
        self._orders.append((title, component, task))
        return task

    def finish(self, how: str) -> None:
        """Bring the robot to its end: ``leave``, ``error`` or ``cancel``."""
        if not self._over.done():
            self._over.set_result(how)

    # One story.

    def run(self) -> Outcome:
        """Tell the story, and judge it."""
        loop = self.loop
        problems: list[str] = []
        loop.set_exception_handler(lambda _, told: problems.append(_words(told)))
        leaks, is_over = Leaks(loop), False
        patience = Patience(loop)
        try:
            with patience, virtual_sleep(loop), self.judge.looking():
                if self._tell():
                    self._left_behind(problems)
                loop.run_until_complete(loop.shutdown_asyncgens())
            is_over = True
        except (HeldError, RuntimeError) as error:
            if patience.lost is not None:
                self.judge.say("holds", patience.lost.component, str(patience.lost))
            elif isinstance(error, DeadlockError | LivelockError):
                self.judge.say("stuck", self.robot.name, str(error)[:300])
            else:
                raise
        finally:
            abandon(loop)
            loop.close()
        for left in leaks.check_process(LEAVES) if is_over else ():
            self.judge.say("left", self.robot.name, f"the {left} is left behind")
        silent = {gate.name: gate.speechless for gate in self.gates if gate.speechless}
        found = tuple(self.judge.found)
        return Outcome(found, self.done, self.judge.slowest, silent)

    def _tell(self) -> bool:
        try:
            self.robot = self.target.make()
        except (esair.EsairError, ExceptionGroup) as error:
            self.judge.say("start", "robot", _told_by(error)[:300])
            return False
        self.grace = self.robot.grace
        self.deeds = Deeds(self.robot)
        self.protected = protected_in(self.robot.plan.behaviors)
        for component in (*self.robot.plan.resources, *self.robot.plan.behaviors):
            self._reach(component)
        main = self.loop.create_task(self._live(), name="torture story")
        patient = asyncio.wait({main}, timeout=self.story.lasts + END_WITHIN)
        self.loop.run_until_complete(patient)
        if not main.done():
            self.judge.say("stop", self.robot.name, "its end has not come at all")
        elif (failed := main.exception()) is not None:
            raise failed
        late = max(self.story.over_at - self.now, 0.0) + DRAIN
        self.loop.run_until_complete(asyncio.sleep(late))
        self.judge.drained()
        for title, component, task in self._orders:
            self.judge.outcome(title, component, task)
        return True

    def _reach(self, component: Any) -> None:
        """Put a gate before a device, a lever on an action."""
        if isinstance(component, Resource):
            # Who answers for its device is here, and its driver may be nowhere.
            component.placement = None
            alone = self.target.alone is None or component.name in self.target.alone
            alone = alone or isinstance(component.bus, PeerBus)  # it runs elsewhere
            seed = self.story.seed
            gate = Gate(component, self.loop, seed, self.judge, alone=alone)
            self.gates.append(gate)
        elif not is_placed(component):
            self.levers[id(component)] = Lever(component, self.loop)

    async def _live(self) -> None:
        self._over = self.loop.create_future()
        teller = self.loop.create_task(self._timeline(), name="torture timeline")
        host = asyncio.current_task()
        assert host is not None
        try:
            await self._stay(host)
        except _StoryError:
            pass
        except (esair.EsairError, ExceptionGroup) as error:
            self.judge.say("start", self.robot.name, _told_by(error)[:300])
        finally:
            teller.cancel()
        now = self.now
        self.judge.ended(now - (now if self.ends is None else self.ends))

    async def _stay(self, host: asyncio.Task[Any]) -> None:
        try:
            async with self.robot:
                self.is_up = True
                how = await self._over
                self.boxes.look(self)
                self.lasting = lasting_in(self.robot)
                self.judge.calm()
                self.begin_to_end()
                if how == "error":
                    raise _StoryError
                if how == "cancel":
                    host.cancel()
                    await asyncio.sleep(0)
        except asyncio.CancelledError:
            if self.ends is None:
                raise
            host.uncancel()
        except esair.StoppingError:
            if self.ends is None:  # stopped while it started
                raise

    def begin_to_end(self) -> None:
        """Take note that the end of the robot begins now."""
        if self.ends is None:
            self.ends = self.now
            self.judge.cause("the end", self.now)

    async def _timeline(self) -> None:
        """Take the steps, and undo them, each at its time."""
        agenda: list[tuple[float, int, Callable[[], None]]] = []
        for number, step in enumerate(self.story.steps):
            agenda.append((step.at, number, lambda step=step: self._take(step)))  # type: ignore[misc]
        for part in range(1, 5):
            when = self.story.lasts * part / 4 - 1e-3
            agenda.append((when, -1, lambda: self.boxes.look(self)))
        over = self.story.over_at
        agenda += [(over + care, -1, self._look_after) for care in CARE]
        agenda.append((self.story.lasts, 10**6, lambda: self.finish("leave")))
        for when, _, act in sorted(agenda, key=lambda each: each[:2]):
            if when > self.now:
                await asyncio.sleep(when - self.now)
            act()

    def _look_after(self) -> None:
        if self.ends is None and self.is_up:
            with contextlib.suppress(esair.EsairError):
                look_after(self)

    def _take(self, step: Step) -> None:
        if self.ends is not None:
            return
        kind = KINDS[step.kind]
        try:
            undo = kind.do(self, step)
        except NotNowError:
            return
        self.done[step.kind] += 1
        self.judge.cause(step.kind, self.now + step.lasts)
        if undo is not None:
            self.loop.call_later(step.lasts, self._undo, undo)

    def _undo(self, undo: Callable[[], object]) -> None:
        if self.ends is None:
            with contextlib.suppress(NotNowError, esair.EsairError):
                undo()

    def _left_behind(self, problems: list[str]) -> None:
        left = [task for task in asyncio.all_tasks(self.loop) if not task.done()]
        name = self.robot.name
        running = [each for each in self.levers.values() if each.is_running]
        for each in running:
            if not each.was_deaf:  # else it never heard of its end
                text = "it goes on when its end has come: it catches CancelledError"
                self.judge.say("left", each.action.name, text)
        if left and not running:  # else they may be those that it waits for
            names = ", ".join(sorted(task.get_name() for task in left))
            self.judge.say("left", name, f"tasks are left behind: {names}"[:300])
            for task in left:
                task.cancel()
            self.loop.run_until_complete(asyncio.wait(left, timeout=1.0))
        deaf = {each.action.name for each in self.levers.values() if each.was_deaf}
        for zombie in self.robot.behaviors.zombies:
            told = zombie.at - self.grace - SLACK
            in_time = not any(told < when <= zombie.at for when, _ in self._jumps)
            if zombie.behavior not in deaf and in_time:  # else its grace was skipped
                text = f"{zombie.task} would not end when it was told to"
                self.judge.say("left", zombie.behavior, text)
        for call in self.robot.resources.abandoned():
            text = f"a call of its driver has not ended: {call}"
            self.judge.say("left", call.resource, text)
        for problem in problems[:1]:
            self.judge.say("loop", name, problem)


def tell(target: Target, story: Story) -> Outcome:
    """Tell a story to a new robot, and judge it.

    What the robot does when nothing is done to it is learned before. Whether it lives on
    may hang on what stand-ins say: it is a finding if it shows with other seeds too.
    """
    if target.habits is None and is_judged(story):
        with contextlib.suppress(esair.EsairError, ExceptionGroup):  # told by the story
            calm = calm_stories(target.make())
            worlds = [World(target, each) for each in calm]
            broken = {rule for world in worlds for rule, _ in world.run().keys}
            target.habits = habits_in([] if broken & UNTOLD else worlds)
    outcome = World(target, story).run()
    shown = doubtful = {key for key in outcome.keys if key[0] in OF_LIFE}
    for number in range(1, RETOLD + 1):
        if shown:
            again = attrs.evolve(story, seed=story.seed + number)
            shown = shown & World(target, again).run().keys
    chance = doubtful - shown
    found = tuple(each for each in outcome.violations if each.key not in chance)
    return attrs.evolve(outcome, violations=found)


class _StoryError(Exception):
    """The program that has the robot fails."""


def _told_by(error: Exception) -> str:
    if isinstance(error, ExceptionGroup):
        return "; ".join(map(_told_by, error.exceptions))
    return describe(error)


def _words(told: dict[str, Any]) -> str:
    error = told.get("exception")
    text = str(told.get("message", ""))
    return text if error is None else f"{text}: {describe(error)}"
