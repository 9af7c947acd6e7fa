"""The event loop of a child: it has no clock of its own, and takes turns with the robot.

It works until nothing in it is ready and no thread of it computes. Then it says what it
has done and when it wants to go on, and waits for a message, which brings the time. What a
driver gives is kept in a recording, and not repeated: its time runs on from there.
"""

from __future__ import annotations

import asyncio
import math
import select
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final

from esair.loop import SECOND, TurnLoop, run_in_thread

if TYPE_CHECKING:
    from esair.placement._child import Child


AT_ONCE: Final = 4
"""How many passes the loop makes before it lets the robot have its turn."""


class ChildLoop(TurnLoop):
    """The event loop of a child.

    Args:
        robot: The file on which the robot is heard; `home` hears it.
    """

    virtual = True

    home: Child

    def __init__(self, robot: int) -> None:
        self._now = 0.0
        self._ahead = -math.inf
        """What the robot's clock is ahead of the computer's, at least."""
        self.runs = False
        """Whether time goes on between two messages."""
        self.is_of_virtual = False
        """Whether the robot's clock is not real: it stands still while a thread works."""
        self.passes = 0
        """How often it has gone on to what is ready."""
        self._until = AT_ONCE
        super().__init__()
        self._robot = robot
        self._files: Any = self._selector._fd_to_key  # type: ignore[attr-defined]  # hot
        self._waits = select.poll()
        for each in (robot, self._selector.fileno()):  # type: ignore[attr-defined]
            self._waits.register(each, select.POLLIN)

    def time(self) -> float:
        return time.monotonic() + self._ahead if self.runs else self._now

    clock = time

    def told(self, now: float, heard: float) -> None:
        """Take note of what time it is, by a message that was heard at a moment."""
        self._now = max(self._now, now)
        self._ahead = max(self._ahead, now - heard)
        self._clock_resolution = max(1e-9, 2 * math.ulp(self._now))

    def slept(self) -> float:
        return 0.0

    def run_in_executor(  # type: ignore[override]
        self, executor: Any, func: Callable[..., Any], *args: Any
    ) -> asyncio.Future[Any]:
        """Run a function in a thread; where time is not real it waits for that."""
        run = run_in_thread if self.is_of_virtual else TurnLoop.run_in_executor
        return run(self, executor, func, *args)

    def _pass(self, timeout: float | None = None) -> Any:
        events = self._work_off()
        self._turn.number += 1
        self.passes += 1
        self._turn.border(self._now)
        return events

    def _work_off(self) -> Any:
        """Let go on what is ready, else threads, else what is due, else the robot."""
        ready, door = self._ready, self._turn.door  # type: ignore[attr-defined]
        if ready and self.passes >= self._until:
            self.home.idle(self._now)  # who works with pauses is heard in them
            self._hear()
        while not (ready or self._stopping or door.entries):  # type: ignore[attr-defined]
            door.let_go()
            is_quiet = door.at_work == 0  # once: a thread may end at any moment
            if door.ripen(works=is_quiet):
                if not self.is_of_virtual:
                    self.home.give_turn()  # time has passed while they worked
                break
            if not is_quiet:
                if events := self._others(self._select(None)):
                    return events
            elif (
                self._turn.is_due(self._now)
                or (first := self.first_timer()) <= self._now
            ):
                break
            else:
                return self._rest(max(min(first, self._turn.due / SECOND), self._now))
        # What threads have called for is ready without the bell, its one file.
        return self._others(self._select(0.0)) if len(self._files) > 1 else ()

    def _rest(self, wake: float) -> Any:
        """Be idle until the robot says something; it also says what time it is."""
        self.home.idle(wake)
        events: Any = ()
        while self._robot not in dict(self._waits.poll()):
            events = self._others(self._select(0.0))
            # A thread that has ended its work may ring late.
            if events or self._ready or self._turn.door.ripen(works=True):  # type: ignore[attr-defined]
                self.home.tick()  # something of its own: it has to know when that is
                break
        self._hear()
        return events

    def _hear(self) -> None:
        self.home.hear()
        self._until = self.passes + AT_ONCE
