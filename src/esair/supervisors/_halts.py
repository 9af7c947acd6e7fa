"""Halt and resume: the latch of a whole robot, from any thread and in every state."""

from __future__ import annotations

import asyncio
import itertools
import logging
import threading
from collections.abc import Callable, Iterable, Iterator

from esair.connections import (
    ActuatorChannel,
    ActuatorConnection,
    Halt,
    Halting,
    LastCommand,
    Registrations,
)
from esair.journal import Journal, Kind
from esair.loop import Door, News, clock_of, spawn
from esair.supervisors._control_path import only_the_user
from esair.values import printable

TAKEN_WITHIN = 0.25
"""How long a thread that halts waits for a loop that is busy, in seconds."""

_log = logging.getLogger("esair")


class Halts:
    """Halts a robot, and lets it go again.

    A halt is two steps. The latch goes down in the thread that asks: from then on no
    command passes the commit block. The safe commands are sent by the event loop.
    """

    def __init__(
        self,
        name: str,
        actuators: ActuatorConnection,
        registrations: Registrations,
        journal: Journal,
        forget: Callable[[], None],
    ) -> None:
        self._name = name
        self._channels = actuators.channels
        self._registrations = registrations
        self._journal = journal
        self._forget = forget
        self._loop: asyncio.AbstractEventLoop | None = None
        self._home = 0
        self._answers: set[asyncio.Task[None]] = set()
        self._halted_by: News
        self._resumed: News
        self._from_threads: dict[int, tuple[Halting, threading.Event]] = {}
        self._numbers = itertools.count()
        self.keeps_still: Callable[[], str] = lambda: ""
        """Says why the robot must not be resumed yet; empty if it may be."""

    @property
    def reason(self) -> str | None:
        halt = self._registrations.halt
        return None if halt is None else halt.reason

    def start(self, loop: asyncio.AbstractEventLoop) -> None:
        """The robot starts; it is halted from the first moment if it was before."""
        self._loop, self._home = loop, threading.get_ident()
        self._halted_by = News(loop, ("robot", "halt"), self._halt_of_thread)
        self._resumed = News(loop, ("robot", "resume"), self._let_go)
        halt = self._registrations.halt
        if halt is not None:
            self._registrations.halt = Halt(halt.reason, clock_of(loop)())
            _log.warning("robot %s: starts halted: %s", self._name, halt.reason)

    async def close(self) -> None:
        """The robot has told of each actuator what it answered: each halt tells that, too."""
        for each in tuple(self._answers):
            each.cancel()
        if self._answers:
            await asyncio.wait(self._answers)
        self._loop = None

    def _told(self) -> Iterator[LastCommand]:
        return (channel.told() for channel in tuple(self._channels.values()))

    def halt(self, reason: str, by: str = "the user") -> Halting:
        """Make every actuator safe and keep it so, until `resume`."""
        halting = Halting()
        loop = self._loop
        reason = _words(reason)
        if loop is None:
            self._registrations.halt = Halt(reason, 0.0)
            _log.warning("robot %s: halted by %s: %s", self._name, by, reason)
            halting.settle(self._told())
        elif threading.get_ident() == self._home:
            self._take_effect(reason, by, halting)
        elif Door.of(loop).player is not None:  # the tape tells when it took effect
            halting.settle(())
        else:
            self._registrations.halt = Halt(reason, clock_of(loop)())
            for channel in tuple(self._channels.values()):
                channel.bar()
            taken, number = threading.Event(), next(self._numbers)
            self._from_threads[number] = halting, taken
            try:
                self._halted_by.tell(number, reason, by)
            except RuntimeError:  # the loop is closed: the stop was the last word
                halting.settle(self._told())
            else:
                taken.wait(TAKEN_WITHIN)
        return halting

    def resume(self) -> None:
        """End all halts: the next write moves."""
        only_the_user("robot", "resume", "ends a halt")
        loop = self._loop
        if loop is None:
            self._registrations.halt = None
        elif threading.get_ident() == self._home:
            self._let_go()
        else:
            self._resumed.tell()

    def _halt_of_thread(self, number: int, reason: str, by: str) -> None:
        made = Halting(), threading.Event()
        halting, taken = self._from_threads.pop(number, made)
        self._take_effect(reason, by, halting)
        taken.set()

    def _take_effect(self, reason: str, by: str, halting: Halting) -> None:
        loop = self._loop
        if loop is None:  # it was stopped before the loop heard of it
            halting.settle(self._told())
            return
        self._registrations.halt = Halt(reason, clock_of(loop)())
        for channel in self._channels.values():
            channel.halt()
        self._forget()
        self._journal.publish(Kind.HALTED, by, text=reason)
        _log.warning("robot %s: halted by %s: %s", self._name, by, reason)
        channels = tuple(self._channels.values())
        answers = spawn(loop, self._answer(channels), name=f"halt {self._name}")
        self._answers.add(answers)

        # A task that is cancelled before its first step runs none of its code.
        def answered(task: asyncio.Task[None]) -> None:
            self._answers.discard(task)
            halting.settle(channel.told() for channel in channels)

        answers.add_done_callback(answered)

    async def _answer(self, channels: Iterable[ActuatorChannel]) -> None:
        await asyncio.gather(*(channel.safe.settled() for channel in channels))

    def _let_go(self) -> None:
        if self._registrations.halt is None:
            return
        if why := self.keeps_still():
            self._take_effect(why, "the watchdog", Halting())
            return
        self._registrations.halt = None
        for channel in self._channels.values():
            channel.resume()
        self._journal.publish(Kind.RESUMED, "the user")
        _log.warning("robot %s: resumed: the next write moves", self._name)


def _words(reason: object) -> str:
    """Put a reason into one line that can be shown: a halt is refused for no reason at all."""
    try:
        text = printable(" ".join(str(reason).split()))
    except Exception:  # a user's __str__ may raise anything
        text = ""
    return text or "no reason was given"
