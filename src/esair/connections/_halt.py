"""The halt: the latch that keeps every actuator safe, and what it reports."""

from __future__ import annotations

import asyncio
import concurrent.futures
import sys
from collections.abc import Generator, Iterable
from typing import NamedTuple, Self

HALT = "halt"  # who holds every actuator of a robot that is halted
HALT_PRIORITY = sys.maxsize  # with which priority: nobody's is higher


class Halt(NamedTuple):
    """Why and since when a robot is halted.

    Attributes:
        reason: Why, in the words of whoever halted it.
        since: Since when, on the event loop's clock (seconds).
    """

    reason: str
    since: float


class LastCommand(NamedTuple):
    """What an actuator was told last.

    Attributes:
        resource: The name of the actuator.
        command: The last command that was handed to its driver; None if there was none.
        safe: Whether that was its safe command.
        answered: Whether the driver took it without an error, and no call from before
            is alive that could undo it.
        error: Why not, in words; empty if it did.
    """

    resource: str
    command: object
    safe: bool
    answered: bool
    error: str = ""

    def __str__(self) -> str:
        answer = "answered" if self.answered else f"NOT ANSWERED ({self.error})"
        told = f"{'safe ' if self.safe else ''}{self.command!r}"
        if self.command is None:
            told = "nothing was sent"
        return f"{self.resource}: {told}: {answer}"


class Halting:
    """What each actuator is told because of a halt, and whether it answered.

    Await it in the event loop, or call `result` in a thread.
    """

    def __init__(self) -> None:
        self._outcome: concurrent.futures.Future[tuple[LastCommand, ...]] = (
            concurrent.futures.Future()
        )

    def __await__(self) -> Generator[object, None, tuple[LastCommand, ...]]:
        return asyncio.shield(asyncio.wrap_future(self._outcome)).__await__()

    def done(self) -> bool:
        """Whether every actuator has answered, or has missed its deadline."""
        return self._outcome.done()

    def result(self, timeout: float | None = None) -> tuple[LastCommand, ...]:
        """Wait in a thread; in the event loop await the object instead.

        Raises:
            TimeoutError: It took longer than *timeout* seconds.
        """
        return self._outcome.result(timeout)

    def settle(self, told: Iterable[LastCommand]) -> None:
        """Say what each actuator was told; only the first time counts."""
        if not self._outcome.done():
            self._outcome.set_result(tuple(told))


class Stopped(tuple[LastCommand, ...]):
    """After the stop: what each actuator was told last, and why the robot stopped.

    Attributes:
        reason: Why it stopped; if it was halted then, also why.
        recording: What its recording lacks, in words; empty if nothing.
    """

    reason: str
    recording: str = ""

    def __new__(cls, told: Iterable[LastCommand] = (), reason: str = "") -> Self:
        """Make a report of what each actuator was told."""
        report = super().__new__(cls, told)
        report.reason = reason
        return report

    def __repr__(self) -> str:
        return f"Stopped({super().__repr__()}, reason={self.reason!r})"
