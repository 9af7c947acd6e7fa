"""The search: one story after the other, until the time is over; what it finds is a test."""

from __future__ import annotations

import contextlib
import gc
import itertools
import logging
import math
import os
import random
import signal
import threading
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import attrs

from esair.torture._judge import Violation
from esair.torture._kinds import KINDS, Cast, Step, Story, cast_of, repr_of
from esair.torture._life import longest_tail
from esair.torture._target import Target
from esair.torture._world import Outcome, tell
from esair.values import printable

DENSE, SPARSE = (0.08, 30, 80), (0.4, 6, 24)
"""Random stories: the pause between two steps on average, in seconds; how many steps
there are, at least and at most."""

UP = 3.0  # When the first step is in a story that looks what comes after, in seconds
SIEGE = 6.0
"""When the robot is stopped in a story that looks for what grows, in seconds: the
fault outlasts it."""

FEWEST, MOST = 2, 6  # How many steps there are in a story that looks what comes after


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
        steps.append(
            Step(
                round(at, 3),
                kind.name,
                dice.choice(cast[kind.on]),
                lasts=dice.choice(kind.lasts),
                how=dice.choice(kind.hows),
                much=dice.choice(kind.much),
            )
        )
    lasts = round(at + dice.choice((0.0, 0.3, *(1.0,) * 8)), 3)
    how = dice.choice(("", "", "stop", "cancel", "error"))
    if how:
        steps.append(Step(lasts, "end", how=how))
    return Story(dice.randrange(1, 2**31), tuple(steps), lasts)


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


MOST_FINDINGS = 5  # After how many findings it ends
COLLECT = 25  # How many stories are told between two collections of what they leave
RANDOM = 3
"""How many random stories are told for each that does one thing for long, and for each
that looks what comes after."""

LONGER = 5
"""How many times as long a story is told again that has found what only grows."""


LAST_SHRINK = 30.0
"""How long what was found is still shrunk when the time is over, in seconds."""


@attrs.frozen
class Finding:
    """Something that must never be, and the shortest story that shows it.

    Attributes:
        violation: What was seen.
        story: What was done.
    """

    violation: Violation
    story: Story


@attrs.define
class Report:
    """What a search has done and found.

    Attributes:
        seed: Its seed: the same finds the same.
        stories: How many stories were told.
        done: How many times each kind of step was taken.
        survived: How many of them in stories in which all held that must.
        slowest: For each kind, how long an actuator that moved has taken to its safe
            command at most, in seconds of the virtual clock.
        findings: What was found.
        speechless: The sensors whose stand-ins had nothing to say, and why: nobody has
            seen what the robot makes of their readings.
        seconds: How long it took.
        interrupted: Whether Ctrl-C has ended it.
    """

    seed: int
    stories: int = 0
    done: Counter[str] = attrs.Factory(Counter)
    survived: Counter[str] = attrs.Factory(Counter)
    slowest: dict[str, float] = attrs.Factory(dict)
    findings: list[Finding] = attrs.Factory(list)
    speechless: dict[str, str] = attrs.Factory(dict)
    seconds: float = 0.0
    interrupted: bool = False

    @property
    def faults(self) -> int:
        return self.done.total()


def torture(
    target: Target,
    *,
    seed: int,
    seconds: float | None = None,
    faults: int | None = None,
    findings: int = MOST_FINDINGS,
    told: Callable[[Report], object] = lambda _: None,
) -> Report:
    """Do everything to a robot that can go wrong, and judge it.

    First nothing is done to it; then stories that do one thing for long, each of them
    once, and random ones are told in turn. What is found is shrunk at once. Ctrl-C ends
    it after the story that is being told; a second one at once.

    Args:
        target: Whose robot.
        seed: Decides the stories.
        seconds: How long, in real time; no limit unless given.
        faults: How many steps are taken; no limit unless given.
        findings: After how many findings it ends.
        told: Called after each story.
    """
    report = Report(seed)
    began = time.monotonic()
    known: set[tuple[str, str]] = set()
    with _quietly(), _interruptible(report):
        for story in _stories(target, seed):
            outcome = tell(target, story)
            _count(report, outcome)
            for violation in outcome.violations:
                if violation.key not in known and len(report.findings) < findings:
                    known.add(violation.key)
                    until = began + (seconds or math.inf) + LAST_SHRINK
                    finding = _shrunk(target, story, violation, report, until)
                    if finding is not None:
                        report.findings.append(finding)
                        known |= outcome.keys
            report.seconds = time.monotonic() - began
            told(report)
            if report.stories == 1 and any(key[0] == "start" for key in outcome.keys):
                break  # nothing can be done to a robot that does not start
            over = seconds is not None and report.seconds >= seconds
            enough = faults is not None and report.faults >= faults
            if report.interrupted or over or enough or len(report.findings) >= findings:
                break
            if not report.stories % COLLECT:
                gc.collect()
    gc.collect()
    return report


def _stories(target: Target, seed: int) -> Iterator[Story]:
    yield Story(seed, lasts=5.0)
    try:
        robot = target.make()
    except Exception:  # it cannot be made: that was the finding
        return
    cast = cast_of(robot)
    one_by_one = sieges(cast, seed)
    calmly = aftermaths(cast, seed, longest_tail(robot) + 0.5)
    for number in itertools.count():
        if number % RANDOM == 0 and (siege := next(one_by_one, None)) is not None:
            yield siege
        if number % RANDOM == 1:
            yield next(calmly)
        yield random_story(cast, seed * 1_000_003 + number)


def _count(report: Report, outcome: Outcome) -> None:
    report.stories += 1
    report.speechless.update(outcome.speechless)
    report.done.update(outcome.done)
    if not outcome.violations:
        report.survived.update(outcome.done)
    for kind, took in outcome.slowest.items():
        report.slowest[kind] = max(report.slowest.get(kind, 0.0), took)


def _shrunk(
    target: Target,
    story: Story,
    violation: Violation,
    report: Report,
    until: float,
) -> Finding | None:
    """Return the finding with its shortest story; None if it was none."""
    if violation.rule == "queue":
        told = tell(target, _longer(story))
        if violation.key not in told.keys:
            return None  # it has a bound, which is further away

    def shows(other: Story) -> bool:
        if report.interrupted or time.monotonic() > until:
            return False  # it stays as long as it is
        return violation.key in tell(target, other).keys

    if violation.rule != "holds":  # that takes real time
        story = shrink(story, shows)
        found = tell(target, story).violations
        violation = next((e for e in found if e.key == violation.key), violation)
    return Finding(violation, story)


def _longer(story: Story) -> Story:
    steps = tuple(
        attrs.evolve(step, lasts=step.lasts * LONGER if step.lasts > 1 else step.lasts)
        for step in story.steps
    )
    return attrs.evolve(story, steps=steps, lasts=story.lasts * LONGER)


@contextlib.contextmanager
def _quietly() -> Iterator[None]:
    """Show neither the log nor what the robot prints, and warns of."""
    log = logging.getLogger("esair")
    level = log.level
    log.setLevel(logging.CRITICAL + 1)
    try:
        with (
            open(os.devnull, "w", encoding="utf-8") as nowhere,
            contextlib.redirect_stdout(nowhere),
            warnings.catch_warnings(),
        ):
            warnings.simplefilter("ignore")  # of numbers that are no good, for one
            yield
    finally:
        log.setLevel(level)


@contextlib.contextmanager
def _interruptible(report: Report) -> Iterator[None]:
    """Let the first Ctrl-C end the search in order."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.getsignal(signal.SIGINT)

    def interrupted(*_: object) -> None:
        report.interrupted = True
        signal.signal(signal.SIGINT, before)

    signal.signal(signal.SIGINT, interrupted)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


_TEST = '''\
"""{title}

Found by: esair torture {words} --seed {seed}
"""
{imports}
from esair.torture import Step, survive
{place}

def test_{name}() -> None:
    """{text}"""
    survive(
        {robot},
        seed={story.seed},
        lasts={story.lasts:g},{own}
        steps=[{steps}],
    )
'''


def survive(
    robot: str | os.PathLike[str],
    steps: Sequence[Step] = (),
    *,
    seed: int = 0,
    lasts: float = 3.0,
    own: bool = False,
) -> None:
    """Do to a robot what a story tells, and see to it that all holds that must.

    It runs on the virtual clock, without any hardware.

    Args:
        robot: A robot.toml; or ``module:robot``, ``file.py:robot``.
        steps: What is done to it, in order.
        seed: Decides the order of tasks, and what stand-ins of sensors say.
        lasts: When the robot is stopped, in seconds.
        own: The devices of a module's robot are harmless as they are: use them.

    Raises:
        AssertionError: Something was seen that must never be.
    """
    target = Target.of(os.fspath(robot), own=own)
    outcome = tell(target, Story(seed, tuple(steps), lasts))
    if outcome.violations:
        lines = ["what must never be:", *map(str, outcome.violations)]
        lines += ["what was done:", *map(str, steps)]
        raise AssertionError("\n  ".join(lines))


def write_test(
    target: Target, violation: Violation, story: Story, seed: int, folder: Path
) -> Path:
    """Write a story as a test for pytest.

    Args:
        target: Whose robot.
        violation: What it shows.
        story: The story.
        seed: The seed of the search that has found it.
        folder: Where the test goes; it is made if it is not there.

    Returns:
        The file.
    """
    folder.mkdir(parents=True, exist_ok=True)
    rule = violation.rule.replace(" ", "_")
    name = f"{violation.component}_{rule}"
    imports = place = ""
    robot = repr_of(target.name)
    if target.file is not None:
        imports = "\nfrom pathlib import Path\n"
        path = Path(os.path.relpath(target.file.resolve(), folder.resolve()))
        place = f"\nROBOT = Path(__file__).parent / {repr_of(path.as_posix())}\n"
        attribute = repr_of(target.name.rpartition(":")[2])[1:-1]
        robot = "ROBOT"
        if target.file.suffix == ".py":
            attribute = attribute.replace("{", "{{").replace("}", "}}")
            robot = f'f"{{ROBOT}}:{attribute}"'
    steps = "".join(f"\n            {step.source()}," for step in story.steps)
    text = _TEST.format(
        title=_sentence(f"{violation.component}: {violation.rule}"),
        words=repr_of(target.name)[1:-1],
        seed=seed,
        imports=imports,
        place=place,
        name=name,
        text=_sentence(violation.text),
        robot=robot,
        story=story,
        own="\n        own=True," if target.own else "",
        steps=f"{steps}\n        " if steps else "",
    )
    file = folder / f"test_torture_{name}.py"
    file.write_text(text, encoding="utf-8")
    return file


def _sentence(text: str) -> str:
    words = " ".join(text.replace("\\", "/").replace('"', "'").split())
    words = printable(words[:1].upper() + words[1:])
    if len(words) > 80:
        words = words[:77].rstrip() + "..."
    return words if words.endswith(".") else f"{words}."
