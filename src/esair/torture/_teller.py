"""Stories: those that are told in turn, and random ones."""

from __future__ import annotations

import random
from collections.abc import Iterator

import attrs

from esair.torture._kinds import KINDS, Cast, Kind
from esair.torture._story import Step, Story

DENSE, SPARSE = (0.08, 30, 80), (0.4, 6, 24)
"""Random stories: the pause between two steps on average, in seconds; how many steps
there are, at least and at most."""

UP = 3.0  # When the first step is in a story that looks what comes after, in seconds
SIEGE = 6.0
"""When the robot is stopped in a story that looks for what grows, in seconds: the
fault outlasts it."""

FEWEST, MOST = 2, 6  # How many steps there are in a story that looks what comes after


def calm(seed: int) -> Story:
    """Tell of a robot that nothing is done to."""
    return Story(seed, lasts=5.0)


def sieges(cast: Cast, seed: int) -> Iterator[Story]:
    """Tell of each component that one thing is done to it, for long, and the stop."""
    for kind in KINDS.values():
        if kind.lasts == (0.0,) or kind.group == "user":
            continue
        for name in cast[kind.on]:
            much = kind.much[0] if kind.name == "flooding" else kind.much[-1]
            step = Step(1.0, kind.name, name, lasts=10.0, how=kind.hows[0], much=much)
            yield Story(seed, (step,), lasts=SIEGE)


def aftermaths(cast: Cast, seed: int, calm: float) -> Iterator[Story]:
    """Tell of each component that one thing is done to it, then of some at random.

    Each goes on for long when all is well again: does the robot, too?

    Args:
        cast: Who is in the robot.
        seed: Decides the stories.
        calm: How long they go on, in seconds.
    """
    dice = random.Random(seed)
    for kind in KINDS.values():
        for name in cast[kind.on] if kind.weight and kind.name != "suspended" else ():
            how, much = dice.choice(kind.hows), dice.choice(kind.much)
            lasts = dice.choice(kind.lasts[-2:])
            yield _calmly(
                [Step(UP, kind.name, name, lasts=lasts, how=how, much=much)], dice, calm
            )
    while True:
        steps = random_story(cast, dice.randrange(2**31)).steps
        begin = dice.randrange(max(1, len(steps) - MOST))
        steps = steps[begin : begin + dice.randint(FEWEST, MOST)]
        yield _calmly(
            [
                attrs.evolve(each, at=round(each.at - steps[0].at + UP, 3))
                for each in steps
                if each.kind not in {"suspended", "end"}
            ],
            dice,
            calm,
        )


def _calmly(steps: list[Step], dice: random.Random, calm: float) -> Story:
    """Make a story that goes on for long when all is well again."""
    story = Story(dice.randrange(1, 2**31), tuple(steps))
    return attrs.evolve(story, lasts=round(story.over_at + calm, 3))


def random_story(cast: Cast, seed: int) -> Story:
    """Tell a random story; the same seed tells the same one."""
    dice = random.Random(seed)
    kinds = [each for each in KINDS.values() if each.weight and cast[each.on]]
    weights = [each.weight for each in kinds]
    gap, fewest, most = dice.choice((DENSE, DENSE, SPARSE))
    at = dice.choice((0.0, 0.3, 0.3, 1.0))
    steps = []
    for _ in range(dice.randint(fewest, most)):
        at += dice.choice((0.0, dice.expovariate(1 / gap), dice.expovariate(1 / gap)))
        (kind,) = dice.choices(kinds, weights)
        steps.append(_step(kind, cast, at, dice))
    lasts = round(at + dice.choice((0.0, 0.3, *(1.0,) * 8)), 3)
    how = dice.choice(("", "", "stop", "cancel", "error"))
    if how:
        steps.append(Step(lasts, "end", how=how))
    return Story(dice.randrange(1, 2**31), tuple(steps), lasts)


def _step(kind: Kind, cast: Cast, at: float, dice: random.Random) -> Step:
    return Step(
        round(at, 3),
        kind.name,
        dice.choice(cast[kind.on]),
        lasts=dice.choice(kind.lasts),
        how=dice.choice(kind.hows),
        much=dice.choice(kind.much),
    )
