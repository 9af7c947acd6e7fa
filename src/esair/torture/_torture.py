"""The search: one story after the other, until the time is over."""

from __future__ import annotations

import contextlib
import gc
import itertools
import logging
import math
import os
import signal
import threading
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator

import attrs

from esair.torture._judge import Violation
from esair.torture._kinds import cast_of
from esair.torture._life import longest_tail
from esair.torture._shrink import shrink
from esair.torture._story import Story
from esair.torture._target import Target
from esair.torture._teller import aftermaths, calm, random_story, sieges
from esair.torture._world import Check, Outcome, tell

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
        """How many steps were taken."""
        return self.done.total()


def torture(
    target: Target,
    *,
    seed: int,
    seconds: float | None = None,
    faults: int | None = None,
    findings: int = MOST_FINDINGS,
    told: Callable[[Report], object] = lambda _: None,
    checks: tuple[Check, ...] = (),
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
        checks: What else must hold.
    """
    report = Report(seed)
    began = time.monotonic()
    known: set[tuple[str, str]] = set()
    with _quietly(), _interruptible(report):
        for story in _stories(target, seed, checks):
            outcome = tell(target, story, checks)
            _count(report, outcome)
            for violation in outcome.violations:
                if violation.key not in known and len(report.findings) < findings:
                    known.add(violation.key)
                    until = began + (seconds or math.inf) + LAST_SHRINK
                    finding = _shrunk(target, story, violation, checks, report, until)
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


def _stories(target: Target, seed: int, checks: tuple[Check, ...]) -> Iterator[Story]:
    first = calm(seed)
    yield first
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
    checks: tuple[Check, ...],
    report: Report,
    until: float,
) -> Finding | None:
    """Return the finding with its shortest story; None if it was none."""
    if violation.rule == "queue":
        told = tell(target, _longer(story), checks)
        if violation.key not in told.keys:
            return None  # it has a bound, which is further away

    def shows(other: Story) -> bool:
        if report.interrupted or time.monotonic() > until:
            return False  # it stays as long as it is
        return violation.key in tell(target, other, checks).keys

    if violation.rule != "holds":  # that takes real time
        story = shrink(story, shows)
        found = tell(target, story, checks).violations
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
