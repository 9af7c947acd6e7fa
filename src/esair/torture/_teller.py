"""Stories: those that are told in turn, and random ones."""

from __future__ import annotations

import random
from collections.abc import Iterator

from esair.torture._kinds import KINDS, Cast, Kind
from esair.torture._story import Step, Story

DENSE, SPARSE = (0.08, 30, 80), (0.4, 6, 24)
"""Random stories: the pause between two steps on average, in seconds; how many steps
there are, at least and at most."""

SIEGE = 6.0
"""When the robot is stopped in a story that looks for what grows, in seconds: the
fault outlasts it."""

CALM = 12.0  # How long some stories go on when all is well again, in seconds


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
    lasts = round(at + dice.choice((0.0, 0.3, *(1.0,) * 8, CALM)), 3)
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
