"""The shortest story that still shows the same."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import attrs

from esair.torture._kinds import KINDS
from esair.torture._story import Step, Story

Shows = Callable[[Story], bool]

TRIES = 400  # How many shorter stories are told at most


def shrink(story: Story, shows: Shows) -> Story:
    """Leave out, shorten and simplify what the finding does not need."""
    left = TRIES

    def better(candidates: Iterator[Story]) -> Story | None:
        nonlocal left
        for each in candidates:
            if left <= 0:
                return None
            left -= 1
            if shows(each):
                return each
        return None

    while left > 0:
        found = better(_fewer(story)) or better(_simpler(story))
        if found is None:
            break
        story = found
    return story


def _fewer(story: Story) -> Iterator[Story]:
    """Leave out a half, a quarter, ..., one step."""
    steps = story.steps
    size = len(steps)
    while size > 0:
        for start in range(0, len(steps), size):
            rest = steps[:start] + steps[start + size :]
            if len(rest) < len(steps):
                yield attrs.evolve(story, steps=rest)
        size //= 2


def _simpler(story: Story) -> Iterator[Story]:
    last = max((each.at for each in story.steps), default=0.0)
    for lasts in (round(last + 0.3, 3), round(last + 1.0, 3), story.lasts / 2):
        if last <= lasts < story.lasts - 0.05:
            yield attrs.evolve(story, lasts=round(lasts, 3))
    if story.seed:
        yield attrs.evolve(story, seed=0)
    for place, step in enumerate(story.steps):
        for simpler in _simpler_steps(step):
            steps = list(story.steps)
            steps[place] = simpler
            yield attrs.evolve(story, steps=tuple(sorted(steps, key=lambda s: s.at)))


def _simpler_steps(step: Step) -> Iterator[Step]:
    kind = KINDS[step.kind]
    if step.how != kind.hows[0]:
        yield attrs.evolve(step, how=kind.hows[0])
    rounded = round(step.at, 1)
    if rounded != step.at:
        yield attrs.evolve(step, at=rounded)
    for lasts in kind.lasts:
        if 0 < lasts < step.lasts:
            yield attrs.evolve(step, lasts=lasts)
