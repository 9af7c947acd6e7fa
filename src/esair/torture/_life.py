"""Whether a robot lives on: it does again what it does while nothing is wrong."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, NamedTuple

import attrs

import esair
from esair.actions import Guards, Works, declared_works
from esair.exceptions import ProcessDiedError, describe
from esair.journal import Event, Kind
from esair.messages import BehaviorState, ResourceState, SupervisorPhase
from esair.torture._gate import is_injected
from esair.torture._kinds import Story

if TYPE_CHECKING:
    from esair.torture._world import World

WELL_AFTER = 11.0  # How long after its last fault a robot is itself again, in seconds
AGAIN_WITHIN = 4.0
"""Within how long it does then what it does steadily while nothing is wrong, in s."""

STEADY = AGAIN_WITHIN / 2
"""The longest pause of what is done steadily while nothing is wrong, in seconds."""

CALM_FOR = 28.0
"""How long a robot is looked at that nothing is done to, in seconds; longer if one of its
actions declares long pauses. What it does is judged in stories that are no longer."""

UP_AFTER = 4.0  # How long its start may take before its habits show, in seconds
CALMS = 2  # How often it is looked at; stand-ins say something else each time

OF_LIFE = frozenset({"ended", "works"})  # The rules here

UNTOLD = frozenset({"start", "holds", "stuck"})
"""The rules that end a story before it is told: nothing can be learned from it."""

_VERBS = {
    Kind.APPLIED: "commanded",
    Kind.PUT: "put data to",
    Kind.GOT: "got data from",
    Kind.ANSWERED: "had an answer of",
}


class Deed(NamedTuple):
    """What one action does to another component."""

    doer: str
    verb: str
    partner: str


@attrs.frozen
class Habits:
    """What a robot does that nothing is done to.

    Attributes:
        steady: What it does again and again, and its longest pause, in seconds.
        lasting: The actions that do not come to an end.
        known_for: How long it was looked at, in seconds.
    """

    steady: dict[Deed, float]
    lasting: frozenset[str]
    known_for: float


class Deeds:
    """What the actions of a robot have done so far."""

    def __init__(self, robot: esair.Robot) -> None:
        self.last: dict[Deed, float] = {}  # When, in seconds of the loop's clock
        self.pauses: dict[Deed, float] = {}  # The longest since `UP_AFTER`, in seconds
        # What each action has raised, that is: whether torture has injected it
        self.crashes: dict[str, list[bool]] = {}
        self.dying: set[str] = set()
        """The actions whose process torture has killed, until that is heard."""
        robot.journal.listen(self._hear, kinds=(*_VERBS, Kind.CRASHED))

    def _hear(self, event: Event) -> None:
        if event.kind is Kind.CRASHED:
            killed = isinstance(event.value, ProcessDiedError)
            of_torture = is_injected(event.value)
            if killed and event.component in self.dying:
                self.dying.discard(event.component)
                of_torture = True
            self.crashes.setdefault(event.component, []).append(of_torture)
        elif not isinstance(event.value, BaseException):
            deed = Deed(event.peer, _VERBS[event.kind], event.component)
            self.pauses[deed] = self.pause(deed, event.time)
            self.last[deed] = event.time

    def pause(self, deed: Deed, now: float) -> float:
        since = max(self.last.get(deed, 0.0), UP_AFTER)
        return max(self.pauses.get(deed, 0.0), now - since)

    def has_failed_by_itself(self, name: str) -> bool:
        """Tell whether most of what an action has raised is its own, the last is too."""
        crashes = self.crashes.get(name, [False])
        return not crashes[-1] and 2 * sum(crashes) < len(crashes)


def habits_in(worlds: Sequence[World]) -> Habits:
    """Return what a robot has done in all of some stories in which nothing is done."""
    steady: dict[Deed, float] = {}
    lasting: set[str] = set()
    for number, world in enumerate(worlds):
        deeds, lasts = world.deeds, world.story.lasts
        pauses = {deed: deeds.pause(deed, lasts) for deed in deeds.last}
        here = {deed: pause for deed, pause in pauses.items() if pause <= STEADY}
        shared = here if not number else here.keys() & steady.keys()
        steady = {deed: max(here[deed], steady.get(deed, 0.0)) for deed in shared}
        lasting = world.lasting if not number else lasting & world.lasting
    known_for = min((world.story.lasts for world in worlds), default=0.0)
    return Habits(steady, frozenset(lasting), known_for)


def lasting_in(robot: esair.Robot) -> set[str]:
    """Return the actions of a robot that have not come to an end, nor rest."""
    ended = {BehaviorState.FINISHED, BehaviorState.FAILED, BehaviorState.RESTING}
    states = {name: _state(robot, name) for name in robot.behaviors.names()}
    return {name for name, state in states.items() if state not in ended}


def longest_tail(robot: esair.Robot) -> float:
    """Return how long after its last fault a robot can be judged, in seconds."""
    declared = [each.within or 0.0 for _, each in _declared(robot)]
    return WELL_AFTER + max([AGAIN_WITHIN, *declared])


def calm_stories(robot: esair.Robot) -> list[Story]:
    """Return the stories that show the habits of a robot: nothing is done to it."""
    lasts = CALM_FOR + longest_tail(robot) - WELL_AFTER - AGAIN_WITHIN
    return [Story(seed, (), lasts) for seed in range(CALMS)]


def is_judged(story: Story) -> bool:
    """Tell whether a story shows whether its robot lives on.

    What a robot does after an hour of sleep is not known.
    """
    return story.lasts - story.over_at >= WELL_AFTER + AGAIN_WITHIN and all(
        step.kind != "suspended" for step in story.steps
    )


def judge_life(world: World) -> None:
    """Look, before the end, whether the robot does what it does in calm stories."""
    robot, habits = world.robot, world.target.habits
    quiet = world.now - world.story.over_at
    if (
        habits is None
        or not is_judged(world.story)
        or world.story.lasts > habits.known_for
        or world.ends is not None
        or robot.halted is not None
        or robot.behaviors.phase is SupervisorPhase.STOPPED
    ):
        return
    idle = {n for n, e in _declared(robot) if e.within is None and not e.partners}
    names = set(robot.behaviors.names())
    idle |= {name for name in names if _state(robot, name) is BehaviorState.RESTING}
    gone = {each.name for each in robot.plan.behaviors} - names
    ended = {name: _ended(world, name, habits) for name in sorted(names)}
    for name, told in ended.items():
        if told and name not in idle:
            world.judge.say("ended", name, told[:300])
    states = {_state(robot, name) for name in names}
    devices = {robot.resources.query(each).state for each in robot.resources.names()}
    if gone or BehaviorState.FAILED in states or ResourceState.FAILED in devices:
        return  # the others may well wait for it
    for doer, text in _left_undone(world, habits, idle, quiet):
        if not ended.get(doer):
            world.judge.say("works", doer, text[:300])


def look_after(world: World) -> None:
    """Do what a user does when a fault is over: end the latches of guards."""
    for action in world.actions():
        needs = action.needs.values()
        if any(isinstance(need, Guards) and need.latch for need in needs):
            world.robot.behaviors.reset(action.name)
            if lever := world.levers.get(id(action)):
                lever.latched = False


def _left_undone(
    world: World, habits: Habits, idle: set[str], quiet: float
) -> Iterator[tuple[str, str]]:
    """Yield who owes what, and has not done it for too long."""
    last, now, said = world.deeds.last, world.now, list(_declared(world.robot))
    spared = {(n, p) for n, each in said if each.within is None for p in each.partners}
    owed = {
        (deed.doer, deed.partner)
        for name, each in said
        if each.within is not None
        for deed in habits.steady
        if deed.doer == name and deed.partner in each.partners
    }
    for deed, pause in habits.steady.items():
        pair = deed.doer, deed.partner
        since = now - last.get(deed, 0.0)
        if not idle.isdisjoint(pair) or pair in spared | owed:
            continue
        if since <= AGAIN_WITHIN:
            continue
        yield (
            deed.doer,
            f"it has {deed.verb} {deed.partner} every {max(pause, 0.001):.3g} s at least "
            f"while nothing was wrong, and not for {since:.3g} s now, "
            f"{quiet:.3g} s after the last fault",
        )
    for name, each in said:
        if each.within is None or name in idle or quiet < WELL_AFTER + each.within:
            continue
        for partner in each.partners or ("",):
            times = (
                when
                for deed, when in last.items()
                if deed.doer == name and partner in {"", deed.partner}
            )
            since = now - max(times, default=0.0)
            if since > each.within:
                what = f"with {partner}" if partner else "at all"
                told = f"it is declared to do something {what} within {each.within:g} s"
                yield name, f"{told}, and has not for {since:.3g} s"


def _ended(world: World, name: str, habits: Habits) -> str:
    """Say how an action has come to an end that should not; empty if it has not."""
    member = world.robot.behaviors.query(name)
    if member.state is BehaviorState.FINISHED and name in habits.lasting:
        return "its run has ended; while nothing is wrong it goes on"
    was_made_to = any(
        step.kind in {"mad", "filled"} and step.target == name
        for step in world.story.steps
    )
    by_itself = not was_made_to and world.deeds.has_failed_by_itself(name)
    if member.state is BehaviorState.FAILED and by_itself and name in habits.lasting:
        why = "" if member.error is None else f": {describe(member.error)}"
        return f"it has failed for good, by an error of its own{why}"
    return ""


def _state(robot: esair.Robot, name: str) -> BehaviorState:
    return robot.behaviors.query(name).state


def _declared(robot: esair.Robot) -> Iterator[tuple[str, Works]]:
    for action in robot.plan.behaviors:
        for each in declared_works(action):
            yield action.name, each
